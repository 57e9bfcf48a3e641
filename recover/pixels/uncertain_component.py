"""Normals from colours of which one component is uncertain: the indirect light that was subtracted.

The indirect light subtracted from a pixel is wrong by some share δ of itself, because the surface that it was computed
on is wrong: ρ = F n + δ g + e, with g the subtracted light, known for each pixel, and e the camera's noise. So the
point of the ellipsoid that is nearest to ρ is found in the metric of the covariance ε² 1 + s² g gᵀ of this error, by
Gauss–Newton on the sphere. Under natural lights g is nearly the colour that all lights have in common, along which the
ellipsoid is long: the nearest point in the ordinary metric turns a small δ into degrees.
"""

import numpy as np

from huesphere.recover.geometry.tangent_uncertainty import tangent_frames
from huesphere.recover.pixels.parameters import PIXELS

STEPS = 8  # of Gauss–Newton: three reach rounding at nearly all pixels; one in a hundred oscillates by a degree
LONGEST_STEP = 0.1  # radians: longer steps are shortened, because the equations are linearised


def nearest_normals_uncertain(rho: np.ndarray, F: np.ndarray, n: np.ndarray, g: np.ndarray, noise: float) -> np.ndarray:
    """Unit normals (P, 3) of least (ρ − F n)ᵀ (ε² 1 + s² g gᵀ)⁻¹ (ρ − F n), from the start ``n`` (P, 3).

    ``rho`` colours (P, 3), ``F`` (3, 3) their matrix, ``g`` (P, 3) the subtracted light, ``noise`` ε, all in picture
    units; s is ``subtracted_light_error`` of the parameters. Camera frame.
    """
    for _ in range(STEPS):
        residual = without_uncertain_part(rho - n @ F.T, g, noise)
        s, t = tangent_frames(n)
        a, b = s @ F.T, t @ F.T
        by_a, by_b = without_uncertain_part(a, g, noise), without_uncertain_part(b, g, noise)
        aa, ab, bb = (a * by_a).sum(axis=1), (a * by_b).sum(axis=1), (b * by_b).sum(axis=1)
        ra, rb = (a * residual).sum(axis=1), (b * residual).sum(axis=1)
        determinant = np.maximum(aa * bb - ab**2, 1e-14 * (aa + bb) ** 2)
        u, v = (bb * ra - ab * rb) / determinant, (aa * rb - ab * ra) / determinant
        shorter = np.minimum(1.0, LONGEST_STEP / np.maximum(np.hypot(u, v), 1e-12))
        n = n + s * (u * shorter)[:, None] + t * (v * shorter)[:, None]
        n = n / np.linalg.norm(n, axis=1, keepdims=True)
    return n


def without_uncertain_part(v: np.ndarray, g: np.ndarray, noise: float) -> np.ndarray:
    """ε² (ε² 1 + s² g gᵀ)⁻¹ v (P, 3): ``v`` less most of its part along ``g``, all (P, 3) in picture units."""
    whole = (noise / PIXELS.subtracted_light_error) ** 2 + (g**2).sum(axis=1)
    return v - g * ((g * v).sum(axis=1) / np.maximum(whole, 1e-300))[:, None]


def squared_distance_uncertain(residual: np.ndarray, g: np.ndarray, noise: float) -> np.ndarray:
    """ε² rᵀ (ε² 1 + s² g gᵀ)⁻¹ r (P,) of residuals r (P, 3), squared picture units: r² where g is zero."""
    return np.maximum((residual * without_uncertain_part(residual, g, noise)).sum(axis=1), 0.0)  # type: ignore[no-any-return]
