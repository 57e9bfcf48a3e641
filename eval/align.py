"""Alignment of normals to the truth by the transformations that a single picture leaves undetermined.

Colours determine normals up to an orthogonal transformation (report, section 2.1). Integrability determines that
transformation up to ``TWIN``, under which p_y = q_x stays true.
"""

import numpy as np

TWIN = np.diag([-1.0, -1.0, 1.0])  # (p, q) becomes (−p, −q): convex surfaces become concave, and both are integrable


def best_orthogonal(estimate: np.ndarray, truth: np.ndarray, *, proper: bool = False) -> np.ndarray:
    """Return the orthogonal Q (3, 3) that minimises Σ |Q estimate − truth|²: the orthogonal Procrustes problem.

    With the singular value decomposition M = Σ truth estimateᵀ = U S Vᵀ the solution is Q = U Vᵀ. With ``proper`` the
    axis of the least singular value is reversed if needed, so that det Q = +1 (Kabsch 1976; Schönemann 1966).

    Args:
        estimate, truth: (N, 3) unit vectors of the same N pixels, all finite.
        proper: rotations only, no reflection.

    Vectors that span less than three dimensions do not determine Q; then one of the minimising Q is returned.
    """
    U, _, Vt = np.linalg.svd(truth.T.astype(np.float64) @ estimate.astype(np.float64))
    if proper and np.linalg.det(U @ Vt) < 0:
        U[:, 2] = -U[:, 2]
    return U @ Vt
