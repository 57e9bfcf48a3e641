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


@numba.njit(parallel=True, cache=True)
def _weighted_means(start, weight, values, rays):
    """The loops of ``weighted_mean_over_rays``."""
    rows, kinds, columns = start.shape[0] - 1, weight.shape[1], values.shape[1]
    out = np.zeros((rows, kinds, columns), np.float32)
    for row in numba.prange(rows):
        for hit in range(start[row], start[row + 1]):
            for k in range(kinds):
                for column in range(columns):
                    out[row, k, column] += weight[hit, k] * values[hit, column]
        for k in range(kinds):
            for column in range(columns):
                out[row, k, column] /= rays
    return out


def weighted_mean_over_rays(hits: Hits, weight: np.ndarray, values: np.ndarray, rays: int) -> np.ndarray:
    """``mean_over_rays`` where each hit belongs to every kind by its ``weight`` (h, kinds); (n, kinds, C) float32."""
    weight, values = (np.ascontiguousarray(a, dtype=np.float32) for a in (weight, values))
    return _weighted_means(hits.start, weight, values, rays)


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


# More than seven parameters: compiled code takes the arrays of the records one by one.
@numba.njit(parallel=True, cache=True)
def _apply_weighted(start, face, uv, faces, weight, factor, values, rays):
    """The loops of ``apply_operator`` where each hit has weights of the materials."""
    rows, columns, materials = start.shape[0] - 1, values.shape[1], weight.shape[1]
    out = np.zeros((rows, columns), np.float32)
    for row in numba.prange(rows):
        for hit in range(start[row], start[row + 1]):
            a, b, c = faces[face[hit], 0], faces[face[hit], 1], faces[face[hit], 2]
            u, v = uv[hit, 0], uv[hit, 1]
            w = np.float32(1.0) - u - v
            for column in range(columns):
                reflected = np.float32(0.0)
                for m in range(materials):
                    reflected += weight[hit, m] * factor[m, column]
                out[row, column] += reflected * (w * values[a, column] + u * values[b, column] + v * values[c, column])
        for column in range(columns):
            out[row, column] /= rays
    return out


def apply_operator(hits: Hits, mesh: Mesh, factor: np.ndarray, values: np.ndarray, rays: int) -> np.ndarray:
    """K applied to light ``values`` (V, C) that arrives at mesh vertices; (n, C) float32 at the points of ``hits``.

    Light is interpolated linearly over each face and reflected times ``factor`` (M, C) of the face's material, or
    of the materials that the hits have weights of.
    """
    factor = np.ascontiguousarray(factor, dtype=np.float32)
    values = np.ascontiguousarray(values, dtype=np.float32)
    if hits.weight is not None:
        return _apply_weighted(hits.start, hits.face, hits.uv, mesh.faces, hits.weight, factor, values, rays)
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
    return interpolated(mesh, values, hits.face, hits.uv)


def interpolated(mesh: Mesh, values: np.ndarray, face: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """``values`` (V, C) at mesh vertices at points on faces (n,) with barycentric ``uv`` (n, 2); (n, C) float32."""
    return _interpolate(face, uv, mesh.faces, np.ascontiguousarray(values, dtype=np.float32))


def concatenate(parts: list[Hits]) -> Hits:
    """One record of the hits of several consecutive groups of points."""
    if not parts:
        return Hits(np.zeros(1, np.int64), np.zeros(0, np.int32), np.zeros((0, 2), np.float32))
    weights = [part.weight for part in parts if part.weight is not None]
    offsets = np.cumsum([0, *(part.start[-1] for part in parts)])
    starts = [part.start[:-1] + offset for part, offset in zip(parts, offsets, strict=False)]
    return Hits(
        start=np.concatenate([*starts, offsets[-1:]]),
        face=np.concatenate([part.face for part in parts]),
        uv=np.concatenate([part.uv for part in parts]),
        weight=np.concatenate(weights) if weights else None,
    )
