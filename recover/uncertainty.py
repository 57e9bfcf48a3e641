"""How far off each normal may be: the noise of its colour and of the rotation, carried to degrees."""

import numpy as np
from scipy.special import ellipe

DEG = 180.0 / np.pi


def normal_uncertainty_deg(
    normals: np.ndarray,
    length: np.ndarray,
    M: np.ndarray,
    colour_covariance: np.ndarray,
    rotation_covariance: np.ndarray,
) -> np.ndarray:
    """Expected angular error (P,) in degrees of normals (P, 3), n = Mρ / |Mρ|.

    ``length`` (P,) is |Mρ|, ``M`` (3, 3) takes colours to the camera frame, ``colour_covariance`` (3, 3) is of a
    pixel's colour and ``rotation_covariance`` (3, 3), radians², of the small rotation common to all. Both errors are
    carried to the plane tangent to the sphere at n, where the expected length of a two-dimensional Gaussian is taken.
    """
    noise = M @ colour_covariance @ M.T / length[:, None, None] ** 2
    turn = np.cross(np.eye(3), normals[:, None])  # rows e_i × n: a small rotation ω moves n by ω × n
    covariance = noise + np.einsum("pia,ij,pjb->pab", turn, rotation_covariance, turn)
    tangent = _tangent_frames(normals)
    flat = np.einsum("pka,pab,plb->pkl", tangent, covariance, tangent)
    return expected_length(flat) * DEG


def expected_length(covariance: np.ndarray) -> np.ndarray:
    """E |x| for x ~ N(0, covariance (P, 2, 2)): √(2/π) σ1 E(1 − σ2²/σ1²), with the complete elliptic integral E."""
    half_trace = 0.5 * (covariance[:, 0, 0] + covariance[:, 1, 1])
    determinant = covariance[:, 0, 0] * covariance[:, 1, 1] - covariance[:, 0, 1] ** 2
    spread = np.sqrt(np.maximum(half_trace**2 - determinant, 0.0))
    larger, smaller = half_trace + spread, np.maximum(half_trace - spread, 0.0)
    ratio = np.divide(smaller, larger, out=np.ones_like(larger), where=larger > 0)
    return np.sqrt(2 / np.pi * larger) * ellipe(1 - ratio)


def _tangent_frames(normals: np.ndarray) -> np.ndarray:
    """Two unit vectors (P, 2, 3) across each of the normals (P, 3), which do not point to −z."""
    x, y, z = normals.T
    a = 1 / (1 + np.maximum(z, -0.999999))
    b = -x * y * a
    return np.stack([np.stack([1 - x * x * a, b, -x], axis=-1), np.stack([b, 1 - y * y * a, -y], axis=-1)], axis=1)
