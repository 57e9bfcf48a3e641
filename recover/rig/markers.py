"""Dark markers on a sheet of gel: found as pixels darker than their surroundings, and interpolated."""

import numpy as np
from numba import njit
from scipy import ndimage

DARKER = 0.9  # of the mean brightness around: a pixel below is taken for a marker
WINDOW = 0.07  # of the picture's width: side of the surroundings, some twice a marker and its distance to the next
GROWN = 0.006  # of the picture's width: about a marker, where it may have moved from; light is mixed within a pixel
MARKED = 0.01  # share of a reference picture's pixels from which it has markers
REACH = (3, 9, 27)  # pixels: half sides of the windows over which gaps are interpolated, the narrow ones first


def dark_spots(rgb: np.ndarray) -> np.ndarray:
    """Markers of a picture (H, W, 3) of positive linear light, grown by GROWN: (H, W) bool."""
    brightness = rgb[..., 0] + rgb[..., 1] + rgb[..., 2]
    side = max(5, round(WINDOW * brightness.shape[1]))
    dark = brightness < DARKER * ndimage.uniform_filter(brightness, side, mode="nearest")
    grown = max(1, round(GROWN * brightness.shape[1]))
    return np.asarray(ndimage.maximum_filter(dark, 2 * grown + 1))


def has_markers(reference: np.ndarray) -> bool:
    """Whether a reference picture (H, W, 3), linear light, carries markers."""
    brightness = reference.sum(axis=-1)
    side = max(5, round(WINDOW * brightness.shape[1]))
    about = ndimage.uniform_filter(brightness, side, mode="nearest")
    return bool((brightness < DARKER**2 * about).mean() > MARKED)


def interpolated(image: np.ndarray, known: np.ndarray) -> np.ndarray:
    """``image`` (H, W, 3) with each pixel that is not ``known`` replaced by the mean of the known ones around it.

    The window is the smallest of REACH that has a known pixel; where none has one, the result is 0.
    """
    out = image.astype(np.float32)
    _fill(out, image, known, np.array(REACH))
    return out


@njit(cache=True)  # type: ignore[untyped-decorator]
def _fill(out: np.ndarray, image: np.ndarray, known: np.ndarray, reaches: np.ndarray) -> None:
    height, width = known.shape
    for i in range(height):
        for j in range(width):
            if known[i, j]:
                continue
            a, b, c, count = 0.0, 0.0, 0.0, 0
            for reach in reaches:
                for k in range(max(0, i - reach), min(height, i + reach + 1)):
                    for l in range(max(0, j - reach), min(width, j + reach + 1)):
                        if known[k, l]:
                            a += image[k, l, 0]
                            b += image[k, l, 1]
                            c += image[k, l, 2]
                            count += 1
                if count > 0:
                    break
            count = max(count, 1)
            out[i, j, 0], out[i, j, 1], out[i, j, 2] = a / count, b / count, c / count
