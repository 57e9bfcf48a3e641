"""The form of arrays of samples: which axis holds the colours (last, first, or a stack of grey pictures), what size."""

from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError

MOST_BYTES = 2 << 30  # of the samples of one picture as they are stored


def check_size(count: int, path: Path) -> None:
    """Raise InputError for a picture of more than MOST_BYTES bytes of samples, before they are read."""
    if count > MOST_BYTES:
        raise InputError(
            "a picture too large", got=f"{count / 2**30:.3g} GiB of samples", expected="2 or less", where=path
        )


def colours_last(values: np.ndarray, axes: str | None, path: Path) -> np.ndarray:
    """The array as (H, W) or (H, W, C).

    ``axes``: letters of tifffile for the axes (Y, X, S for samples, C for channels, others for stacks), or None if
    nobody names them; then the one axis of length 3 is that of colour, or of length 4, the last one first. Axes of
    length 1 are dropped. Raises InputError for what is no single picture.
    """
    axes = axes if axes is not None and len(axes) == values.ndim else None
    if values.ndim > 3 or (values.ndim == 3 and 1 in values.shape and values.shape[2] not in (3, 4)):
        kept = [n != 1 for n in values.shape]
        if kept.count(True) >= 2:
            axes = None if axes is None else "".join(letter for letter, keep in zip(axes, kept) if keep)
            values = values.reshape([n for n, keep in zip(values.shape, kept) if keep])
    if values.ndim == 2:
        return values
    if values.ndim != 3:
        got = f"an array of shape {values.shape}"
        raise InputError("a colour picture", got=got, expected="one picture of three channels", where=path)
    at = next((axes.index(letter) for letter in "SC" if letter in axes), None) if axes is not None else None
    if at is None:
        order = [a for n in (3, 4, 2) for a in (2, 0, 1) if values.shape[a] == n]
        at = order[0] if order else 2
    return np.moveaxis(values, at, -1)
