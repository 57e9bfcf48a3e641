"""Quantities of a normal map that the 1994 report draws: slopes, the integrability error |p_y − q_x|, and shading.

Report, sections 2.3 and 4.1: Fig. 1(e), |p_y − q_x|, and Fig. 2, p and q shaded from one light. Frame: camera, x right,
y up, z toward the camera, image row 0 at the top.
"""

import numpy as np

SHADING_LIGHT = np.array([1.0, 0.0, 1.0]) / np.sqrt(2.0)  # from the right, as the report's Fig. 2


def unrotated_normals(rgb: np.ndarray, C: np.ndarray) -> np.ndarray:
    """Return N = C^(1/2) ρ, (H, W, 3): normals up to a rotation (report, Eq. 11), not normalised.

    Args:
        rgb: (H, W, 3), picture units.
        C: (3, 3), symmetric positive definite, of the ellipsoid ρᵀ C ρ = 1.
    """
    values, vectors = np.linalg.eigh(np.asarray(C, dtype=np.float64))
    root = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    return rgb.astype(np.float64) @ root  # the root is symmetric


def slopes(normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return p = −n1/n3 and q = −n2/n3, (H, W) each, of normals (H, W, 3) of any length; NaN where n3 is 0 or NaN."""
    n = normals.astype(np.float64)
    n3 = np.where(n[..., 2] == 0.0, np.nan, n[..., 2])
    return -n[..., 0] / n3, -n[..., 1] / n3


def integrability_error(normals: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Return |p_y − q_x| per pixel, (H, W), by centred differences; NaN unless all four neighbours are in ``where``.

    ``normals`` (H, W, 3), ``where`` (H, W) bool. y is up and the row index grows downwards, so ∂/∂y is minus the
    difference along rows.
    """
    p, q = slopes(np.where(where[..., None], normals, np.nan))
    residual = np.full(p.shape, np.nan)
    p_y = -(p[2:, 1:-1] - p[:-2, 1:-1]) / 2.0
    q_x = (q[1:-1, 2:] - q[1:-1, :-2]) / 2.0
    residual[1:-1, 1:-1] = np.abs(p_y - q_x)
    return residual


def shade(normals: np.ndarray, light: np.ndarray = SHADING_LIGHT) -> np.ndarray:
    """Return max(0, l · n), (H, W), the shading of normals (H, W, 3) under one distant light l (3,); NaN where n is."""
    return np.maximum(normals.astype(np.float64) @ light, 0.0)
