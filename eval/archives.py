"""Exports an item and its estimates as a NumPy archive (.npz), for programs that do not read OpenEXR."""

from dataclasses import asdict
from pathlib import Path

import numpy as np

from huesphere.configs.own_folder import inside, replacing
from huesphere.eval.score import Item, methods_on_disk
from huesphere.recover.io.estimate import read_estimate
from huesphere.render.dataset import lights_seen, read_observation, read_truth


def export_npz(item: Item, folder: Path) -> Path:
    """Write <folder>/<config>/<transport>.npz and return it.

    Arrays: rgb (H, W, 3), linear light of full scale 1, and mask (H, W); of the truth normals (H, W, 3), depth (H, W)
    in pixels, and lights_seen (H, W) float32, the number of lights that a pixel sees, a half hidden light as one half.
    Where known, F (3, 3) and light_directions (number of distant lights, 3), toward each light that has a direction, in
    the order of the lights but without those that have a position only. camera_<field> for each field of the camera;
    estimate/<method>/normals and estimate/<method>/valid for each method. Raises InputError for damaged files.
    """
    observation = read_observation(inside(item.folder, "observation.exr"))
    truth = read_truth(inside(item.folder, "truth.exr"))
    arrays: dict[str, np.ndarray] = {
        "rgb": observation.rgb,
        "mask": observation.mask,
        "normals": truth.normals,
        "depth": truth.depth,
        "lights_seen": lights_seen(truth),
    }
    arrays |= {f"camera_{k}": np.asarray(np.nan if v is None else v) for k, v in asdict(observation.camera).items()}
    directions = [light["direction"] for light in truth.facts.get("lights") or () if light.get("direction") is not None]
    if directions:
        arrays["light_directions"] = np.array(directions, dtype=np.float64)
    if truth.facts.get("F") is not None:
        arrays["F"] = np.array(truth.facts["F"], dtype=np.float64)
    for method in methods_on_disk(item):
        estimate, _ = read_estimate(item.estimates_of(method) or item.folder / "estimates", method)
        arrays[f"estimate/{method}/normals"] = estimate.normals
        arrays[f"estimate/{method}/valid"] = estimate.valid
    path = folder / item.config / f"{item.transport}.npz"
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as partial, partial.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
    return path
