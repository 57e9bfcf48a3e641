"""From C to a root Ĝ with ĜᵀĜ = C: the polar factor of report section 2.1, by the SVD method of its reference [21].

Horn, Hilden & Negahdaripour, "Closed-form solution of absolute orientation using orthonormal matrices", JOSA A 5
(1988): the symmetric factor of M is (MᵀM)^{1/2}. Every other root is an orthogonal matrix times this one.
"""

import numpy as np


def symmetric_root(C: np.ndarray) -> np.ndarray:
    """The positive definite Ĝ (3, 3) with ĜᵀĜ = C (3, 3), in inverse picture units.

    Raises ValueError if C is not positive definite. For a symmetric C its singular vectors are its eigenvectors.
    """
    eigenvalues, eigenvectors = np.linalg.eigh(C)
    if not eigenvalues[0] > 0:
        raise ValueError(f"C must be positive definite, got smallest eigenvalue {eigenvalues[0]:.3g}")
    return (eigenvectors * np.sqrt(eigenvalues)) @ eigenvectors.T


def roots(C: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both kinds of root of C, (Ĝ, −Ĝ): det > 0 and det < 0.

    Rotations reach every root from one of the two. The report takes the first and leaves it at that; but the true
    F may have a negative determinant (the order of the lights around the object decides), and then only the second
    is a rotation away from the truth. Integrability tells which.
    """
    G = symmetric_root(C)
    return G, -G
