"""The gather operator: light that reaches a point from the surfaces around it, (K T)(x) = (1/π) ∫ T(y) cosθ dω.

Rays cast once from a point into a low-discrepancy hemisphere, cosine-distributed, make K one sparse row: the mean over
rays of the value that each ray meets. Bounces are then products with K, T_{k+1} = K T_k, without tracing again.
"""

import numba
import numpy as np

from huesphere.render.raycast import Hits
from huesphere.scenes.mesh import Mesh


@numba.njit(parallel=True, cache=True)
def _row_means(start, kind, kinds, values, rays):
    rows, columns = start.shape[0] - 1, values.shape[1]
    out = np.zeros((rows, kinds, columns), np.float32)
    for row in numba.prange(rows):
        for hit in range(start[row], start[row + 1]):
            if kind[hit] >= 0:
                for column in range(columns):
                    out[row, kind[hit], column] += values[hit, column]
        for k in range(kinds):
            for column in range(columns):
                out[row, k, column] /= rays
    return out


def mean_over_rays(hits: Hits, kind: np.ndarray, kinds: int, values: np.ndarray, rays: int) -> np.ndarray:
    """Values at hits (h, C) summed by point and by kind of hit, over the number of rays cast; (n, kinds, C) float32.

    ``kind`` (h,) int32; hits of a negative kind are left out.
    """
    return _row_means(hits.start, kind, kinds, np.ascontiguousarray(values, dtype=np.float32), rays)


@numba.njit(parallel=True, cache=True)
def _apply(start, face, uv, faces, material, factor, values, rays):
    rows, columns = start.shape[0] - 1, values.shape[1]
    out = np.zeros((rows, columns), np.float32)
    for row in numba.prange(rows):
        for hit in range(start[row], start[row + 1]):
            m = material[face[hit]]
            a, b, c = faces[face[hit], 0], faces[face[hit], 1], faces[face[hit], 2]
            u, v = uv[hit, 0], uv[hit, 1]
            w = np.float32(1.0) - u - v
            for column in range(columns):
                out[row, column] += factor[m, column] * (
                    w * values[a, column] + u * values[b, column] + v * values[c, column]
                )
        for column in range(columns):
            out[row, column] /= rays
    return out


def apply_operator(hits: Hits, mesh: Mesh, factor: np.ndarray, values: np.ndarray, rays: int) -> np.ndarray:
    """K applied to light (V, C) that arrives at mesh vertices; (n, C) float32 at the points of ``hits``.

    The light is linear over each face and leaves it times ``factor`` (M, C), the face's reflectance in each column.
    """
    factor = np.ascontiguousarray(factor, dtype=np.float32)
    values = np.ascontiguousarray(values, dtype=np.float32)
    return _apply(hits.start, hits.face, hits.uv, mesh.faces, mesh.material, factor, values, rays)


@numba.njit(parallel=True, cache=True)
def _interpolate(face, uv, faces, values):
    out = np.empty((face.shape[0], values.shape[1]), np.float32)
    for hit in numba.prange(face.shape[0]):
        a, b, c = faces[face[hit], 0], faces[face[hit], 1], faces[face[hit], 2]
        u, v = uv[hit, 0], uv[hit, 1]
        for column in range(values.shape[1]):
            out[hit, column] = (1 - u - v) * values[a, column] + u * values[b, column] + v * values[c, column]
    return out


def at_hits(hits: Hits, mesh: Mesh, values: np.ndarray) -> np.ndarray:
    """Values (V, C) given at mesh vertices, linear over each face, at the hits; (h, C) float32."""
    return _interpolate(hits.face, hits.uv, mesh.faces, np.ascontiguousarray(values, dtype=np.float32))


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
