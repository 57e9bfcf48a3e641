"""What the fits of one missed light share, compiled: the matrix without it, its cofactors, sums of normal equations.

A light is an array of six numbers, ``both`` = (b, a): its colour and the direction toward it. Each function is compiled
into the one that calls it, with that one's rules for rounding.
"""

import numba
import numpy as np


@numba.njit(inline="always")  # type: ignore[untyped-decorator]
def matrix_without(base: np.ndarray, both: np.ndarray, M: np.ndarray) -> None:
    """M (3, 3), in place: ``base`` − b aᵀ of ``both`` (6,)."""
    for i in range(3):
        for j in range(3):
            M[i, j] = base[i, j] - both[i] * both[3 + j]


@numba.njit(inline="always")  # type: ignore[untyped-decorator]
def cofactors(M: np.ndarray, K: np.ndarray) -> None:
    """K (3, 3), in place: the cofactors of M (3, 3), which take n across the ellipsoid at M n, even of a singular M."""
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for x in range(3):
            y, z = (x + 1) % 3, (x + 2) % 3
            K[i, x] = M[j, y] * M[k, z] - M[j, z] * M[k, y]


@numba.njit(inline="always")  # type: ignore[untyped-decorator]
def add_equation(H: np.ndarray, g: np.ndarray, J: np.ndarray, r: float, weight: float) -> None:
    """Add to H (6, 6), lower half, and g (6,), in place, a residual ``r`` of derivatives J (6,) and a ``weight``."""
    for x in range(6):
        g[x] += weight * J[x] * r
        for y in range(x + 1):
            H[x, y] += weight * J[x] * J[y]
