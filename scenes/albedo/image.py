"""A picture file as linear samples: PNG, JPEG, TIFF, EXR and npy, at the precision of the file."""

import logging
import os
from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.picture_size import require_size
from huesphere.scenes.encoding import decode_srgb

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # of linear sRGB: IEC 61966-2-1
SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr", ".npy")


def read_linear(path: Path, *, encoding: str, auto: str, channels: int) -> np.ndarray:
    """The samples (h, w, ``channels``) of a picture in linear light, float32, full scale 1; row 0 at the top.

    ``encoding``: "srgb", "linear", or "auto", which is ``auto`` for whole numbers and linear for others. One channel of
    a picture of three is its luminance, three of a picture of one are equal; an alpha channel is left out. Raises
    InputError for a file that is not there, cannot be read, or has values that are negative or not finite.
    """
    if not path.is_file():
        raise InputError("no such picture", where=path)
    if path.suffix.lower() not in SUFFIXES:
        raise InputError("a picture of another kind", got=path.suffix, expected=", ".join(SUFFIXES), where=path)
    require_size(path)
    try:
        stored = _stored(path)
    except InputError:
        raise
    except Exception as error:  # each reader has errors of its own for damaged files
        got = f"{type(error).__name__}: {str(error)[:60]}"
        raise InputError("not a readable picture", got=got, where=path) from None
    stored = stored[..., None] if stored.ndim == 2 else stored
    if stored.ndim != 3 or stored.shape[2] > 4 or 0 in stored.shape or stored.dtype.kind not in "uf":
        got = f"{stored.dtype} samples of shape {stored.shape}"
        raise InputError("a picture", got=got, expected="one or three channels of 8 or 16 bits or floats", where=path)
    stored = stored[..., : {1: 1, 2: 1, 3: 3, 4: 3}[stored.shape[2]]]
    whole = stored.dtype.kind == "u"
    samples = stored / np.iinfo(stored.dtype).max if whole else stored.astype(float)
    if not np.isfinite(samples).all() or samples.min() < 0:
        raise InputError("a picture with samples that are negative or not finite", where=path)
    if encoding == "srgb" or (encoding == "auto" and whole and auto == "srgb"):
        samples = decode_srgb(samples)
    if channels == 1 and samples.shape[2] == 3:
        samples = (samples @ LUMINANCE)[..., None]
    return np.ascontiguousarray(np.broadcast_to(samples, (*samples.shape[:2], channels)), dtype=np.float32)


def _stored(path: Path) -> np.ndarray:
    """The samples as the file holds them, (h, w) or (h, w, channels)."""
    suffix = path.suffix.lower()
    if suffix == ".npy":
        return np.load(path, allow_pickle=False)
    if suffix in (".tif", ".tiff"):
        import tifffile

        logging.getLogger("tifffile").setLevel(logging.CRITICAL)  # its exception becomes an InputError
        return np.asarray(tifffile.imread(path))
    if suffix == ".exr":
        return _exr(path)
    if suffix == ".png":
        import imagecodecs

        # Pillow reduces 16-bit colour to 8 bits without a word.
        return np.asarray(imagecodecs.png_decode(path.read_bytes()))
    import imageio.v3 as imageio

    return np.asarray(imageio.imread(path))


def _exr(path: Path) -> np.ndarray:
    """R, G and B of the first part, or its channel Y, or its only channel."""
    import OpenEXR

    from huesphere.configs.quiet import silence

    with silence(), OpenEXR.File(os.fsencode(path), separate_channels=True) as file:
        part = {name: np.array(channel.pixels) for name, channel in file.parts[0].channels.items()}
    if all(name in part for name in "RGB"):
        return np.stack([part[name] for name in "RGB"], axis=-1)
    if "Y" in part or len(part) == 1:
        return part.get("Y", next(iter(part.values())))
    raise InputError("no picture", got=f"channels {', '.join(part)[:60]}", expected="R, G, B or Y", where=path)
