"""The two loops over pixels of ``recover.ellipsoid.normal_equations``, compiled.

``normal_equations`` imports this module for large pictures only, because starting the compiled code takes time.
"""

import numba
import numpy as np


@numba.njit(cache=True, parallel=True, fastmath={"contract", "nsz"})  # type: ignore[untyped-decorator]
def residuals(rgb: np.ndarray, C: np.ndarray, out: np.ndarray) -> None:
    """out[n] = ρᵀCρ − 1 in double, of colours ``rgb`` (N, 3) and C (3, 3)."""
    c11, c22, c33 = C[0, 0], C[1, 1], C[2, 2]
    c12, c13, c23 = 2 * C[0, 1], 2 * C[0, 2], 2 * C[1, 2]
    for n in numba.prange(rgb.shape[0]):
        r, g, b = np.float64(rgb[n, 0]), np.float64(rgb[n, 1]), np.float64(rgb[n, 2])
        out[n] = r * (c11 * r + c12 * g + c13 * b) + g * (c22 * g + c23 * b) + c33 * b * b - 1.0


@numba.njit(cache=True, parallel=True, fastmath=True)  # type: ignore[untyped-decorator]
def moments(rgb: np.ndarray, T: np.ndarray, keep: np.ndarray, partial: np.ndarray) -> None:
    """partial[k] = sums, over the k-th share of the pixels, of the 6 products of two and 15 of four of Tρ = (x, y, z).

    Order: xx yy zz xy xz yz; xxxx yyyy zzzz xxxy xxxz xyyy yyyz xzzz yzzz xxyy xxzz yyzz xxyz xyyz xyzz.
    """
    shares = partial.shape[0]
    count = rgb.shape[0]
    for k in numba.prange(shares):
        s0 = s1 = s2 = s3 = s4 = s5 = 0.0
        f0 = f1 = f2 = f3 = f4 = f5 = f6 = f7 = f8 = f9 = f10 = f11 = f12 = f13 = f14 = 0.0
        for n in range(k * count // shares, (k + 1) * count // shares):
            w = 1.0 if keep[n] else 0.0
            r, g, b = np.float64(rgb[n, 0]), np.float64(rgb[n, 1]), np.float64(rgb[n, 2])
            x = w * (T[0, 0] * r + T[0, 1] * g + T[0, 2] * b)
            y = w * (T[1, 0] * r + T[1, 1] * g + T[1, 2] * b)
            z = w * (T[2, 0] * r + T[2, 1] * g + T[2, 2] * b)
            xx, yy, zz, xy, xz, yz = x * x, y * y, z * z, x * y, x * z, y * z
            s0, s1, s2, s3, s4, s5 = s0 + xx, s1 + yy, s2 + zz, s3 + xy, s4 + xz, s5 + yz
            f0, f1, f2 = f0 + xx * xx, f1 + yy * yy, f2 + zz * zz
            f3, f4, f5, f6, f7, f8 = f3 + xx * xy, f4 + xx * xz, f5 + xy * yy, f6 + yy * yz, f7 + xz * zz, f8 + yz * zz
            f9, f10, f11 = f9 + xx * yy, f10 + xx * zz, f11 + yy * zz
            f12, f13, f14 = f12 + xx * yz, f13 + xy * yz, f14 + xy * zz
        partial[k, 0], partial[k, 1], partial[k, 2] = s0, s1, s2
        partial[k, 3], partial[k, 4], partial[k, 5] = s3, s4, s5
        partial[k, 6], partial[k, 7], partial[k, 8] = f0, f1, f2
        partial[k, 9], partial[k, 10], partial[k, 11] = f3, f4, f5
        partial[k, 12], partial[k, 13], partial[k, 14] = f6, f7, f8
        partial[k, 15], partial[k, 16], partial[k, 17] = f9, f10, f11
        partial[k, 18], partial[k, 19], partial[k, 20] = f12, f13, f14
