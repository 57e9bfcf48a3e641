"""Exports items in the folder layout of DiLiGenT, which code for photometric stereo can read without changes.

B. Shi et al., "A benchmark dataset and evaluation for non-Lambertian and uncalibrated photometric stereo", CVPR 2016:
a folder <object>PNG for each object with one 16-bit picture per light, the lights' directions and intensities, a mask
and the true normals, in the camera frame (x right, y up, z toward the camera). In DiLiGenT an object has 96 exposures
under one light each. Here the pictures under single lights are computed from the item's layers.exr: they have no camera
noise, and all bounces of the item's transport.
"""

import re
import struct
import zlib
from pathlib import Path

import numpy as np
import scipy.io
from PIL import Image

from huesphere.configs.errors import InputError
from huesphere.configs.own_folder import inside
from huesphere.eval.score import Item
from huesphere.render.dataset import read_truth
from huesphere.render.layers import Layers, layers_of


def export_diligent(item: Item, folder: Path) -> Path:
    """Write <folder>/<config>_<transport>PNG and return it.

    Where light comes directly, a pixel's value is the light's intensity times n · l (albedo 1), so an image divided by
    its line of light_intensities.txt is the shading. Full scale is the brightest sample of all images.

    Raises InputError if the item has no layers.exr or a light is not a distant one.
    """
    layers, truth = layers_of(item.folder), read_truth(inside(item.folder, "truth.exr"))
    directions = _directions(layers, truth.facts.get("lights") or [], item)
    lit = [layers.of_light(light) for light in range(len(layers.lights))]
    scale = max(float(np.max(image)) for image in lit) or 1.0
    into = folder / f"{re.sub(r'[^A-Za-z0-9._-]+', '-', item.id)}PNG"
    into.mkdir(parents=True, exist_ok=True)
    names = [f"{number:03}.png" for number in range(1, len(lit) + 1)]
    for name, image in zip(names, lit, strict=True):
        write_png16(into / name, image / scale)
    Image.fromarray(np.where(truth.mask, 255, 0).astype(np.uint8)).save(into / "mask.png")
    normals = np.nan_to_num(truth.normals.astype(np.float64))
    scipy.io.savemat(into / "Normal_gt.mat", {"Normal_gt": normals}, do_compression=True)
    write_png16(into / "Normal_gt.png", np.where(truth.mask[..., None], (normals + 1.0) / 2.0, 0.0))
    np.savetxt(into / "normal.txt", normals.reshape(-1, 3), fmt="%.7g")
    np.savetxt(into / "light_directions.txt", directions, fmt="%.9g")
    np.savetxt(into / "light_intensities.txt", _intensities(layers) / scale, fmt="%.9g")
    (into / "filenames.txt").write_text("".join(f"{name}\n" for name in names))
    return into


def write_png16(path: Path, image: np.ndarray) -> None:
    """Write numbers (H, W, 3), clipped to 0 … 1, as a PNG with 16 bits a sample, which Pillow does not support."""
    samples = np.rint(np.clip(image, 0.0, 1.0) * 65535).astype(">u2")
    height, width, _ = samples.shape
    rows = b"".join(b"\0" + row.tobytes() for row in samples)  # filter 0, none, before each row

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 16, 2, 0, 0, 0)  # 16 bits, RGB
    parts = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows, 6)) + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + parts)


def _directions(layers: Layers, lights: list[dict[str, object]], item: Item) -> np.ndarray:
    """Unit directions (L, 3) toward the lights. Raises InputError for a light that has none."""
    found = {str(light.get("name")): light.get("direction") for light in lights}
    for name in layers.lights:
        if found.get(name) is None:
            raise InputError("a light without one direction", got=name, expected="distant lights", where=item.folder)
    directions = np.array([found[name] for name in layers.lights], dtype=np.float64)
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def _intensities(layers: Layers) -> np.ndarray:
    """Colour (L, 3) of each light on the first material; 1 if the reference engine made the layers."""
    if "direct" not in layers.names:
        return np.ones((len(layers.lights), 3))
    return layers.colours[:, layers.names.index("direct"), 0]
