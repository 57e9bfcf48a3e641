"""Arrays of NumPy: .npy, and .npz with an array ``rgb`` and perhaps a ``mask``."""

from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.recover.io.axes import colours_last
from huesphere.recover.io.stored import Stored

NAMES = ("rgb", "image", "picture", "mask")


def read_arrays(path: Path) -> Stored:
    """The picture in a .npy or .npz file. NumPy's errors pass through."""
    loaded = np.load(path, allow_pickle=False)
    if isinstance(loaded, np.ndarray):
        return _stored(loaded, path, None)
    with loaded as file:
        name = next((n for n in NAMES if n in file), None)
        if name is None:
            raise InputError("no array 'rgb'", got=f"arrays {', '.join(file.files)}", where=path)
        return _stored(file[name], path, file.get("mask"))


def _stored(values: np.ndarray, path: Path, mask: np.ndarray | None) -> Stored:
    values = colours_last(values, None, path)
    alpha, remarks = None, []
    whole = values.dtype in (np.uint8, np.uint16)
    bits = 8 * values.dtype.itemsize if whole else None
    full = 2.0**bits - 1 if bits else None
    if values.ndim == 3 and values.shape[2] > 3:
        if values.shape[2] == 4 and values.dtype.kind in "uf":
            alpha = values[..., 3] / (full or 1.0)
        remarks += [] if alpha is not None else [f"the first three of {values.shape[2]} channels"]
        values = values[..., :3]
    return Stored(values, full, bits, alpha=alpha, mask=mask, ambiguous=bits == 16, remarks=tuple(remarks))
