"""Distances of colours to an ellipsoid, and the standard deviations of their two parts.

One part is noise, independent from pixel to pixel. The other is spatially correlated, which the camera's noise is not;
so it is an error of the model: interreflection, wide lights, or the wrong ellipsoid.
P. D. Sampson, "Fitting conic sections to 'very scattered' data", Computer Graphics and Image Processing 18 (1982).
"""

import numpy as np
from scipy import ndimage

from huesphere.recover.ellipsoid.normal_equations import residuals
from huesphere.recover.ellipsoid.parameters import ELLIPSOID
from huesphere.recover.robust_scale import mad_scale


def signed_distance(rgb: np.ndarray, C: np.ndarray) -> np.ndarray:
    """Sampson's distance r / |∂r/∂ρ| = (ρᵀCρ − 1) / (2|Cρ|) (N,) of colours (N, 3) to the ellipsoid, picture units.

    It is the distance to the nearest point of the ellipsoid to first order, positive outside. C (3, 3).
    """
    slope = 2 * np.linalg.norm(rgb @ C, axis=-1)
    return residuals(rgb, C) / np.maximum(slope, 1e-300)


def residual_scales(distance: np.ndarray, inlier: np.ndarray) -> tuple[float, float]:
    """(independent, spatially correlated): robust standard deviations of the two parts of distances, picture units.

    ``distance`` (P,) are those of the pixels ``inlier`` (H, W) bool in raster order. Over a window of side² pixels the
    mean of independent noise has the variance independent² / side². The variance of the measured means beyond that is
    the correlated part. It is 0 if no window lies completely within the inliers.
    """
    side = ELLIPSOID.averaging_window_px
    image = np.zeros(inlier.shape)
    image[inlier] = distance
    whole = ndimage.uniform_filter(inlier.astype(float), side) > 0.999
    if not whole.any():
        return mad_scale(distance), 0.0
    mean = ndimage.uniform_filter(image, side)[whole]
    independent = mad_scale(image[whole] - mean) * side / np.sqrt(side**2 - 1)
    return independent, float(np.sqrt(max(mad_scale(mean) ** 2 - independent**2 / side**2, 0.0)))
