"""Specular pixels as outliers to the matte ellipsoid: a highlight adds light, so its colour lies outside the shell.

M. S. Drew, "Robust specularity detection from a single multi-illuminant color image", CVGIP: Image Understanding 59
(1994), the report's [16]. Its other kind of outlier, pixels that miss a light, lies inside.
"""

import numpy as np
from scipy import ndimage

from huesphere.recover.ellipsoid.fit import CUT, dispersion, least_median_of_squares
from huesphere.recover.ellipsoid.normal_equations import residuals


def specular_pixels(rgb: np.ndarray, usable: np.ndarray, *, cut: float = CUT, seed: int = 0) -> np.ndarray:
    """Which of the ``usable`` pixels (H, W) of ``rgb`` (H, W, 3) hold a highlight, (H, W) bool: r = ρᵀCρ − 1 > cut s0.

    C is the LMS ellipsoid of all usable pixels: at least half must be matte and see every light. Specks of
    one pixel, such as noise makes, are dropped. Raises RecoveryFailure as ``least_median_of_squares`` does.
    """
    colours = rgb[usable]
    r = residuals(colours, least_median_of_squares(colours, seed=seed))
    found = np.zeros(usable.shape, bool)
    found[usable] = r > max(cut * dispersion(r), 1e-9)
    return found & (ndimage.uniform_filter(found.astype(float), 3) > 1.5 / 9)
