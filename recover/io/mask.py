"""Which pixels are the object, by a mask picture: bright or dark, 0 and 1, 0 and a label, or its alpha."""

from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.recover.io.files import read_stored
from huesphere.recover.io.orientation import is_turned, upright
from huesphere.recover.io.stored import ReadOptions, Stored

MOST_LISTED = 6


def read_mask(path: Path, shape: tuple[int, int]) -> tuple[np.ndarray, str]:
    """(the mask (H, W), how it was read, in a few words) in a picture of size ``shape``.

    A mask array or channel of the file is it; else alpha, if it varies; else the brightest of the channels. Where there
    are two values of which one is 0, the object is where it is not 0; else where it is over half of full scale. The
    mask is turned as its file says. Raises InputError, also where no pixel would be the object.
    """
    if not path.is_file():
        raise InputError("no such mask", where=path)
    stored = read_stored(path, ReadOptions())
    image, full, what = _coverage(stored)
    image = upright(image, stored.orientation)
    if image.shape != shape:
        raise InputError("mask and picture differ in size", got=str(image.shape), expected=str(shape), where=path)
    inside, rule = object_in(image, full, path)
    turned = " turned upright," if is_turned(stored.orientation) else ""
    return inside, f"mask {path.name}:{turned} object where {what} is {rule}, {int(inside.sum())} px"


def object_in(image: np.ndarray, full_scale: float | None, path: Path) -> tuple[np.ndarray, str]:
    """(where the object is, by what rule) for numbers (H, W) of that full scale; None: 1, or the largest if over 1.

    Raises InputError where nothing is the object, with the values that there are.
    """
    if image.dtype == bool:
        image, full_scale = image.astype(np.uint8), 1.0
    if image.dtype.kind not in "uif":
        raise InputError("a mask of numbers", got=str(image.dtype), where=path)
    finite = np.isfinite(image)
    found = np.unique(image[finite])
    if found.size == 0 or not found[-1] > 0:
        raise InputError("the mask is 0 everywhere: no pixel is the object", where=path)
    if len(found) == 1 or (len(found) == 2 and found[0] == 0):
        return finite & (image != 0), "not 0"
    top = float(found[-1])
    full = full_scale if full_scale is not None and top <= full_scale else max(1.0, top)
    inside = finite & (image > 0.5 * full)
    if not inside.any():
        few = len(found) <= MOST_LISTED
        values = f"values {', '.join(f'{v:g}' for v in found)}" if few else f"values from {found[0]:g} to {top:g}"
        expected = f"the object over {0.5 * full:g}, or one value beside 0"
        raise InputError("the mask is nowhere over half bright", got=values, expected=expected, where=path)
    return inside, "over half of full scale"


def varies(alpha: np.ndarray) -> bool:
    """Whether an alpha channel says anything: one that is the same everywhere does not."""
    return alpha.size > 0 and bool(np.nanmin(alpha) < np.nanmax(alpha))


def _coverage(stored: Stored) -> tuple[np.ndarray, float | None, str]:
    """(the numbers (H, W) that are the mask, full scale, which they are)."""
    if stored.mask is not None:
        return stored.mask, None, stored.mask_name
    if stored.alpha is not None and varies(stored.alpha):
        return stored.alpha, 1.0, "its alpha"
    values, full = stored.values, stored.full_scale
    if values.dtype.kind in "ui" and full is None:
        full = next((f for f in (1.0, 255.0, 65535.0) if values.size and values.max() <= f), None)
    return values if values.ndim == 2 else values[..., :3].max(axis=-1), full, "it"
