"""Reads the samples of a normal map from a file, as they are: no colour management, no decoding, no frame.

Formats: NumPy (.npy, .npz), MATLAB up to version 7 (.mat), OpenEXR (.exr), TIFF (.tif, .tiff), PNG and JPEG of 8 or 16
bits. Axes may be (H, W, C) or (C, H, W), and a batch of one is taken out of its batch. A fourth channel is alpha.
"""

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.picture_size import require_size
from huesphere.recover.io.raster import colours_of_16_bits
from huesphere.render.exr import read_exr

SUFFIXES = (".npy", ".npz", ".mat", ".exr", ".tif", ".tiff", ".png", ".jpg", ".jpeg")
NAMES = ("normals", "normal", "Normal_est", "Normal_gt")  # of the array that is read where a file has several
MASKS = ("mask", "valid", "alpha")  # of an array that says which pixels of the map count
CHANNELS = ("XYZ", "RGB", "xyz", "rgb")


@dataclass(frozen=True)
class Samples:
    """The samples of a file."""

    values: np.ndarray  # (H, W, 3) float64
    counts: np.ndarray  # (H, W) bool, False where the file itself says that there is no normal
    full_scale: float | None  # of unsigned whole numbers: their greatest value; None for other numbers


def read_samples(path: Path) -> Samples:
    """The samples of the normal map in ``path``. Raises InputError if it cannot be read or is no map of vectors."""
    suffix = path.suffix.lower()
    try:
        require_size(path)
        if suffix == ".exr":
            return _of_channels(read_exr(path)[0], path)
        if suffix == ".npy":
            return _of_array(np.load(path, allow_pickle=False), None, path)
        if suffix == ".npz":
            with np.load(path, allow_pickle=False) as file:
                return _of_archive({name: file[name] for name in file.files}, path)
        if suffix == ".mat":
            return _of_archive(_matlab_arrays(path), path)
        if suffix in (".tif", ".tiff"):
            import tifffile

            logging.getLogger("tifffile").setLevel(logging.CRITICAL)  # what it cannot read is told below
            return _of_array(tifffile.imread(path), None, path)
        return _of_array(_picture(path), None, path)
    except InputError:
        raise
    except Exception as error:  # readers of pictures raise types of their own
        text = f"{type(error).__name__}: {str(error)[:100]}"
        raise InputError("not a readable normal map", got=text, where=path) from None


def _of_array(array: np.ndarray, mask: np.ndarray | None, path: Path) -> Samples:
    """The samples of an array of three or four channels."""
    if array.dtype.kind not in "uif":
        raise InputError("a normal map", got=f"numbers of type {array.dtype}", expected="real numbers", where=path)
    while array.ndim > 3 and array.shape[0] == 1:
        array = array[0]
    if array.ndim == 3 and array.shape[0] in (3, 4) and array.shape[-1] not in (3, 4):
        array = np.moveaxis(array, 0, -1)
    if array.ndim != 3 or array.shape[-1] not in (3, 4):
        raise InputError("a normal map", got=f"shape {array.shape}", expected="(height, width, 3)", where=path)
    full_scale = float(np.iinfo(array.dtype).max) if array.dtype.kind == "u" else None
    values = array.astype(np.float64)
    counts = np.ones(array.shape[:2], dtype=bool)
    if array.shape[-1] == 4:
        alpha = values[..., 3]
        counts &= alpha > 0.5 * (full_scale or (255.0 if np.nanmax(alpha, initial=0.0) > 1.5 else 1.0))
    if mask is not None and mask.squeeze().shape == counts.shape:
        counts &= np.asarray(mask.squeeze() != 0)
    return Samples(values[..., :3], counts, full_scale)


def _of_archive(arrays: Mapping[str, Any], path: Path) -> Samples:
    """The samples of the one array that is a map of vectors, or that has one of NAMES."""
    fitting = [name for name, array in arrays.items() if np.ndim(array) >= 3 and {3, 4} & set(np.shape(array))]
    named = [name for name in NAMES if name in arrays]
    if not named and len(fitting) != 1:
        got = f"arrays {', '.join(arrays) or 'none'}"
        raise InputError("which array is the normal map?", got=got, expected=f"one named {NAMES[0]}", where=path)
    mask = next((np.asarray(arrays[name]) for name in MASKS if name in arrays), None)
    return _of_array(np.asarray(arrays[(named or fitting)[0]]), mask, path)


def _of_channels(channels: Mapping[str, np.ndarray], path: Path) -> Samples:
    """The samples of the channels X Y Z or R G B of an EXR file, of the layer whose name says that it holds normals."""
    layers = list(dict.fromkeys(name.rpartition(".")[0] for name in channels))
    found = []
    for layer in layers:
        prefix = f"{layer}." if layer else ""
        for letters in CHANNELS:
            names = [f"{prefix}{letter}" for letter in letters]
            if all(name in channels for name in names):
                found.append((layer, names, f"{prefix}A"))
                break
    if not found:
        got = f"channels {', '.join(sorted(channels)[:12])}"
        raise InputError("a normal map", got=got, expected="X, Y, Z or R, G, B", where=path)
    by_name = [one for one in found if "normal" in one[0].lower()] or [one for one in found if not one[0]] or found
    if len(by_name) > 1:
        got = f"layers {', '.join(layer for layer, *_ in by_name)}"
        raise InputError("which layer is the normal map?", got=got, expected="one", where=path)
    _, names, alpha = by_name[0]
    values = np.stack([channels[name] for name in names], axis=-1).astype(np.float64)
    counts = channels[alpha] > 0.5 if alpha in channels else np.ones(values.shape[:2], dtype=bool)
    return Samples(values, np.asarray(counts), None)


def _matlab_arrays(path: Path) -> dict[str, Any]:
    """The arrays of a MATLAB file. Raises InputError for version 7.3, which is another format (HDF5)."""
    from scipy.io import loadmat

    try:
        return {name: array for name, array in loadmat(path).items() if not name.startswith("__")}
    except NotImplementedError:
        raise InputError("a MATLAB file of version 7.3", expected="one saved with save(…, '-v7')", where=path) from None


def _picture(path: Path) -> np.ndarray:
    """PNG or JPEG as uint8 or uint16 (H, W, C), with its alpha."""
    from PIL import Image

    with Image.open(path) as picture:
        deep = colours_of_16_bits(picture, path)
        if deep is not None:
            return deep
        if picture.mode == "P" or "transparency" in picture.info:
            return np.asarray(picture.convert("RGBA"))
        return np.asarray(picture if picture.mode in ("L", "LA", "RGB", "RGBA") else picture.convert("RGB"))
