"""Reads a set from one npz file, the shortest way to bring photographs of one's own.

Arrays: ``pictures`` (L, H, W, 3), numbers of any type, times ``scale`` (1 without it) linear RGB per light intensity;
``mask`` (H, W); ``normals`` (H, W, 3) in the camera frame; ``light_directions`` (L, 3) toward the light, NaN where a
direction is not known.
"""

import zipfile
from functools import partial
from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.picture_size import require_size
from huesphere.render.photographs.photograph_set import StoredSet


def read_stack(path: Path) -> StoredSet:
    """The set in the npz ``path``. Raises InputError for a file that is not one, and for arrays that do not fit."""
    held = _arrays(path)
    pictures, mask = held["pictures"], held["mask"].astype(bool)
    if pictures.ndim != 4 or pictures.shape[3] != 3 or pictures.dtype.kind not in "uif":
        raise InputError("pictures", got=f"{pictures.dtype} {pictures.shape}", expected="(L, H, W, 3)", where=path)
    count, height, width, _ = pictures.shape
    directions = held.get("light_directions", np.full((count, 3), np.nan)).astype(np.float64)
    normals = held.get("normals")
    for name, array, shape in (
        ("mask", mask, (height, width)),
        ("light_directions", directions, (count, 3)),
        ("normals", normals, (height, width, 3)),
    ):
        if array is not None and array.shape != shape:
            raise InputError(name, got=f"shape {array.shape}", expected=str(shape), where=path)
    scale = held.get("scale", np.array(1.0)).astype(float)
    if scale.size != 1 or not 0 < float(scale.reshape(())) < np.inf:
        raise InputError("scale", got=str(scale), expected="a number above 0", where=path)
    if np.isinf(directions).any():
        raise InputError("light_directions", got="infinity", where=path)
    length = np.linalg.norm(directions, axis=1, keepdims=True)
    if (length == 0).any():
        raise InputError("light_directions", got="a direction of length 0", where=path)
    read = partial(_read, pictures, float(scale.reshape(())))
    return StoredSet("npz", directions / length, mask, normals, (path,), read)


def _arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays of the file that a set may have. Raises InputError."""
    try:
        require_size(path)
        with np.load(path, allow_pickle=False) as file:
            known = ("pictures", "mask", "normals", "light_directions", "scale")
            found = {name: file[name] for name in known if name in file.files}
            there = ", ".join(file.files)
    except FileNotFoundError:
        raise InputError("no such file", where=path) from None
    except InputError:
        raise
    except (OSError, ValueError, EOFError, KeyError, AttributeError, zipfile.BadZipFile) as error:
        raise InputError("not a readable npz", got=f"{type(error).__name__}: {error}"[:90], where=path) from None
    for name in ("pictures", "mask"):
        if name not in found:
            raise InputError(f"no array {name!r}", got=f"arrays {there}"[:90], where=path)
    return found


def _read(pictures: np.ndarray, scale: float, number: int) -> tuple[np.ndarray, np.ndarray]:
    one = pictures[number]
    clipped = np.zeros(one.shape[:2], bool)
    if one.dtype in (np.uint8, np.uint16):
        clipped = (one >= np.iinfo(one.dtype).max).any(axis=-1)
    return one.astype(np.float32) * np.float32(scale), clipped
