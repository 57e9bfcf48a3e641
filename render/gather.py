"""The gather operator: light that reaches a point from the surfaces around it, (K T)(x) = (1/π) ∫ T(y) cosθ dω.

Rays cast once from a point into a low-discrepancy hemisphere, cosine-distributed, make K one sparse row: the mean over
rays of the value that each ray meets. Bounces are then products with K, T_{k+1} = K T_k, without tracing again.
"""

import numba
import numpy as np

from render.raycast import Hits

GOLDEN = 0.6180339887498949  # fractional part of the golden ratio


def fibonacci_lattice(count: int) -> np.ndarray:
    """``count`` points (j + ½)/S, frac(j·golden ratio) in the unit square, shape (S, 2).

    With a Cranley–Patterson rotation at each point and the polar map, the error of K falls like S^−0.76.
    """
    j = np.arange(count)
    return np.stack([(j + 0.5) / count, np.modf(j * GOLDEN)[0]], axis=1)


@numba.njit(parallel=True, cache=True)
def _row_means(start, values, rays):
    rows = start.shape[0] - 1
    out = np.zeros((rows, values.shape[1]), np.float32)
    for row in numba.prange(rows):
        for hit in range(start[row], start[row + 1]):
            for column in range(values.shape[1]):
                out[row, column] += values[hit, column]
        for column in range(values.shape[1]):
            out[row, column] /= rays
    return out


def mean_over_rays(hits: Hits, values: np.ndarray, rays: int) -> np.ndarray:
    """Values at hits (h, C) summed by point and divided by the number of rays cast; (n, C) float32."""
    return _row_means(hits.start, np.ascontiguousarray(values, dtype=np.float32), rays)


@numba.njit(parallel=True, cache=True)
def _apply(start, face, uv, faces, values, rays):
    rows, columns = start.shape[0] - 1, values.shape[1]
    out = np.zeros((rows, columns), np.float32)
    for row in numba.prange(rows):
        for hit in range(start[row], start[row + 1]):
            a, b, c = faces[face[hit], 0], faces[face[hit], 1], faces[face[hit], 2]
            u, v = uv[hit, 0], uv[hit, 1]
            w = np.float32(1.0) - u - v
            for column in range(columns):
                out[row, column] += w * values[a, column] + u * values[b, column] + v * values[c, column]
        for column in range(columns):
            out[row, column] /= rays
    return out


def apply_operator(hits: Hits, faces: np.ndarray, values: np.ndarray, rays: int) -> np.ndarray:
    """K applied to ``values`` (V, C) given at mesh vertices, linear over each face; (n, C) float32 at the points."""
    return _apply(hits.start, hits.face, hits.uv, faces, np.ascontiguousarray(values, dtype=np.float32), rays)


def concatenate(parts: list[Hits]) -> Hits:
    """Hits of consecutive runs of points as one."""
    if not parts:
        return Hits(np.zeros(1, np.int64), np.zeros(0, np.int32), np.zeros((0, 2), np.float32))
    offsets = np.cumsum([0, *(part.start[-1] for part in parts)])
    starts = [part.start[:-1] + offset for part, offset in zip(parts, offsets, strict=False)]
    return Hits(
        start=np.concatenate([*starts, offsets[-1:]]),
        face=np.concatenate([part.face for part in parts]),
        uv=np.concatenate([part.uv for part in parts]),
    )
