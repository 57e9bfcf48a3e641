"""Normals from colours of which one direction is doubtful: the light that came by way of other pixels.

What interreflection took out of a pixel is wrong by some share δ of itself, for the surface that it was computed on is,
and no camera noise is: ρ = F n + δ g + e, g the light that was taken out, known for each pixel. So the nearest point of
the ellipsoid is looked for in the metric of the covariance ε² 1 + s² g gᵀ, the errors that such pixels have, by
Gauss–Newton on the sphere. Under natural lights g is nearly the colour that all lights have in common, along which
the ellipsoid is long: the plain nearest point turns a small δ into degrees.
"""

import numpy as np

from huesphere.recover.geometry.tangent_uncertainty import tangent_frames

DOUBT = 0.2  # s: share of the light taken out that may be wrong, standard deviation
STEPS, LONGEST = 8, 0.1  # of Gauss–Newton, and radians of one


def nearest_along(rho: np.ndarray, F: np.ndarray, n: np.ndarray, g: np.ndarray, noise: float) -> np.ndarray:
    """Unit normals (P, 3) with least (ρ − F n)ᵀ (ε² 1 + s² g gᵀ)⁻¹ (ρ − F n), from the start ``n`` (P, 3).

    ``rho`` colours (P, 3), ``F`` (3, 3) their matrix, ``g`` (P, 3) the light taken out, ``noise`` ε: all in picture
    units.
    """
    for _ in range(STEPS):
        residual = likelier(rho - n @ F.T, g, noise)
        s, t = tangent_frames(n)
        a, b = s @ F.T, t @ F.T
        by_a, by_b = likelier(a, g, noise), likelier(b, g, noise)
        aa, ab, bb = (a * by_a).sum(axis=1), (a * by_b).sum(axis=1), (b * by_b).sum(axis=1)
        ra, rb = (a * residual).sum(axis=1), (b * residual).sum(axis=1)
        determinant = np.maximum(aa * bb - ab**2, 1e-14 * (aa + bb) ** 2)
        u, v = (bb * ra - ab * rb) / determinant, (aa * rb - ab * ra) / determinant
        shorter = np.minimum(1.0, LONGEST / np.maximum(np.hypot(u, v), 1e-12))
        n = n + s * (u * shorter)[:, None] + t * (v * shorter)[:, None]
        n = n / np.linalg.norm(n, axis=1, keepdims=True)
    return n


def likelier(v: np.ndarray, g: np.ndarray, noise: float) -> np.ndarray:
    """ε² (ε² 1 + s² g gᵀ)⁻¹ v (P, 3): ``v`` less most of what lies along ``g``, all (P, 3) in picture units."""
    most = (noise / DOUBT) ** 2 + (g**2).sum(axis=1)
    return v - g * ((g * v).sum(axis=1) / np.maximum(most, 1e-300))[:, None]


def squared_distance(residual: np.ndarray, g: np.ndarray, noise: float) -> np.ndarray:
    """Squared lengths (P,) of residuals (P, 3) in that metric, in which noise keeps its size."""
    return np.maximum((residual * likelier(residual, g, noise)).sum(axis=1), 0.0)  # type: ignore[no-any-return]
