"""How noisy a picture is: what its camera is known to have, and what second differences of the picture show.

J. Immerkær, "Fast noise variance estimation", Computer Vision and Image Understanding 64 (1996), 300–302.
"""

import numpy as np
from scipy import ndimage

from huesphere.recover.robust_scale import mad_scale
from huesphere.render.dataset import CameraInfo

CALMEST_7, CALMEST_3 = 0.87, 0.70  # the calmest tenth of windows of 7 and 3 pixels, of pure noise of deviation 1


def picture_noise(rgb: np.ndarray, usable: np.ndarray) -> float:
    """Standard deviation of a channel of the picture (H, W, 3), from second differences twice over (Immerkær 1996).

    Texture adds to them: the noise is read where they are least, in the calmest tenth of all windows.
    """
    grain = np.stack([ndimage.convolve(rgb[..., c], LAPLACIAN) for c in range(3)], axis=-1)
    for window, calmest in ((7, CALMEST_7), (3, CALMEST_3)):
        whole = ndimage.binary_erosion(usable, np.ones((window + 2, window + 2)))
        if whole.sum() >= 50:
            power = ndimage.uniform_filter((grain**2).mean(axis=-1), window)[whole]
            return float(np.sqrt(np.quantile(power, 0.1))) / calmest
    return float("nan")


LAPLACIAN = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]]) / 6  # Immerkær (1996): noise gain 1


def camera_noise(camera: CameraInfo, level: float) -> float:
    """Standard deviation of a channel at ``level`` (full scale 1) that the camera is known to have; 0 where unknown."""
    variance = camera.read_noise**2
    if camera.full_well:
        variance += max(level, 0.0) / camera.full_well
    if camera.bits:
        variance += 1 / (12 * (2**camera.bits - 1) ** 2)
    return float(np.sqrt(variance))


def channel_noise(rgb: np.ndarray, usable: np.ndarray) -> float:
    """Standard deviation of the noise of a channel, picture units, from its finest grain (Immerkær 1996)."""
    whole = ndimage.binary_erosion(usable, np.ones((3, 3)))
    if not whole.any():
        return 0.0
    grain = [ndimage.convolve(np.where(usable, rgb[..., c], 0.0), LAPLACIAN)[whole] for c in range(3)]
    return mad_scale(np.concatenate(grain))
