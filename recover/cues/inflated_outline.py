"""The template: the normals of the surface that an object's outline is inflated to, exact for a ball.

h solves ∇²h = −4 within the mask with h = 0 outside, and the surface is z = √h: over a disc of radius R that is
h = R² − x² − y², a half ball. Its normals are n ∝ (−h_x, −h_y, 2√h / κ), where the depth factor κ stretches the surface
toward the camera (κ = 1: as deep as a ball over a disc). The template knows nothing of the picture but its outline.

Frame: camera, x right, y up, z toward the camera, image row 0 at the top. Source: this project (research log, "What the
outline tells without an ellipsoid"); ∇²h = −4 is the elastic membrane of L. Prandtl (1903).
"""

import numpy as np
from scipy.sparse.linalg import spsolve

from huesphere.recover.geometry.neighbours import edges_within, laplacian


def membrane(mask: np.ndarray) -> np.ndarray:
    """h (H, W) in pixels²: ∇²h = −4 within ``mask`` (H, W), 0 off it; beyond the picture's edge h is 0 too."""
    edges = edges_within(mask)
    stencil = laplacian(edges, np.ones(len(edges.i)), np.full(int(mask.sum()), 4.0))
    h = np.zeros(mask.shape)
    h[mask] = np.maximum(spsolve(stencil.tocsc(), np.full(stencil.shape[0], 4.0)), 0)
    return h


def heights(mask: np.ndarray) -> np.ndarray:
    """(−h_x, −h_y, 2√h) (H, W, 3) of the membrane over ``mask`` (H, W): the template's normals, not yet unit."""
    h = np.pad(membrane(mask), 1)
    down, right = np.gradient(h)
    return np.stack([-right, down, 2 * np.sqrt(h)], axis=-1)[1:-1, 1:-1]


def inflated(mask: np.ndarray, log_depth: float = 0.0) -> np.ndarray:
    """Unit normals (H, W, 3) of the surface that the outline of ``mask`` (H, W) is inflated to; 0 off the mask.

    ``log_depth``: log κ.
    """
    n = heights(mask) * np.array([1.0, 1.0, np.exp(-log_depth)])
    n /= np.maximum(np.linalg.norm(n, axis=-1, keepdims=True), 1e-12)
    return np.where(mask[..., None], n, 0.0)
