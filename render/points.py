"""Points on a mesh, with the normal of the surface, and the start of rays that leave each point."""

from dataclasses import dataclass, fields

import numba
import numpy as np

from huesphere.scenes.mesh import Mesh


@dataclass(frozen=True)
class SurfacePoints:
    """Points on the mesh, in scene units and camera frame."""

    face: np.ndarray  # (n,) int32
    uv: np.ndarray  # (n, 2) float32, barycentric weights of the face's second and third corner
    position: np.ndarray  # (n, 3) float32, on the facet
    normal: np.ndarray  # (n, 3) float32, unit, interpolated between the normals of the face's corners
    origin: np.ndarray  # (n, 3) float32, where rays that leave the point start: just off the smooth surface

    def take(self, chosen: np.ndarray) -> "SurfacePoints":
        """Those of the points that ``chosen``, a mask or indices, selects."""
        return SurfacePoints(*(getattr(self, f.name)[chosen] for f in fields(self)))


def points_on_faces(mesh: Mesh, face: np.ndarray, uv: np.ndarray, offset: float) -> SurfacePoints:
    """Surface points from faces (n,) and barycentric coordinates (n, 2); rays start ``offset`` off the surface."""
    face = np.ascontiguousarray(face, dtype=np.int32)
    uv = np.ascontiguousarray(uv, dtype=np.float32)
    vertices, normals = (np.ascontiguousarray(a, dtype=np.float64) for a in (mesh.vertices, mesh.normals))
    return SurfacePoints(face, uv, *_on_faces(face, uv, vertices, normals, mesh.faces, offset))


@numba.njit(parallel=True, cache=True)
def _on_faces(face, uv, vertices, normals, faces, offset):
    """Positions, unit normals and ray starts, (n, 3) each, computed in double precision."""
    position = np.empty((len(face), 3), np.float32)
    normal = np.empty((len(face), 3), np.float32)
    origin = np.empty((len(face), 3), np.float32)
    for i in numba.prange(len(face)):
        weight = (1.0 - np.float64(uv[i, 0]) - uv[i, 1], np.float64(uv[i, 0]), np.float64(uv[i, 1]))
        a, b, c = faces[face[i], 0], faces[face[i], 1], faces[face[i], 2]
        x = weight[0] * vertices[a, 0] + weight[1] * vertices[b, 0] + weight[2] * vertices[c, 0]
        y = weight[0] * vertices[a, 1] + weight[1] * vertices[b, 1] + weight[2] * vertices[c, 1]
        z = weight[0] * vertices[a, 2] + weight[1] * vertices[b, 2] + weight[2] * vertices[c, 2]
        n0 = weight[0] * normals[a, 0] + weight[1] * normals[b, 0] + weight[2] * normals[c, 0]
        n1 = weight[0] * normals[a, 1] + weight[1] * normals[b, 1] + weight[2] * normals[c, 1]
        n2 = weight[0] * normals[a, 2] + weight[1] * normals[b, 2] + weight[2] * normals[c, 2]
        length = max(np.sqrt(n0 * n0 + n1 * n1 + n2 * n2), 1e-30)
        normal[i, 0], normal[i, 1], normal[i, 2] = n0 / length, n1 / length, n2 / length
        position[i, 0], position[i, 1], position[i, 2] = x, y, z
        p0, q0 = vertices[b, 0] - vertices[a, 0], vertices[c, 0] - vertices[a, 0]
        p1, q1 = vertices[b, 1] - vertices[a, 1], vertices[c, 1] - vertices[a, 1]
        p2, q2 = vertices[b, 2] - vertices[a, 2], vertices[c, 2] - vertices[a, 2]
        g0, g1, g2 = p1 * q2 - p2 * q1, p2 * q0 - p0 * q2, p0 * q1 - p1 * q0
        length = max(np.sqrt(g0 * g0 + g1 * g1 + g2 * g2), 1e-300)
        o0, o1, o2 = x + offset * g0 / length, y + offset * g1 / length, z + offset * g2 / length
        # Shadow terminator (Hanika 2021): where the facet is below the smooth surface, the start is lifted to the
        # tangent planes of the corners; otherwise convex facets would shadow themselves.
        for k, v in enumerate((a, b, c)):
            below = (x - vertices[v, 0]) * normals[v, 0]
            below += (y - vertices[v, 1]) * normals[v, 1] + (z - vertices[v, 2]) * normals[v, 2]
            lift = -weight[k] * min(below, 0.0)
            o0, o1, o2 = o0 + lift * normals[v, 0], o1 + lift * normals[v, 1], o2 + lift * normals[v, 2]
        origin[i, 0], origin[i, 1], origin[i, 2] = o0, o1, o2
    return position, normal, origin


def points_at_vertices(mesh: Mesh, vertex: np.ndarray, offset: float) -> SurfacePoints:
    """Surface points at mesh vertices (n,): rays start ``offset`` along the vertex normal."""
    position, normal = mesh.vertices[vertex], mesh.normals[vertex]
    origin = position + offset * normal
    nowhere = np.full(len(vertex), -1, np.int32)
    return SurfacePoints(
        nowhere, np.zeros((len(vertex), 2), np.float32), *(a.astype(np.float32) for a in (position, normal, origin))
    )


def points_at_all_vertices(mesh: Mesh, offset: float) -> SurfacePoints:
    """A point for every mesh vertex, at which light that is stored at vertices is computed.

    For vertices on an open edge or a crease, where light is undefined, the point is moved a tenth of the way toward the
    middle of their faces.
    """
    points = points_at_vertices(mesh, np.arange(len(mesh.vertices)), offset)
    first, second = (mesh.faces[:, corners].ravel().astype(np.int64) for corners in ([0, 1, 2], [1, 2, 0]))
    number = np.minimum(first, second) * len(mesh.vertices) + np.maximum(first, second)  # one for each edge
    edge, count = np.unique(number, return_counts=True)
    rim = np.unique(np.divmod(edge[count == 1], len(mesh.vertices)))
    centroid = mesh.vertices[mesh.faces].mean(axis=1)
    total = np.zeros_like(mesh.vertices)
    np.add.at(total, mesh.faces.ravel(), np.repeat(centroid, 3, axis=0))
    valence = np.bincount(mesh.faces.ravel(), minlength=len(total))
    inward = 0.1 * (total[rim] / np.maximum(valence[rim], 1)[:, None] - mesh.vertices[rim])
    inward[valence[rim] == 0] = 0
    position, origin = points.position.copy(), points.origin.copy()
    position[rim] += inward
    origin[rim] += inward
    return SurfacePoints(points.face, points.uv, position, points.normal, origin)
