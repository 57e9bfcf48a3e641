"""One item of a run as arrays for training: the picture, its mask, and what is wanted of the truth.

Frame: camera, x right, y up, z toward the camera, image row 0 at the top. Off the object normals, depth and albedo are
NaN.
"""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.schema import RunConfig
from huesphere.configs.suggest import suggested
from huesphere.render.dataset import Observation, RunItem, Truth
from huesphere.render.inputs import content_of
from huesphere.render.layers import Layers
from huesphere.scenes.build import scene_reflectances
from huesphere.scenes.cameras import sensitivity

CONTENTS = {  # what may go in beside the picture and its mask, and what each name adds
    "normals": "normals (H, W, 3): unit normals",
    "depth": "depth (H, W): toward the camera, in pixels",
    "albedo": "albedo (H, W, 3): reflectance as the camera sees it under light of equal energy, ∫ S Q dλ / ∫ Q dλ",
    "masks": "attached_shadow, cast_shadow (H, W, L): share of each light that is lost to shadow; lights_seen (H, W)",
    "layers": "direct, indirect (H, W, L, 3): the picture without noise, by light, and before or after reflections",
    "lights": "light_directions, light_positions (L, 3): unit vectors, and pixels from the picture's middle, NaN where "
    "a light has none; colour_matrix (3, 3): the F of colour = F normal where every light is seen, NaN if none",
}
USUAL = ("normals", "depth", "masks", "lights")  # what goes in if nothing is said


@dataclass(frozen=True)
class Sample:
    """A picture with its truth, as arrays."""

    id: str  # of the item, "<config>/<transport>"
    images: dict[str, np.ndarray]  # by name, (H, W) or (H, W, …): rgb and mask, and those of CONTENTS
    vectors: dict[str, np.ndarray]  # (…, 3) in the camera frame: principal_point (3,), and those of "lights"
    facts: dict[str, Any]  # that are no arrays, as JSON has them: transport, geometry, camera, names of the lights


def parse_contents(text: str) -> tuple[str, ...]:
    """The names of CONTENTS in a comma-separated text. Raises InputError for others."""
    return require_contents([name.strip() for name in text.split(",") if name.strip()])


def require_contents(names: Sequence[str]) -> tuple[str, ...]:
    """``names`` without repetition. Raises InputError for one that is not in CONTENTS."""
    for name in names:
        if name not in CONTENTS:
            expected = suggested(name, CONTENTS, f"of {', '.join(CONTENTS)}")
            raise InputError("what goes into the data set", got=name, expected=expected)
    return tuple(dict.fromkeys(names))


def geometry_key(config: RunConfig) -> str:
    """16 hexadecimal digits that name the shape of a config: equal for the same shape under any light and camera."""
    text = json.dumps(content_of(config)["shape"], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def read_sample(item: RunItem, contents: Sequence[str] = USUAL) -> Sample:
    """Read an item. Raises InputError for damaged files, and for contents that the item does not have."""
    seen, truth, config = item.observation(), item.truth(), item.config()
    if seen.mask.shape != truth.mask.shape:
        raise InputError("picture and truth of different sizes", got=str(truth.mask.shape), where=item.folder)
    images: dict[str, np.ndarray] = {"rgb": seen.rgb, "mask": seen.mask & truth.mask}
    vectors: dict[str, np.ndarray] = {"principal_point": np.zeros(3, np.float32)}
    if "normals" in contents:
        images["normals"] = truth.normals
    if "depth" in contents:
        images["depth"] = truth.depth
    if "albedo" in contents:
        images["albedo"] = _albedo(config, truth)
    if "masks" in contents:
        images["attached_shadow"], images["cast_shadow"] = truth.attached_shadow, truth.cast_shadow
        images["lights_seen"] = np.sum(1 - truth.attached_shadow - truth.cast_shadow, axis=-1)
    if "layers" in contents:
        images["direct"], images["indirect"] = _by_light(item.layers())
    if "lights" in contents:
        vectors |= _lights(truth)
    facts = {"geometry": geometry_key(config), "transport": item.transport} | _facts(seen, truth, item.entry)
    return Sample(item.id, {k: _stored(v) for k, v in images.items()}, vectors, facts)


def _stored(image: np.ndarray) -> np.ndarray:
    """An image in the type in which data sets hold it: float32, or bool for masks."""
    return np.ascontiguousarray(image, dtype=bool if image.dtype == bool else np.float32)


def _facts(seen: Observation, truth: Truth, entry: dict[str, Any]) -> dict[str, Any]:
    """What is said of a sample beside its arrays. ``entry``: of the item in the manifest."""
    camera = {k: v for k, v in asdict(seen.camera).items() if k != "encoding"}
    lights = [str(light.get("name")) for light in truth.facts.get("lights") or ()]
    return {"camera": camera, "lights": lights, "seed": entry.get("seed"), "engine": entry.get("engine")}


def _albedo(config: RunConfig, truth: Truth) -> np.ndarray:
    """∫ S Q dλ / ∫ Q dλ of each pixel's reflectance, (H, W, 3); NaN off the object."""
    if "albedo.R" in truth.extra:
        return np.stack([truth.extra[f"albedo.{channel}"] for channel in "RGB"], axis=-1)
    camera = sensitivity(config.camera.sensitivity)
    by_material = scene_reflectances(config)[0] @ camera / camera.sum(axis=0)
    number = np.nan_to_num(truth.extra.get("material", np.zeros(truth.mask.shape))).astype(int)
    return np.where(truth.mask[..., None], by_material[np.maximum(number, 0)], np.nan)


def _by_light(layers: Layers) -> tuple[np.ndarray, np.ndarray]:
    """Direct and indirect light of each source, (H, W, L, 3) each, in picture units."""
    count = range(len(layers.lights))
    direct = [layers.rgb(light, "direct") for light in count]
    indirect = [layers.rgb(light, "one_bounce") + layers.rgb(light, "rest") for light in count]
    return np.stack(direct, axis=2), np.stack(indirect, axis=2)


def _lights(truth: Truth) -> dict[str, np.ndarray]:
    """Directions, positions in pixels, and F, from the facts of the truth."""
    lights = truth.facts.get("lights") or []
    unknown = [np.nan] * 3
    directions = np.array([light.get("direction") or unknown for light in lights], float).reshape(-1, 3)
    places = [light.get("position") or light.get("centre") or unknown for light in lights]
    positions = np.array(places, float).reshape(-1, 3) / truth.facts.get("pixel_size", np.nan)
    F = truth.facts.get("F")
    found = {
        "light_directions": directions / np.linalg.norm(directions, axis=1, keepdims=True),
        "light_positions": positions,
        "colour_matrix": np.array(F if F is not None else [unknown] * 3, float),
    }
    return {name: values.astype(np.float32) for name, values in found.items()}
