"""Dark markers on a sheet of gel: found as pixels darker than their surroundings, and interpolated."""

import numpy as np
from scipy import ndimage

DARKER = 0.9  # of the mean brightness around: a pixel below is taken for a marker
WINDOW = 0.07  # of the picture's width: side of the surroundings, some twice a marker and its distance to the next
GROWN = 2  # pixels about a marker whose light is mixed with its own, or that it may have moved from
MARKED = 0.01  # share of a reference picture's pixels from which it has markers
REACH = (3, 9, 27)  # pixels: half sides of the windows over which gaps are interpolated, the narrow ones first


def dark_spots(rgb: np.ndarray) -> np.ndarray:
    """Markers of a picture (H, W, 3) of positive linear light, grown by GROWN pixels: (H, W) bool."""
    brightness = np.log(np.maximum(rgb.sum(axis=-1), 1e-6)).astype(np.float32)
    side = max(5, round(WINDOW * brightness.shape[1]))
    about = ndimage.uniform_filter(brightness, side, mode="nearest")
    dark = brightness < about + np.float32(np.log(DARKER))
    return np.asarray(ndimage.maximum_filter(dark, 2 * GROWN + 1))


def has_markers(reference: np.ndarray) -> bool:
    """Whether a reference picture (H, W, 3), linear light, carries markers."""
    brightness = reference.sum(axis=-1)
    side = max(5, round(WINDOW * brightness.shape[1]))
    about = ndimage.uniform_filter(brightness, side, mode="nearest")
    return bool((brightness < DARKER**2 * about).mean() > MARKED)


def interpolated(image: np.ndarray, known: np.ndarray) -> np.ndarray:
    """``image`` (H, W, C) with the pixels that are not ``known`` replaced by means of known ones near them.

    Means over ever larger windows are taken until there is a known pixel in one; what is farther than the largest is 0.
    """
    out = np.where(known[..., None], image, np.float32(0)).astype(np.float32)
    weight = known.astype(np.float32)
    missing = ~known
    for reach in REACH:
        if not missing.any():
            break
        total = ndimage.uniform_filter(out * weight[..., None], (2 * reach + 1, 2 * reach + 1, 1), mode="nearest")
        share = ndimage.uniform_filter(weight, 2 * reach + 1, mode="nearest")
        there = missing & (share > 0.2 / (2 * reach + 1))
        out[there] = total[there] / share[there][:, None]
        missing &= ~there
    return out
