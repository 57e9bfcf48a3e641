"""What recovery cannot see, taken out: the rotation left open by the colour ellipsoid, and the convex/concave twin.

Colours fix normals up to an orthogonal transformation (report, section 2.1); integrability fixes that transformation up
to ``TWIN``, which keeps p_y = q_x exactly.
"""

import numpy as np

TWIN = np.diag([-1.0, -1.0, 1.0])  # (p, q) -> (-p, -q): a bump seen as a hollow, integrable both ways


def best_orthogonal(estimate: np.ndarray, truth: np.ndarray, *, proper: bool = False) -> np.ndarray:
    """Return the orthogonal Q (3, 3) that minimises Σ |Q estimate − truth|²: the orthogonal Procrustes problem.

    With M = Σ truth estimateᵀ = U Σ Vᵀ the answer is Q = U Vᵀ, in O(3); with ``proper`` the axis of least singular
    value is turned over where needed, so that det Q = +1 (Kabsch 1976; Schönemann 1966).

    Args:
        estimate, truth: (N, 3) unit vectors of the same N pixels, all finite.
        proper: rotations only, no reflection.

    Vectors that span less than three dimensions leave Q free on the rest; one of the best is returned.
    """
    U, _, Vt = np.linalg.svd(truth.T.astype(np.float64) @ estimate.astype(np.float64))
    if proper and np.linalg.det(U @ Vt) < 0:
        U[:, 2] = -U[:, 2]
    return U @ Vt
