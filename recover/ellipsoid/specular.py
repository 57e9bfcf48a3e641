"""Specular pixels as outliers to the matte ellipsoid: a highlight adds light, so its colour lies outside it.

M. S. Drew, "Robust specularity detection from a single multi-illuminant color image", CVGIP: Image Understanding 59
(1994), the report's [16]. Its other kind of outlier, pixels that miss a light, lies inside.
"""

import numpy as np
from scipy import ndimage

from huesphere.recover.ellipsoid.fit import dispersion, least_median_of_squares
from huesphere.recover.ellipsoid.normal_equations import residuals
from huesphere.recover.ellipsoid.parameters import ELLIPSOID

LEAST_RESIDUAL = 1e-9  # of r: rounding in double precision, where a picture without noise leaves s0 = 0


def specular_pixels(rgb: np.ndarray, usable: np.ndarray, *, cut: float | None = None, seed: int = 0) -> np.ndarray:
    """Which of the ``usable`` pixels (H, W) of ``rgb`` (H, W, 3) hold a highlight, (H, W) bool: r = ρᵀCρ − 1 > cut s0.

    C is the least-median-of-squares ellipsoid of all usable pixels: at least half must be matte and see every light.
    ``cut`` is in units of s0, by default ``acceptance_cut`` of the parameters (report 2.2). Single pixels without
    another in their 3×3 neighbourhood, such as noise makes, are dropped. Raises RecoveryFailure as
    ``least_median_of_squares`` does.
    """
    cut = ELLIPSOID.acceptance_cut if cut is None else cut
    colours = rgb[usable]
    r = residuals(colours, least_median_of_squares(colours, seed=seed))
    found = np.zeros(usable.shape, bool)
    found[usable] = r > max(cut * dispersion(r), LEAST_RESIDUAL)
    return found & (ndimage.uniform_filter(found.astype(float), 3) > 1.5 / 9)
