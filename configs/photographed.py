"""What a config says of photographs that stand in for a rendered scene: which files, which lights, in which colours.

Light adds: a photograph under several coloured lights is the weighted sum of photographs that show the same object
under one light each, with a weight for red, green and blue of each light.
"""

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, field_validator, model_validator

from huesphere.configs.lights import LightModel, Vector
from huesphere.configs.model import Model
from huesphere.configs.spectra import EmitterSpec

MOST_PHOTOGRAPHS = 4096
LARGEST_SEED = 2**63 - 1


class Photographs(Model):
    """Photographs of one object from one place, under one light each, and its true normals."""

    kind: Literal["photographs"]
    path: str | None = Field(default=None, description="a folder or an npz; render --shape gives it")
    layout: Literal["auto", "diligent", "luces", "psm", "npz"] = Field(
        default="auto", description="how the files are laid out; auto: as their names say"
    )
    object: str | None = Field(
        default=None, pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$", description="psm: of several in one folder"
    )
    normals: Literal["file", "sphere"] = Field(
        default="file", description="sphere: those of a ball whose outline is the mask, where there is no file of them"
    )
    encoding: Literal["linear", "srgb"] = Field(default="linear", description="of the samples in the files")
    reduce: int = Field(default=1, ge=1, le=16, description="means over squares of so many pixels a side")


class RgbWeights(Model):
    weights: tuple[Vector, ...] = Field(
        min_length=1, max_length=MOST_PHOTOGRAPHS, description="red, green, blue of each light, from 0"
    )

    @field_validator("weights")
    @classmethod
    def _some_light(cls, value: tuple[Vector, ...]) -> tuple[Vector, ...]:
        if min(min(weight) for weight in value) < 0:
            raise ValueError("a weight below 0: light cannot be taken away")
        if max(max(weight) for weight in value) <= 0:
            raise ValueError("all weights are 0: no light")
        return value


class LampSpectra(Model):
    spectra: tuple[EmitterSpec, ...] = Field(
        min_length=1, max_length=MOST_PHOTOGRAPHS, description="of each light, seen by camera.sensitivity"
    )


Colours = Literal["white", "lamps", "gels", "natural"] | RgbWeights | LampSpectra


class PhotographedLights(LightModel):
    """The lights of some of the photographs: which ones, and the colours that they are given."""

    spectral: ClassVar[tuple[str, ...]] = ("colours",)

    kind: Literal["photographed"]
    count: Literal["all"] | Annotated[int, Field(ge=1, le=MOST_PHOTOGRAPHS)] | None = Field(
        default=None,
        description="how many, chosen by the seed, spread in azimuth; null: as the colours need, three for lamps, "
        "five or six for gels, five for natural, all for white",
    )
    numbers: tuple[Annotated[int, Field(ge=0, lt=MOST_PHOTOGRAPHS)], ...] | None = Field(
        default=None, min_length=1, description="these photographs, from 0, in place of a choice by the seed"
    )
    colours: Colours = Field(
        default="lamps",
        description="lamps: one primary each; gels: saturated hues around the circle; natural: black bodies of 2500 to "
        "12000 K; white: as photographed; or weights, or spectra",
    )
    seed: int = Field(default=0, ge=0, le=LARGEST_SEED, description="of the choice and of the colours")

    @model_validator(mode="after")
    def _one_choice(self) -> "PhotographedLights":
        if self.numbers is not None:
            if self.count is not None:
                raise ValueError("count and numbers both say which lights are meant: name one of them")
            if len(set(self.numbers)) < len(self.numbers):
                raise ValueError("numbers: a photograph twice")
        given = self.number_of_colours
        wanted = len(self.numbers) if self.numbers is not None else self.count
        if given is not None and wanted is not None and wanted != given:
            raise ValueError(f"colours are given for {given} lights, and {wanted} are asked for")
        return self

    @property
    def number_of_colours(self) -> int | None:
        """How many lights the config gives a colour each; None where colours are drawn."""
        if isinstance(self.colours, RgbWeights):
            return len(self.colours.weights)
        return len(self.colours.spectra) if isinstance(self.colours, LampSpectra) else None


def conflict(config: Any, defaults: dict[str, Any]) -> str | None:
    """What in a `schema.RunConfig` does not go with its shape and lights; None if all of it does.

    Photographs have a surface, a size and all bounces of light already: keys that would change them are refused, not
    ignored. ``defaults`` has the default values of the keys ``surface``, ``room``, ``camera``, ``render``.
    """
    photographs = isinstance(config.shape, Photographs)
    of_photographs = [isinstance(light, PhotographedLights) for light in config.lights]
    if not photographs:
        return "lights of kind 'photographed' need shape.kind photographs" if any(of_photographs) else None
    if of_photographs != [True]:
        return "shape.kind photographs needs lights: one entry of kind 'photographed' (as in photographs.yaml)"
    for key in ("surface", "room"):
        if getattr(config, key) != defaults[key]:
            return f"{key}: photographs have their own"
    for key in ("projection", "field_of_view", "resolution", "view_height", "pixel"):
        if getattr(config.camera, key) != getattr(defaults["camera"], key):
            return f"camera.{key}: photographs have their own (shape.reduce makes them smaller)"
    for key in ("target_rms", "max_bounces", "samples", "seed"):
        if getattr(config.render, key) != getattr(defaults["render"], key):
            return f"render.{key}: nothing of a photograph is traced (lights.0.seed chooses and colours the lights)"
    if config.render.transport != ("full",):
        return "render.transport: photographs have all bounces: full alone"
    return "recover.lights: photographs tell no lights to recovery" if config.recover.lights != "unknown" else None
