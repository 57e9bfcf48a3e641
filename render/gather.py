"""The gather operator: light that reaches a point from the surfaces around it, (K T)(x) = (1/π) ∫ T(y) cosθ dω.

y is the surface point that x sees in the direction of dω. Rays from x with a cosine distribution, in a low-discrepancy
pattern over the hemisphere, make the row of K for x: the mean over the rays of T where each hits a surface. The rays
are cast once; bounces are then products with K, T_{k+1} = K T_k.
"""

import numba
import numpy as np

from huesphere.render.raycast import Hits
from huesphere.scenes.mesh import Mesh


@numba.njit(parallel=True, cache=True)
def _row_means(start, kind, kinds, values, rays):
    """The loops of ``mean_over_rays``."""
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
    """Mean over the ``rays`` cast from each of n points of the ``values`` (h, C) at their hits, (n, kinds, C) float32.

    ``kind`` (h,) int32 is the kind of each hit: each kind has a mean of its own, in which rays that hit nothing, or
    another kind, count as 0. Hits of a negative kind are left out.
    """
    return _row_means(hits.start, kind, kinds, np.ascontiguousarray(values, dtype=np.float32), rays)


# More than seven parameters: compiled code takes the arrays of the records one by one.
@numba.njit(parallel=True, cache=True)
def _apply(start, face, uv, faces, material, factor, values, rays):
    """The loops of ``apply_operator``."""
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
    """K applied to light ``values`` (V, C) that arrives at mesh vertices; (n, C) float32 at the points of ``hits``.

    Light is interpolated linearly over each face and reflected times ``factor`` (M, C) of the face's material.
    """
    factor = np.ascontiguousarray(factor, dtype=np.float32)
    values = np.ascontiguousarray(values, dtype=np.float32)
    return _apply(hits.start, hits.face, hits.uv, mesh.faces, mesh.material, factor, values, rays)


@numba.njit(parallel=True, cache=True)
def _interpolate(face, uv, faces, values):
    """The loops of ``at_hits``."""
    out = np.empty((face.shape[0], values.shape[1]), np.float32)
    for hit in numba.prange(face.shape[0]):
        a, b, c = faces[face[hit], 0], faces[face[hit], 1], faces[face[hit], 2]
        u, v = uv[hit, 0], uv[hit, 1]
        for column in range(values.shape[1]):
            out[hit, column] = (1 - u - v) * values[a, column] + u * values[b, column] + v * values[c, column]
    return out


def at_hits(hits: Hits, mesh: Mesh, values: np.ndarray) -> np.ndarray:
    """``values`` (V, C) at mesh vertices, interpolated linearly over each face to the hits; (h, C) float32."""
    return _interpolate(hits.face, hits.uv, mesh.faces, np.ascontiguousarray(values, dtype=np.float32))


def concatenate(parts: list[Hits]) -> Hits:
    """One record of the hits of several consecutive groups of points."""
    if not parts:
        return Hits(np.zeros(1, np.int64), np.zeros(0, np.int32), np.zeros((0, 2), np.float32))
    offsets = np.cumsum([0, *(part.start[-1] for part in parts)])
    starts = [part.start[:-1] + offset for part, offset in zip(parts, offsets, strict=False)]
    return Hits(
        start=np.concatenate([*starts, offsets[-1:]]),
        face=np.concatenate([part.face for part in parts]),
        uv=np.concatenate([part.uv for part in parts]),
    )
