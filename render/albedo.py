"""Weights of reflectances at points of the surface, for a scene whose reflectance varies (`scenes.albedo`).

Images and colours of vertices are looked up here; patterns are evaluated in a kernel.
"""

from types import ModuleType
from typing import Any

import numba
import numpy as np

from huesphere.configs.errors import InputError
from huesphere.render.backend import is_scalar
from huesphere.render.gather import interpolated
from huesphere.scenes.albedo.albedo import SUM_TOLERANCE, Albedo, Channel, Constant, Image, VertexColours
from huesphere.scenes.albedo.patterns import Pattern
from huesphere.scenes.build import Scene
from huesphere.scenes.mesh import Mesh

POINTS_AT_ONCE = 2_000_000  # of a pattern: bounds memory


def weights_on_faces(mi: ModuleType, scene: Scene, face: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """(n, M) float32: weight of each reflectance of the scene at points, given by face (n,) and barycentric uv (n, 2).

    Where the scene has no map, or beside the object, it is 1 for the reflectance of the face and 0 for the others.
    Raises InputError where the weights of a mixture do not add up to 1.
    """
    material = scene.mesh.material[face]
    out = np.zeros((len(face), len(scene.reflectances)), np.float32)
    out[np.arange(len(face)), material] = 1.0
    if scene.albedo is not None:
        of_object = np.flatnonzero(scene.is_object[material])
        found = _albedo_at(mi, scene.albedo, scene.mesh, face[of_object], uv[of_object])
        out[of_object[:, None], np.flatnonzero(scene.is_object)] = found
    return out


def weights_at_vertices(mi: ModuleType, scene: Scene, vertex: np.ndarray) -> np.ndarray:
    """(n, M) float32: weights at mesh vertices (n,), as those at points on faces."""
    face_of, corner_of = np.zeros(len(scene.mesh.vertices), np.int32), np.zeros(len(scene.mesh.vertices), np.int32)
    for corner in range(3):
        face_of[scene.mesh.faces[:, corner]] = np.arange(len(scene.mesh.faces))
        corner_of[scene.mesh.faces[:, corner]] = corner
    corners = np.array([[0, 0], [1, 0], [0, 1]], np.float32)
    return weights_on_faces(mi, scene, face_of[vertex], corners[corner_of[vertex]])


def _albedo_at(mi: ModuleType, albedo: Albedo, mesh: Mesh, face: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """(n, M) float32: the object's weights at points on its faces."""
    columns = [_values(mi, channel, albedo, mesh, face, uv) for channel in albedo.channels]
    weights = np.concatenate(columns, axis=1)
    if not albedo.adds_up:
        return weights
    total = weights.sum(axis=1)
    if albedo.rest is not None:
        if len(total) and total.max() > 1 + SUM_TOLERANCE:
            got = f"{total.max():.3g} without the rest"
            raise InputError("surface.mixture: weights do not add up to 1", got=got, expected="at most 1")
        weights = np.insert(weights, albedo.rest, np.maximum(1 - total, 0), axis=1)
    elif len(total) and np.abs(total - 1).max() > SUM_TOLERANCE:
        got = f"{total.min():.3g} to {total.max():.3g}"
        raise InputError("surface.mixture: weights do not add up to 1", got=got, expected="1, or one weight: rest")
    return weights / weights.sum(axis=1, keepdims=True)


def _values(
    mi: ModuleType, channel: Channel, albedo: Albedo, mesh: Mesh, face: np.ndarray, uv: np.ndarray
) -> np.ndarray:
    """(n, C) float32: the values of one channel at points on faces."""
    source = channel.source
    if isinstance(source, Constant):
        found = np.full((len(face), 1), source.value, np.float32)
    elif isinstance(source, Image):
        if source.place is None:
            assert mesh.uv is not None
            place = interpolated(mesh, mesh.uv, face, uv)
        else:
            place = interpolated(mesh, mesh.vertices[:, :2] @ source.place[:, :2].T + source.place[:, 2], face, uv)
        found = _bilinear(source.samples, place)
    elif isinstance(source, VertexColours):
        assert mesh.colour is not None
        found = interpolated(mesh, mesh.colour @ source.mix, face, uv)
    else:
        found = _pattern(mi, source, albedo, interpolated(mesh, mesh.vertices, face, uv))[:, None]
    return np.asarray(channel.low + (channel.high - channel.low) * found, dtype=np.float32)


def _pattern(mi: ModuleType, pattern: Pattern, albedo: Albedo, position: np.ndarray) -> np.ndarray:
    """(n,) values of a pattern at positions (n, 3), scene units."""
    import drjit as dr

    at = pattern_position(albedo, position.T.astype(np.float64)).astype(np.float32)
    if is_scalar(mi):
        return np.array([pattern.value(mi, dr, mi.Point3f(point)) for point in at.T.tolist()], np.float32)
    out = np.empty(at.shape[1], np.float32)
    for first in range(0, len(out), POINTS_AT_ONCE):
        part = slice(first, first + POINTS_AT_ONCE)
        value: Any = pattern.value(mi, dr, mi.Point3f(np.ascontiguousarray(at[:, part])))
        out[part] = np.array(value)
    return out


def pattern_position(albedo: Albedo, position: Any) -> Any:
    """Positions (3, n), scene units, in the unit and about the origin of the patterns."""
    x, y = albedo.origin
    return (position - np.array([[x], [y], [0.0]])) / albedo.unit


@numba.njit(parallel=True, cache=True)
def _bilinear(samples, place):
    """``samples`` (h, w, C) at ``place`` (n, 2), bilinear between the middles of texels and repeated; (n, C)."""
    height, width, channels = samples.shape
    out = np.empty((place.shape[0], channels), np.float32)
    for i in numba.prange(place.shape[0]):
        x, y = place[i, 0] * width - 0.5, (1.0 - place[i, 1]) * height - 0.5
        col, row = np.floor(x), np.floor(y)
        a, b = x - col, y - row
        left, right = int(col) % width, (int(col) + 1) % width
        top, bottom = int(row) % height, (int(row) + 1) % height
        for c in range(channels):
            upper = (1.0 - a) * samples[top, left, c] + a * samples[top, right, c]
            lower = (1.0 - a) * samples[bottom, left, c] + a * samples[bottom, right, c]
            out[i, c] = (1.0 - b) * upper + b * lower
    return out
