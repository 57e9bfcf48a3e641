"""One pass over all pixels: residuals and normal equations of ρᵀCρ = 1, without ever holding the N×6 design matrix.

A NumPy version works through blocks of pixels. A compiled version with the same results (``quartic_sums``) serves large
pictures, where it is several times faster than NumPy; for small ones its start costs more than it saves
(``benchmarks/recover_shell_fit.py``).
"""

from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np

from huesphere.recover.geometry.quadratic import FACTOR, PRODUCTS, design

BLOCK = 1 << 12  # pixels: a block's columns stay in the cache of one core, and BLAS starts no threads for so few
SHARES = 64  # parts in which the pixels are summed, whatever the number of threads: so the sums do not depend on it
COMPILED_FROM = 300_000  # pixels: for fewer, starting the compiled version costs more than it saves


def residuals(rgb: np.ndarray, C: np.ndarray) -> np.ndarray:
    """r = ρᵀCρ − 1 of every pixel, (N,) float64, from colours (N, 3) float32 or float64 and C (3, 3)."""
    out = np.empty(len(rgb))
    if len(rgb) >= COMPILED_FROM:
        _compiled()["residuals"](rgb, np.ascontiguousarray(C), out)
    else:
        for block in _blocks(len(rgb)):
            rho = rgb[block].astype(np.float64)
            np.einsum("ni,ni->n", rho @ C, rho, out=out[block])
        out -= 1.0
    return out


def normal_equations(rgb: np.ndarray, T: np.ndarray, keep: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """MᵀM (6, 6) and Mᵀ1 (6,) in double, over the pixels in ``keep`` (N,) bool, of the colours Tρ with T (3, 3).

    M is the design matrix of Eq. (9); C is the solution of (MᵀM) z = Mᵀ1, Eq. (10). ``rgb`` (N, 3) in picture units.
    """
    if len(rgb) >= COMPILED_FROM:
        partial = np.zeros((SHARES, 21))  # of each share: 6 sums of products of two colours, 15 of four
        _compiled()["moments"](rgb, np.ascontiguousarray(T), keep, partial)
        second, fourth = np.split(partial.sum(axis=0), [6])
        return FACTOR * FACTOR[:, None] * fourth[PRODUCTS], FACTOR * second
    gram, right = np.zeros((6, 6)), np.zeros(6)
    for block in _blocks(len(rgb)):
        M = design(rgb[block][keep[block]].astype(np.float64) @ T.T)
        gram += M.T @ M
        right += M.sum(axis=0)
    return gram, right


def _blocks(count: int) -> Iterator[slice]:
    return (slice(start, start + BLOCK) for start in range(0, count, BLOCK))


@cache
def _compiled() -> dict[str, Any]:
    """The two kernels, compiled at first use and kept on disk beside this file."""
    from huesphere.recover.ellipsoid.quartic_sums import moments, residuals

    return {"residuals": residuals, "moments": moments}
