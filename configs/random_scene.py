"""Random parts of a scene: lights, meshes of a folder, poses and seeds that a config leaves to chance.

    shape: {kind: mesh, path: models/*.glb, rotation: random}
    shape: {kind: sculpture, seed: random}
    lights: {random: {count: [3, 9], spread: 60, spectra: [cie, gaussian]}}

They are drawn when the config is loaded, and replaced by what was drawn, so that the config of an item holds no chance.
What is drawn depends on the seed that is written (``lights.random.seed``, ``shape.seed``) and on the number of the
item's draw in its sweep alone. A file that is added to a folder changes only the draws in which it is drawn.
"""

import math
import random
from pathlib import Path, PurePath
from typing import Annotated, Any

from pydantic import Field, ValidationError, field_validator

from huesphere.configs.draws import DIGITS, derived_seed
from huesphere.configs.errors import InputError
from huesphere.configs.file_paths import PathAsWritten, digest_of_file
from huesphere.configs.model import Model
from huesphere.configs.spectra import EmitterSpec

RANDOM = "random"  # the value that leaves a key to chance

FAMILIES: dict[str, tuple[str, ...]] = {
    "cie": ("A", "B", "C", "D50", "D55", "D65", "D75", "E", *(f"FL{number}" for number in range(1, 13))),
    "led": (*(f"LED-B{number}" for number in range(1, 6)), "LED-BH1", "LED-RGB1", "LED-V1", "LED-V2"),
}
KELVIN = (2200.0, 12_000.0)  # black bodies, evenly in the logarithm; daylight from 4000 K on
CENTRES, WIDTHS = (440.0, 640.0), (15.0, 45.0)  # nm, of Gaussian bands

Bounds = tuple[float, float]


class RandomLights(Model):
    """Distant lights that are drawn at random; each bound is a number or the two ends of a range."""

    count: Annotated[tuple[int, int], Field(description="number of lights, 1 to 256")] = (3, 9)
    spread: Bounds = Field(
        default=(10.0, 60.0), description="degrees off the view axis, uniform over the sphere; a number: from 0 to it"
    )
    intensity: Bounds = (0.5, 1.5)
    spectra: tuple[EmitterSpec, ...] = Field(
        default=("cie", "led", "blackbody", "gaussian"),
        min_length=1,
        description="families (cie, led, blackbody, daylight, gaussian) or spectra; each is as likely as any other",
    )
    seed: int = Field(default=0, ge=0, le=2**63 - 1)

    @field_validator("count", "intensity", mode="before")
    @classmethod
    def _one_or_two(cls, value: Any) -> Any:
        return value if isinstance(value, list | tuple) else (value, value)

    @field_validator("spread", mode="before")
    @classmethod
    def _from_the_axis(cls, value: Any) -> Any:
        return value if isinstance(value, list | tuple) else (0.0, value)

    @field_validator("count", "spread", "intensity")
    @classmethod
    def _ordered(cls, value: tuple[float, float], info: Any) -> tuple[float, float]:
        least, most = {"count": (1, 256), "spread": (0, 180), "intensity": (0, 1e12)}[info.field_name]
        if not least <= value[0] <= value[1] <= most:
            raise ValueError(f"expected two numbers from {least:g} to {most:g}, the smaller one first")
        return value


def is_random(data: dict[str, Any]) -> bool:
    """Whether something in a config's mapping is left to chance."""
    shape = data.get("shape")
    by_chance = isinstance(shape, dict) and (
        _pattern(shape.get("path")) is not None or RANDOM in (shape.get("seed"), shape.get("rotation"))
    )
    return by_chance or _of_lights(data) is not None


def draw_random(data: dict[str, Any], number: int, where: object) -> str:
    """Replace what is left to chance in ``data``, in place, by draw ``number`` of it.

    Returns what was drawn as a word for the item's name, such as "bunny-5_lights", or "". Raises InputError.
    """
    words = []
    if isinstance(data.get("shape"), dict):
        data["shape"], word = _drawn_shape(data["shape"], number, where)
        words += [word] if word else []
    written = _of_lights(data)
    if written is not None:
        data["lights"] = _drawn_lights(written, number, where)
        words.append(f"{len(data['lights'])}_lights")
    return "-".join(words)


def _of_lights(data: dict[str, Any]) -> Any:
    """What is written under ``lights.random``, None if nothing is. A mapping without that key is left to validation."""
    lights = data.get("lights")
    return lights[RANDOM] if isinstance(lights, dict) and RANDOM in lights else None


# ---- lights --------------------------------------------------------------------------------------------------------


def _drawn_lights(written: Any, number: int, where: object) -> list[dict[str, Any]]:
    """Draw ``number`` of the lights that are ``written`` under ``lights.random``, as a config lists lights."""
    try:
        spec = RandomLights.model_validate(written)
    except ValidationError as error:
        raise _one_line(error, where) from None
    rng = random.Random(derived_seed(spec.seed, "lights", number))
    # The spectra as they are written, in which files are still paths that know what they are relative to.
    spectra = written.get("spectra", spec.spectra)
    count = spec.count[0] + int(rng.random() * (spec.count[1] - spec.count[0] + 1))
    return [
        {
            "kind": "distant",
            "direction": _direction(rng, *spec.spread),
            "spectrum": _spectrum(rng, spectra[int(rng.random() * len(spectra))]),
            "intensity": _short(_between(rng, *spec.intensity)),
        }
        for _ in range(count)
    ]


def _one_line(error: ValidationError, where: object) -> InputError:
    first = error.errors(include_url=False)[0]
    place = ".".join(str(part) for part in first["loc"] if isinstance(part, int) or part in RandomLights.model_fields)
    key = ".".join(["lights.random", *([place] if place else [])])
    if first["type"] == "extra_forbidden":
        known = ", ".join(RandomLights.model_fields)
        return InputError(f"unknown key lights.random.{first['loc'][0]}; known are {known}", where=where)
    expected = first["msg"].removeprefix("Value error, ").removeprefix("expected ").removeprefix("Input should be ")
    return InputError(key, got=repr(first["input"])[:60], expected=expected, where=where)


def _direction(rng: random.Random, nearest: float, farthest: float) -> list[float]:
    """A unit vector, uniform over the part of the sphere between two angles (degrees) from +z."""
    cosines = math.cos(math.radians(nearest)), math.cos(math.radians(farthest))
    z, around = _between(rng, *cosines), 2 * math.pi * rng.random()
    r = math.sqrt(max(0.0, 1 - z * z))
    return [_short(c) for c in (r * math.cos(around), r * math.sin(around), z)]


def _spectrum(rng: random.Random, spec: Any) -> Any:
    """A spectrum of the family that ``spec`` names; ``spec`` itself if it is a spectrum."""
    if not isinstance(spec, str):
        return spec
    if spec in FAMILIES:
        names = FAMILIES[spec]
        return names[int(rng.random() * len(names))]
    if spec == "blackbody":
        return {"blackbody": _short(math.exp(_between(rng, math.log(KELVIN[0]), math.log(KELVIN[1]))))}
    if spec == "daylight":
        return {"daylight": _short(math.exp(_between(rng, math.log(4000.0), math.log(KELVIN[1]))))}
    if spec == "gaussian":
        return {"gaussian": {"centre": _short(_between(rng, *CENTRES)), "sigma": _short(_between(rng, *WIDTHS))}}
    return spec


# ---- shapes --------------------------------------------------------------------------------------------------------


def _drawn_shape(shape: dict[str, Any], number: int, where: object) -> tuple[dict[str, Any], str]:
    """Draw ``number`` of a shape that leaves its file, pose or seed to chance, and a word for what was drawn."""
    drawn, word = dict(shape), ""
    pattern = _pattern(shape.get("path"))
    seed = 0
    if pattern is not None or shape.get("rotation") == RANDOM:
        if shape.get("kind") != "sculpture":  # for files the seed has no other meaning than this
            drawn.pop("seed", None)
        seed = _whole(shape.get("seed", 0), where) if shape.get("seed") != RANDOM else 0
    if pattern is not None:
        drawn["path"] = _drawn_file(pattern, (seed, "shape.path", number), where)
        word = PurePath(drawn["path"]).stem
    if shape.get("seed") == RANDOM and shape.get("kind") == "sculpture":
        drawn["seed"] = derived_seed("shape.seed", number)
        word = f"sculpture_{drawn['seed']}"
    if shape.get("rotation") == RANDOM:
        drawn["rotation"] = _pose(random.Random(derived_seed(seed, "shape.rotation", number)))
    return drawn, word


def _whole(value: Any, where: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise InputError("shape.seed", got=repr(value)[:60], expected="a whole number from 0, or random", where=where)
    return value


def _pattern(path: Any) -> PathAsWritten | None:
    """``path`` if it is a pattern with * or ? and no file is called just that, otherwise None."""
    if not isinstance(path, str) or not any(sign in path for sign in "*?"):
        return None
    marked = path if isinstance(path, PathAsWritten) else PathAsWritten(path, path)
    return None if Path(marked.absolute).exists() else marked


def _drawn_file(pattern: PathAsWritten, seed: tuple[Any, ...], where: object) -> PathAsWritten:
    """One of the files that match ``pattern``: the one with the largest hash of ``seed`` and its contents.

    ``seed`` is (seed of the config, key, number of the draw). So the draw does not depend on where the files lie, and
    is the same after a file is added, unless the added file is drawn. Raises InputError if no file matches.
    """
    written, absolute = PurePath(str(pattern)), PurePath(pattern.absolute)
    wild = next(i for i, part in enumerate(written.parts) if any(sign in part for sign in "*?"))
    last = len(written.parts) - wild  # number of the parts from the first with a sign on
    folder, asked = Path(*absolute.parts[:-last]), str(PurePath(*absolute.parts[-last:]))
    found = sorted(path for path in folder.glob(asked) if path.is_file())
    if not found:
        raise InputError("shape.path: no file matches", got=str(pattern), expected=f"files in {folder}", where=where)
    best = max(found, key=lambda path: (derived_seed(*seed, digest_of_file(path)), path.as_posix()))
    beside = PurePath(*written.parts[:wild]) / best.relative_to(folder)
    return PathAsWritten(beside.as_posix(), str(best))


def _pose(rng: random.Random) -> list[float]:
    """Angles about x, then y, then z (degrees) of a uniform random rotation (K. Shoemake, Graphics Gems III, 1992)."""
    u, first, second = rng.random(), 2 * math.pi * rng.random(), 2 * math.pi * rng.random()
    x, y = math.sqrt(1 - u) * math.sin(first), math.sqrt(1 - u) * math.cos(first)
    z, w = math.sqrt(u) * math.sin(second), math.sqrt(u) * math.cos(second)
    about_x = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    about_y = math.asin(min(1.0, max(-1.0, 2 * (w * y - z * x))))
    about_z = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return [_short(math.degrees(angle)) for angle in (about_x, about_y, about_z)]


def _between(rng: random.Random, low: float, high: float) -> float:
    return low + (high - low) * rng.random()


def _short(value: float) -> float:
    """``value`` rounded to DIGITS significant digits, as every drawn number that is written to an item's config is."""
    return float(f"{value:.{DIGITS}g}")
