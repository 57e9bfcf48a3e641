"""Depth of a whole rectangle from slopes that are known everywhere: Poisson's equation by the cosine transform.

min Σ (z_{i+1} − z_i − s_i)² over all pairs of neighbours, s the mean of the two pixels' slopes. The normal equations
with natural boundary conditions are diagonal in the discrete cosine transform (type II): T. Simchony, R. Chellappa and
M. Shao, "Direct analytical methods for solving Poisson equations in computer vision problems", PAMI 12 (1990) 435–446.
The equations are those of ``recover.depth.integration`` without gaps, where each pixel has known slopes.
"""

from functools import lru_cache

import numpy as np
from scipy import fft


def depth_of_slopes(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Depth (H, W), pixels, mean 0, toward the camera, of slopes p = ∂z/∂x and q = ∂z/∂y (y up; row 0 at the top)."""
    height, width = p.shape
    right = 0.5 * (p[:, 1:] + p[:, :-1])
    down = -0.5 * (q[1:] + q[:-1])
    divergence = np.zeros_like(p)
    divergence[:, 1:] += right
    divergence[:, :-1] -= right
    divergence[1:] += down
    divergence[:-1] -= down
    transform = fft.dctn(divergence, overwrite_x=True)
    transform *= _inverse_eigenvalues(height, width).astype(p.dtype)
    return np.asarray(fft.idctn(transform, overwrite_x=True))


@lru_cache(maxsize=4)
def _inverse_eigenvalues(height: int, width: int) -> np.ndarray:
    """1 / (4 − 2 cos(π k / H) − 2 cos(π l / W)), 0 for the mean: of DᵀD, D the differences of neighbours."""
    rows, columns = (2 - 2 * np.cos(np.pi * np.arange(n) / n) for n in (height, width))
    total = rows[:, None] + columns
    total[0, 0] = np.inf
    return np.asarray(1 / total)
