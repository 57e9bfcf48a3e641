"""Expected angular error of each normal, by propagation of the covariances of its colour and of the rotation."""

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

    ``length`` (P,) is |Mρ|. ``M`` (3, 3) maps colours to normals in the camera frame. ``colour_covariance`` (3, 3) is
    that of a pixel's colour; ``rotation_covariance`` (3, 3), radians², is that of a small rotation of all normals
    together. Both are projected onto the tangent plane of the sphere at n; the result is the expected length of the
    two-dimensional Gaussian error there.
    """
    first, second = tangent_frames(normals)
    noise = _projected(M @ colour_covariance @ M.T, first, second) / length**2
    # A small rotation ω moves n by ω × n, and t·(ω × n) = ω·(n × t), where n × first = second, n × second = −first.
    xx, xy, yy = noise + _projected(rotation_covariance, second, -first)
    return expected_length(xx, xy, yy) * DEG


def expected_length(xx: np.ndarray, xy: np.ndarray, yy: np.ndarray) -> np.ndarray:
    """E |v| (P,) of Gaussian v = (x, y) of mean 0 and covariances xx, xy, yy (P,) each.

    √(2/π) σ1 E(1 − σ2²/σ1²) with the principal deviations σ1 ≥ σ2 and the complete elliptic integral E.
    """
    half_trace = 0.5 * (xx + yy)
    determinant = xx * yy - xy**2
    spread = np.sqrt(np.maximum(half_trace**2 - determinant, 0.0))
    larger, smaller = half_trace + spread, np.maximum(half_trace - spread, 0.0)
    ratio = np.divide(smaller, larger, out=np.ones_like(larger), where=larger > 0)
    return np.sqrt(2 / np.pi * larger) * ellipe(1 - ratio)


def _projected(covariance: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Covariances (3, P), in the order xx xy yy, of the components along ``first`` and ``second`` (P, 3)."""
    a, b = first @ covariance, second @ covariance
    return np.stack([np.sum(a * first, axis=-1), np.sum(a * second, axis=-1), np.sum(b * second, axis=-1)])


def tangent_frames(normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors (P, 3) orthogonal to each of the normals (P, 3), right-handed with it.

    Not accurate for normals near (0, 0, −1).
    """
    x, y, z = normals.T
    a = 1 / (1 + np.maximum(z, -0.999999))
    b = -x * y * a
    return np.stack([1 - x * x * a, b, -x], axis=-1), np.stack([b, 1 - y * y * a, -y], axis=-1)
