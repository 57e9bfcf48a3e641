"""Reads a normal map that another program made (.npy, .npz, .exr or .png) as an estimate.

Frame: camera, x right, y up, z toward the camera; vectors of any length. A pixel has no normal where the vector is
zero or not finite, or where a PNG is black. A PNG holds (n + 1) / 2 of full scale, in 8 or 16 bits.
"""

from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.picture_size import require_size
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.io.picture import read_picture
from huesphere.render.exr import read_exr

SUFFIXES = (".npy", ".npz", ".exr", ".png")
NAMES = ("normals", "normal", "Normal_est", "Normal_gt")  # names of the array that is read from an .npz file


def read_normal_map(path: Path, method: str, shape: tuple[int, int]) -> Estimate:
    """Return the normal map in ``path`` as the estimate of a ``method``; all pixels with a normal are its inliers.

    ``shape``: (H, W) of the picture. Raises InputError for a damaged file, another size, or normals that mostly face
    away from the camera.
    """
    vectors = _vectors(path)
    if vectors.ndim == 3 and vectors.shape[0] == 3 and vectors.shape[-1] != 3:
        vectors = np.moveaxis(vectors, 0, -1)
    if vectors.shape != (*shape, 3):
        raise InputError("a normal map", got=f"shape {vectors.shape}", expected=f"{(*shape, 3)}", where=path)
    length = np.linalg.norm(vectors, axis=-1)
    valid = np.isfinite(length) & (length > 0)
    normals = np.full(vectors.shape, np.nan, dtype=np.float32)
    normals[valid] = vectors[valid] / length[valid, None]
    if valid.any() and np.median(normals[valid][:, 2]) < 0:
        expected = "x right, y up, z toward the camera (n_z > 0)"
        raise InputError("most normals face away from the camera", expected=expected, where=path)
    unknown = np.full(shape, np.nan, dtype=np.float32)
    return Estimate(method, "ok", "", normals, valid, valid, unknown, seconds=float("nan"))


def _vectors(path: Path) -> np.ndarray:
    """The vectors in a file, usually (H, W, 3). Raises InputError if it cannot be read or has no such array."""
    try:
        require_size(path)
        if path.suffix == ".npy":
            return np.asarray(np.load(path, allow_pickle=False), dtype=np.float64)
        if path.suffix == ".npz":
            with np.load(path, allow_pickle=False) as arrays:
                name = next((name for name in NAMES if name in arrays), arrays.files[0] if arrays.files else "")
                return np.asarray(arrays[name], dtype=np.float64)
    except InputError:
        raise
    except Exception as error:  # each reader has errors of its own for damaged files
        raise InputError("not a readable normal map", got=f"{type(error).__name__}: {error}", where=path) from None
    if path.suffix == ".exr":
        channels, _ = read_exr(path)
        for names in (("normal.X", "normal.Y", "normal.Z"), ("X", "Y", "Z"), ("R", "G", "B")):
            if all(name in channels for name in names):
                return np.stack([channels[name] for name in names], axis=-1).astype(np.float64)
        raise InputError("a normal map", got=f"channels {', '.join(channels)}", expected="X, Y, Z", where=path)
    observation, _ = read_picture(path, encoding="linear")
    coded = observation.rgb.astype(np.float64)
    return np.where(coded.any(axis=-1, keepdims=True), 2.0 * coded - 1.0, 0.0)
