"""Ways of violating an assumption that are more than one key of a scene's config, for the study `assumptions`.

The functions of SETTINGS change a config (a mapping) in place before it is validated, by a value of a curve; those of
PICTURES change a rendered picture. A curve whose key is in neither table varies that key of the config. ``folder`` is
where a function may write files that the config then names.
"""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.eval.studies.pictures import lights_around
from huesphere.render.dataset import Observation, read_observation, write_observation

Config = dict[str, Any]
FIRST_AZIMUTH_DEG = 20.0
CENTRES_NM = (610, 540, 460, 580, 500)  # centres of the bands of successive gels; neighbouring lights differ in colour
TILT_DEG = 27.0


def light_tilt(config: Config, tilt: float, folder: Path) -> None:
    """Put all lights at the off-axis angle ``tilt``, degrees; each keeps its azimuth."""
    for light in config["lights"]:
        x, y, _ = light["direction"]
        light["direction"] = lights_around(tilt, [np.degrees(np.arctan2(y, x))])[0].tolist()


def gel_width(config: Config, sigma: float, folder: Path) -> None:
    """Give all gels bands of standard deviation ``sigma`` nm; the wider they are, the more alike are their colours."""
    for light in config["lights"]:
        light["spectrum"]["gaussian"]["sigma"] = sigma


def light_count(config: Config, count: int, folder: Path) -> None:
    """Replace the lights by ``count`` gels at equal azimuths, TILT_DEG off the axis."""
    azimuths = FIRST_AZIMUTH_DEG + 360 * np.arange(count) / count
    config["lights"] = [
        {
            "kind": "distant",
            "direction": direction.tolist(),
            "spectrum": {"gaussian": {"centre": CENTRES_NM[i % len(CENTRES_NM)], "sigma": 25}},
        }
        for i, direction in enumerate(lights_around(TILT_DEG, azimuths))
    ]


def light_distance(config: Config, distance: float, folder: Path) -> None:
    """Replace every distant light by a point light at ``distance`` from the middle of the object, as bright there."""
    for light in config["lights"]:
        direction = np.asarray(light.pop("direction"), float)
        light |= {
            "kind": "point",
            "position": (distance * direction / np.linalg.norm(direction)).tolist(),
            "intensity": float(distance**2),
        }


def field_of_view(config: Config, degrees: float, folder: Path) -> None:
    """Use a perspective camera with this field of view."""
    config["camera"] |= {"projection": "perspective", "field_of_view": degrees}


def coat_index(config: Config, index: float, folder: Path) -> None:
    """Add a rough dielectric coat of this refractive index; the larger it is, the stronger the highlights."""
    config["surface"] = {"kind": "coated", "reflectance": config["surface"]["reflectance"], "index": index}


def ambient(config: Config, intensity: float, folder: Path) -> None:
    """Add white ambient light."""
    if intensity > 0:
        config["lights"].append({"kind": "ambient", "spectrum": "D65", "intensity": intensity})


def width(config: Config, pixels: int, folder: Path) -> None:
    """Render ``pixels`` × ``pixels``."""
    config["camera"]["resolution"] = [pixels, pixels]


def attitude(config: Config, degrees: float, folder: Path) -> None:
    """Replace the built-in bust, a relief, by a mesh of it that is rotated by ``degrees`` about the vertical.

    Raises InputError for any other shape.
    """
    if config["shape"]["kind"] != "bust":
        raise InputError("attitude", got=config["shape"]["kind"], expected="shape: {kind: bust}", where="curves")
    path = folder / "bust.ply"
    if not path.is_file():
        import trimesh

        from huesphere.scenes.bust import bust_mesh

        mesh = bust_mesh(config["shape"].get("detail", 180))
        folder.mkdir(parents=True, exist_ok=True)
        trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_normals=mesh.normals, process=False).export(path)
    config["shape"] = {"kind": "mesh", "path": str(path.resolve()), "rotation": [0.0, float(degrees), 0.0]}


SETTINGS: dict[str, Callable[[Config, Any, Path], None]] = {
    "light_tilt": light_tilt,
    "gel_width": gel_width,
    "light_count": light_count,
    "light_distance": light_distance,
    "field_of_view": field_of_view,
    "coat_index": coat_index,
    "ambient": ambient,
    "width": width,
    "attitude": attitude,
}


def gamma(observation: Observation, exponent: float) -> Observation:
    """The picture with samples ρ^(1/γ) that are still declared linear; ``exponent`` is γ."""
    encoded = np.clip(observation.rgb, 0, None).astype(np.float64) ** (1 / exponent)
    return replace(observation, rgb=encoded.astype(np.float32))


PICTURES: dict[str, Callable[[Observation, Any], Observation]] = {"gamma": gamma}


def changed_picture(run: Path, item: str, key: str, value: Any) -> str:
    """Copy an item of a run and change the copy's picture by PICTURES[key]; returns the copy's id."""
    config, transport = item.rsplit("/", 1)
    copy = f"{config}-{key}_{value}/{transport}"
    if not (run / copy / "observation.exr").is_file():
        shutil.copytree(run / item, run / copy, ignore=shutil.ignore_patterns("estimates", "observation.exr"))
        write_observation(
            run / copy / "observation.exr", PICTURES[key](read_observation(run / item / "observation.exr"), value)
        )
    return copy
