"""The rank of each patch of the picture: how many dimensions its colours span, 3, 2 or 1.

M. H. Brill, JOSA A 7 (1990), the report's [11], defines the rank; A. P. Petrov & L. L. Kontsevich, JOSA A 11 (1994),
[13], classify patches by it. The rank of a patch is the smaller of the ranks of its lights and of its normals; that of
a planar patch is 1.
"""

import numpy as np
from scipy import ndimage

from huesphere.recover.pixels.noise import channel_noise
from huesphere.recover.pixels.parameters import PIXELS

SINGLE_PRECISION = 3e-7  # of the patch's own brightness: variations that rounding makes


def local_moments(rgb: np.ndarray, usable: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(mean of ρρᵀ (H, W, 3, 3), share of usable pixels (H, W)) over the square about each pixel, about black.

    ``rgb`` (H, W, 3), ``usable`` (H, W); the side of the square is ``rank_window_px``.
    """
    window = PIXELS.rank_window_px
    weight = ndimage.uniform_filter(usable.astype(np.float64), window, mode="constant")
    colours = np.where(usable[..., None], rgb, 0.0).astype(np.float64)
    moments = np.empty((*usable.shape, 3, 3))
    for i in range(3):
        for j in range(i, 3):
            mean = ndimage.uniform_filter(colours[..., i] * colours[..., j], window, mode="constant")
            moments[..., i, j] = moments[..., j, i] = mean / np.maximum(weight, 1e-12)
    return moments, weight


def rank_map(rgb: np.ndarray, usable: np.ndarray, *, noise: float | None = None) -> np.ndarray:
    """Rank (H, W) int of the patch about each pixel of ``rgb`` (H, W, 3): 0 … 3; −1 where it is not all ``usable``.

    ``noise`` is the standard deviation of a channel, picture units; where it is not given it is measured, and fine
    texture is taken for noise. A dimension counts where its second moment is ``rank_noise_ratio`` times the largest
    that noise alone makes, σ² (1 + √(3 / n))², the edge of the Marchenko–Pastur law for n pixels.
    """
    moments, weight = local_moments(rgb, usable)
    sigma = channel_noise(rgb, usable) if noise is None else noise
    whole = usable & (weight > 1 - 1e-9)
    values = np.linalg.eigvalsh(moments[whole])
    edge = (sigma * (1 + np.sqrt(3) / PIXELS.rank_window_px)) ** 2
    rank = np.full(usable.shape, -1)
    rank[whole] = (values > np.maximum(PIXELS.rank_noise_ratio * edge, SINGLE_PRECISION**2 * values[:, 2:])).sum(axis=1)
    return rank
