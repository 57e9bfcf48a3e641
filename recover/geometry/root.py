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
    """The two roots (Ĝ, −Ĝ) of C (3, 3), (3, 3) each: det > 0 and det < 0. Raises ValueError as ``symmetric_root``.

    Every root of C is a rotation times one of the two. The report uses the first only. But the true F may have a
    negative determinant, which depends on the order of the lights' colours around the object; then the true root is a
    rotation times the second. Integrability decides between them.
    """
    G = symmetric_root(C)
    return G, -G
