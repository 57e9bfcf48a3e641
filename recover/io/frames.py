"""Dark and flat frames: what the sensor gives without light, and how unevenly it sees an even surface.

(picture − dark) / (flat − dark), with the flat frame scaled to a median of 1 in each channel, so that colours stay.
Frames are in the orientation of the sensor, and are applied before a picture is turned upright.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError

LEAST_FLAT = 0.02  # of the flat frame's median: where it is darker, the picture cannot be divided by it
MOST_CLIPPED = 0.01  # share of a flat frame's pixels that may be clipped


@dataclass(frozen=True)
class Frame:
    """A dark or flat frame in linear light."""

    light: np.ndarray  # (H, W, 3)
    clipped: np.ndarray | None  # (H, W) bool
    path: Path


@dataclass(frozen=True)
class Corrected:
    """The picture less its dark frame, divided by its flat frame."""

    light: np.ndarray  # (H, W, 3); NaN where the flat frame is too dark; 1 in clipped channels, less elsewhere
    saturation: float | None  # 1, or None if nothing clips
    words: tuple[str, ...]  # what was done, for the log


def correct(light: np.ndarray, clipped: np.ndarray | None, dark: Frame | None, flat: Frame | None) -> Corrected:
    """The corrected picture, of ``light`` (H, W, 3) and ``clipped`` (H, W) as it was taken. Raises InputError."""
    for frame in (dark, flat):
        if frame is not None and frame.light.shape != light.shape:
            got, expected = (f"{shape[1]}×{shape[0]} pixels" for shape in (frame.light.shape, light.shape))
            raise InputError("a frame of another size than the picture", got=got, expected=expected, where=frame.path)
    words = []
    black = np.zeros(3) if dark is None else dark.light
    if dark is not None:
        if not np.nanmedian(light) >= np.nanmedian(dark.light):
            raise InputError("a dark frame that is brighter than the picture", where=dark.path)
        words.append(f"dark frame {dark.path.name} subtracted (mean {np.nanmean(dark.light):.3g} of full scale)")
    light = light - black
    if flat is not None:
        gain = _gain(flat, black)
        unknown = np.asarray(~(gain > LEAST_FLAT).all(axis=-1))
        light = np.where(unknown[..., None], np.nan, light / np.where(unknown[..., None], 1.0, gain))
        low, high = np.nanpercentile(gain[~unknown], [1, 99])
        words.append(f"divided by flat frame {flat.path.name} ({low:.2f} to {high:.2f} of its median)")
        if unknown.any():
            words.append(f"{int(unknown.sum())} px where it is dark are not used")
    if clipped is None:
        return Corrected(light, None, tuple(words))
    good = np.isfinite(light).all(axis=-1) & ~clipped
    top = float(light[good].max()) if good.any() else 0.0
    light = light / max(1.0, top * (1 + 1e-3))
    light = np.where(clipped[..., None], np.fmax(light, 1.0), light)
    return Corrected(light, 1.0, tuple(words))


def _gain(flat: Frame, black: np.ndarray) -> np.ndarray:
    """How bright the even surface looks at each pixel (H, W, 3), median 1 in each channel. Raises InputError."""
    if flat.clipped is not None and flat.clipped.mean() > MOST_CLIPPED:
        got = f"{flat.clipped.mean():.0%} of its pixels"
        raise InputError(
            "a flat frame that is clipped", got=got, expected=f"{MOST_CLIPPED:.0%} or less", where=flat.path
        )
    even = flat.light - black
    middle = np.nanmedian(even, axis=(0, 1))
    if not (middle > 0).all():
        raise InputError("a flat frame without light", got=f"median {np.round(middle, 6).tolist()}", where=flat.path)
    return np.asarray(even / middle)
