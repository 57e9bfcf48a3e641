"""The quadratic form ρᵀCρ = 1 as six numbers: design matrix, elements of C and back (report 2.1, Eqs. 9 and 10)."""

import numpy as np

# Row and column in C of each element of z = (c11 c22 c33 c12 c13 c23), Eq. (9)
MONOMIALS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))

# How often each element of z occurs in C, which is its factor in ρᵀCρ
FACTOR = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])

# The elements of MᵀM are sums over pixels of products of four colour values, and only fifteen of them differ. Entry
# (i, j) is the index of its sum among those of ``recover.ellipsoid.quartic_sums.moments``.
PRODUCTS = np.array(
    [
        [0, 9, 10, 3, 4, 12],
        [9, 1, 11, 5, 13, 6],
        [10, 11, 2, 14, 7, 8],
        [3, 5, 14, 9, 12, 13],
        [4, 13, 7, 12, 10, 14],
        [12, 6, 8, 13, 14, 11],
    ]
)


def design(rgb: np.ndarray) -> np.ndarray:
    """The design matrix M (N, 6) of colours (N, 3): ρ1², ρ2², ρ3², 2ρ1ρ2, 2ρ1ρ3, 2ρ2ρ3. Eq. (9)"""
    r, g, b = np.asarray(rgb, np.float64).T
    return np.stack([r * r, g * g, b * b, 2 * r * g, 2 * r * b, 2 * g * b], axis=-1)


def matrix_of(z: np.ndarray) -> np.ndarray:
    """C (..., 3, 3) from its six elements z (..., 6) = (c11, c22, c33, c12, c13, c23). Eq. (10)"""
    return np.asarray(z)[..., [[0, 3, 4], [3, 1, 5], [4, 5, 2]]]


def elements_of(C: np.ndarray) -> np.ndarray:
    """z (..., 6) from C (..., 3, 3). Eq. (10)"""
    rows, columns = zip(*MONOMIALS)
    return np.asarray(C)[..., rows, columns]
