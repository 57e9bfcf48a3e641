"""What a config says of a light, one section for each kind: its keys with their units, ranges and defaults.

What a light of a kind does is in the module of the same name in `scenes.lights`.
"""

from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, Field, model_validator

from huesphere.configs.model import SMALLEST, Model
from huesphere.configs.spectra import DaylightSpectrum, EmitterSpec

Vector = tuple[float, float, float]


def _not_null(value: Vector) -> Vector:
    if sum(v * v for v in value) < SMALLEST**2:
        raise ValueError(f"a direction may not be (0, 0, 0), nor shorter than {SMALLEST:g}")
    return value


Direction = Annotated[Vector, AfterValidator(_not_null)]


class LightModel(Model):
    """What the models of all kinds share. The class variables say of a kind what other modules need to know of it."""

    has_place: ClassVar[bool] = False  # whether recovery may be given its position or direction (`recover.lights`)
    spectral: ClassVar[tuple[str, ...]] = ("spectrum", "intensity")  # keys that change its colour and no geometry


# ---- distant -------------------------------------------------------------------------------------------------------


class DistantLight(LightModel):
    has_place: ClassVar[bool] = True

    kind: Literal["distant"] = "distant"
    direction: Direction = Field(description="toward the light, camera frame, any length")
    spectrum: EmitterSpec = "D65"
    intensity: float = Field(default=1.0, ge=0, description="irradiance of a surface that faces the light")


# ---- point, sphere, rectangle --------------------------------------------------------------------------------------


class Positioned(LightModel):
    position: Vector = Field(description="camera frame, scene units")
    spectrum: EmitterSpec = "D65"
    intensity: float = Field(default=1.0, ge=0, description="irradiance at distance 1 of a surface that faces it")


class PointLight(Positioned):
    has_place: ClassVar[bool] = True

    kind: Literal["point"]


class SphereLight(Positioned):
    has_place: ClassVar[bool] = True

    kind: Literal["sphere"]
    radius: float = Field(gt=0, description="scene units")


class RectangleLight(Positioned):
    """A luminous rectangle about its position; it shines toward edge_u × edge_v."""

    kind: Literal["rectangle"]
    intensity: float = Field(
        default=1.0,
        ge=0,
        description="irradiance at distance 1 on its axis of a surface that faces it, extrapolated from far away",
    )
    edge_u: Vector = Field(description="whole edge, camera frame, scene units")
    edge_v: Vector = Field(description="whole edge, camera frame, scene units")

    @model_validator(mode="after")
    def _spans(self) -> "RectangleLight":
        u, v = self.edge_u, self.edge_v
        cross = (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
        if sum(c * c for c in cross) < SMALLEST**4:
            raise ValueError("edge_u and edge_v must span a rectangle")
        return self


# ---- ambient -------------------------------------------------------------------------------------------------------


class AmbientLight(LightModel):
    """The report's ambient term (3.6): the same for every normal."""

    kind: Literal["ambient"]
    spectrum: EmitterSpec = "D65"
    intensity: float = Field(default=0.1, ge=0, description="irradiance of every surface, whatever its normal")


# ---- sky -----------------------------------------------------------------------------------------------------------


class Sun(Model):
    """The sun of a sky: a distant light with a spectrum and an intensity of its own."""

    direction: Direction
    spectrum: EmitterSpec = DaylightSpectrum(daylight=5200)
    intensity: float = Field(default=1.0, ge=0, description="irradiance of a surface that faces the sun")


class SkyLight(LightModel):
    """Light from all directions above the horizon, with a spectrum that goes from the horizon's to the zenith's.

    With a ``ground`` there is also light from below, and with a ``sun`` a distant light; null means that there is none.
    """

    spectral: ClassVar[tuple[str, ...]] = (
        "zenith",
        "horizon",
        "ground",
        "intensity",
        "sun.spectrum",
        "sun.intensity",
    )

    kind: Literal["sky"]
    up: Direction = (0.0, 1.0, 0.0)
    zenith: EmitterSpec = DaylightSpectrum(daylight=15_000)
    horizon: EmitterSpec = DaylightSpectrum(daylight=6500)
    ground: EmitterSpec | None = None
    intensity: float = Field(
        default=1.0, ge=0, description="irradiance of a surface that faces up, where zenith and horizon are alike"
    )
    sun: Sun | None = None


# ---- the table of kinds --------------------------------------------------------------------------------------------

LightSpec = Annotated[
    DistantLight | PointLight | SphereLight | RectangleLight | AmbientLight | SkyLight,
    Field(discriminator="kind"),
]
