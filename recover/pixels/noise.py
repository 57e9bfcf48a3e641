"""The noise of a picture: as its camera reports it, and as second differences of the picture show it.

J. Immerkær, "Fast noise variance estimation", Computer Vision and Image Understanding 64 (1996), 300–302.
"""

import numpy as np
from scipy import ndimage

from huesphere.recover.pixels.parameters import PIXELS
from huesphere.recover.robust_scale import mad_scale
from huesphere.render.dataset import CameraInfo

LAPLACIAN = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]]) / 6  # Immerkær (1996): noise gain 1
LOW_QUANTILE = 0.1  # of the windows: those with the least second differences
# Side of a window in pixels → root mean square of second differences, at LOW_QUANTILE, of pure noise of deviation 1.
# Computed, not chosen, and right to 3 %: ``tests/test_recover_pixels_noise.py`` computes it again.
PURE_NOISE = {7: 0.87, 3: 0.70}


def picture_noise(rgb: np.ndarray, usable: np.ndarray) -> float:
    """Standard deviation of the noise of a channel of the picture (H, W, 3), from second differences (Immerkær 1996).

    Texture adds to second differences, so the noise is measured in the tenth of all windows in which they are least.
    ``usable`` (H, W); NaN where too few windows are wholly usable. Picture units.
    """
    grain = np.stack([ndimage.convolve(rgb[..., c], LAPLACIAN) for c in range(3)], axis=-1)
    for window, of_pure_noise in PURE_NOISE.items():
        whole = ndimage.binary_erosion(usable, np.ones((window + 2, window + 2)))
        if whole.sum() >= PIXELS.fewest_pixels:
            power = ndimage.uniform_filter((grain**2).mean(axis=-1), window)[whole]
            return float(np.sqrt(np.quantile(power, LOW_QUANTILE))) / of_pure_noise
    return float("nan")


def camera_noise(camera: CameraInfo, level: float) -> float:
    """Standard deviation of a channel at ``level`` (full scale 1) that the camera reports; 0 where it reports none.

    Read noise, shot noise (``level`` / full well) and quantisation noise add up as variances.
    """
    variance = camera.read_noise**2
    if camera.full_well:
        variance += max(level, 0.0) / camera.full_well
    if camera.bits:
        variance += 1 / (12 * (2**camera.bits - 1) ** 2)
    return float(np.sqrt(variance))


def channel_noise(rgb: np.ndarray, usable: np.ndarray) -> float:
    """Robust standard deviation of a channel's noise, picture units, from second differences (Immerkær 1996).

    Over all ``usable`` (H, W) pixels of ``rgb`` (H, W, 3) with usable neighbours: fine texture is taken for noise. 0
    where there are no such pixels.
    """
    whole = ndimage.binary_erosion(usable, np.ones((3, 3)))
    if not whole.any():
        return 0.0
    grain = [ndimage.convolve(np.where(usable, rgb[..., c], 0.0), LAPLACIAN)[whole] for c in range(3)]
    return mad_scale(np.concatenate(grain))
