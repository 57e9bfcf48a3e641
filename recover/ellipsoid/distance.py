"""How far colours are from an ellipsoid, and which part of that is each pixel's own noise.

The part that neighbours share is an error of the model: light between parts of the surface, wide lights, another
ellipsoid.
"""

import numpy as np
from scipy import ndimage

from huesphere.recover.ellipsoid.normal_equations import residuals
from huesphere.recover.robust_scale import mad_scale

WINDOW = 5  # pixels, side of the square over which distances are averaged


def signed_distance(rgb: np.ndarray, C: np.ndarray) -> np.ndarray:
    """Sampson's distance r / |∂r/∂ρ| = (ρᵀCρ − 1) / (2|Cρ|) of colours (N, 3) to the ellipsoid, picture units, (N,)."""
    slope = 2 * np.linalg.norm(rgb @ C, axis=-1)
    return residuals(rgb, C) / np.maximum(slope, 1e-300)


def residual_scales(distance: np.ndarray, core: np.ndarray) -> tuple[float, float]:
    """(white, shared by neighbours): the two parts of the distances of the pixels of ``core`` (H, W), picture units."""
    image = np.zeros(core.shape)
    image[core] = distance
    whole = ndimage.uniform_filter(core.astype(float), WINDOW) > 0.999
    if not whole.any():
        return mad_scale(distance), 0.0
    mean = ndimage.uniform_filter(image, WINDOW)[whole]
    white = mad_scale(image[whole] - mean) * WINDOW / np.sqrt(WINDOW**2 - 1)
    return white, float(np.sqrt(max(mad_scale(mean) ** 2 - white**2 / WINDOW**2, 0.0)))
