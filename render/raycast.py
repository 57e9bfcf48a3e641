"""Intersects rays with the mesh: the only module that uses Mitsuba's ray tracing (Embree, or OptiX on a GPU).

Everything here is geometry, without spectra and reflectances. Arguments and results are NumPy arrays; inside, one
Dr.Jit kernel computes a chunk of rays.
"""

from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from huesphere.render.backend import is_scalar
from huesphere.render.points import SurfacePoints, points_at_all_vertices, points_at_vertices, points_on_faces
from huesphere.scenes.lights.source import EnvironmentLight, RayLight
from huesphere.scenes.mesh import Mesh

CHUNK_RAYS = (
    4_000_000  # rays in one launch: bounds memory (about 100 B a ray) and sets how often the progress bar moves
)


@dataclass(frozen=True)
class Hits:
    """The h hits of rays from n points, grouped by point: point i has the hits start[i]:start[i + 1]."""

    start: np.ndarray  # (n + 1,) int64
    face: np.ndarray  # (h,) int32, number of the face that is hit
    uv: np.ndarray  # (h, 2) float32, barycentric weights of the face's second and third corner
    # (h, M) float32, weight of each reflectance where it varies over faces; None: that of the face's material is 1
    weight: np.ndarray | None = None


class RayCaster:
    """A mesh prepared for ray tracing.

    ``offset``: distance from the surface at which rays start, in scene units. A hundredth of a pixel causes no false
    shadows and no measurable loss of indirect light; a quarter of a pixel loses 6 % of it.
    """

    subpixels = 4  # visibility of a light is averaged over subpixels² points of the pixel

    def __init__(self, mi: ModuleType, mesh: Mesh, offset: float) -> None:
        self.mi = mi
        self.mesh = mesh
        self.offset = offset
        self._at_vertices: SurfacePoints | None = None
        self._latest_starts: tuple[Any, ...] = (None, None, None)
        shape = mi.Mesh("scene", vertex_count=len(mesh.vertices), face_count=len(mesh.faces))
        parameters = mi.traverse(shape)
        self._vertices: Any = mesh.vertices.astype(np.float32).ravel()
        self._normals: Any = mesh.normals.astype(np.float32).ravel()
        self._faces: Any = mesh.faces.astype(np.uint32).ravel()
        parameters["vertex_positions"] = self._vertices
        parameters["faces"] = self._faces
        parameters.update()
        self.scene = mi.load_dict({"type": "scene", "mesh": shape})
        if not is_scalar(mi):
            self._vertices, self._normals = mi.Float(self._vertices), mi.Float(self._normals)
            self._faces = mi.UInt32(self._faces)

    # ---- from rays to surface points ----

    def first_hits(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, SurfacePoints]:
        """Cast rays from ``origins`` along ``directions``, (n, 3) each; (hit or not (n,), the points that were hit)."""
        found, faces, uvs = [], [], []
        for part in _chunks(len(origins), CHUNK_RAYS):
            preliminary = self._intersect(self._point(origins[part]), self._vector(directions[part]))
            valid = preliminary.is_valid().numpy()
            found.append(valid)
            faces.append(preliminary.prim_index.numpy()[valid].astype(np.int32))
            uvs.append(preliminary.prim_uv.numpy().T[valid])
        return np.concatenate(found), self.points_on(np.concatenate(faces), np.concatenate(uvs))

    def points_on(self, face: np.ndarray, uv: np.ndarray) -> SurfacePoints:
        return points_on_faces(self.mesh, face, uv, self.offset)

    def vertex_points(self, vertex: np.ndarray) -> SurfacePoints:
        return points_at_vertices(self.mesh, vertex, self.offset)

    def all_vertex_points(self) -> SurfacePoints:
        if self._at_vertices is None:
            self._at_vertices = points_at_all_vertices(self.mesh, self.offset)
        return self._at_vertices

    # ---- light that arrives ----

    def arriving(self, where: "SurfacePoints | Hits", light: RayLight, square: np.ndarray | None) -> np.ndarray:
        """Light of one source at points, (2, n) float32: without and with shadows.

        ``square`` (n, 2) in [0, 1)² chooses, for a ``sampled`` source, the point of the source that lights each point.
        """
        mi = self.mi
        import drjit as dr

        count = len(where.uv)
        if count == 0:
            return np.zeros((2, 0), np.float32)
        results = []
        for part in _chunks(count, CHUNK_RAYS):
            origin, normal, position = self._starts_once(where, part)
            # The strength is computed at the position itself; at the ray's start a near source would be too strong.
            toward, distance, strength = light.toward(mi, dr, position, self._square(square, part))
            ray = mi.Ray3f(origin, toward)
            if distance is not None:
                # The ray ends just before the source, which is not a part of the mesh.
                ray.maxt = distance * (1 - 1e-4)
            facing = dr.maximum(dr.dot(normal, toward), 0) * strength
            lit = facing > 0
            seen = dr.select(lit & ~self.scene.ray_test(ray, lit), facing, 0)
            dr.eval(facing, seen)
            results.append(np.stack([np.broadcast_to(v.numpy(), (part.stop - part.start,)) for v in (facing, seen)]))
        return np.concatenate(results, axis=1)

    def _square(self, square: np.ndarray | None, part: slice) -> tuple[Any, Any] | None:
        """Points (n, 2) of the unit square, those of ``part``, as Dr.Jit arrays."""
        if square is None:
            return None
        return tuple(self.mi.Float(np.ascontiguousarray(square[part, k], dtype=np.float32)) for k in (0, 1))

    def _starts_once(self, where: "SurfacePoints | Hits", part: slice) -> tuple[Any, Any, Any]:
        """`_starts`, computed once where one source after another is asked for its light at the same points."""
        latest, at, starts = self._latest_starts
        if latest is not where or at != part:
            import drjit as dr

            starts = self._starts(where, part)
            dr.eval(*starts)
            self._latest_starts = (where, part, starts)
        return starts

    def _starts(self, where: "SurfacePoints | Hits", part: slice) -> tuple[Any, Any, Any]:
        """Ray starts, normals and positions of points, as Dr.Jit arrays."""
        if isinstance(where, Hits):
            return self._surface(self.mi.UInt32(where.face[part].astype(np.uint32)), self.mi.Point2f(where.uv[part].T))
        return self._point(where.origin[part]), self._vector(where.normal[part]), self._point(where.position[part])

    # ---- hemispheres ----

    def hemisphere_hits(
        self,
        points: SurfacePoints,
        part: slice,
        directions: np.ndarray,
        shift: np.ndarray,
        environments: tuple[EnvironmentLight, ...] = (),
    ) -> tuple[Hits, np.ndarray]:
        """Cast S cosine-distributed rays from each of points[part], in the same pattern of directions.

        ``directions`` (S, 2) in the unit square; ``shift`` (n, 2) a Cranley–Patterson rotation for every point. Returns
        the hits on front faces, by point, and the light (n, D) of each of the D ``environments`` along the rays that
        hit nothing, as a mean over all rays.
        """
        mi = self.mi
        import drjit as dr

        count, rays = part.stop - part.start, len(directions)
        per_point, origin, direction = self._hemisphere(points, part, directions, shift)
        preliminary = self._intersect(origin, direction)
        hit = preliminary.is_valid()
        missed = dr.select(hit, mi.Float(0), mi.Float(1))
        sky = [missed * light.radiance(mi, dr, direction) for light in environments]
        hit &= dr.dot(self._facet_normal(preliminary.prim_index, hit), direction) < 0
        # All results are evaluated in one kernel; a result that is not would make its own kernel trace the rays again.
        dr.eval(hit, preliminary.prim_index, preliminary.prim_uv, *sky)
        means = [value.numpy().reshape(count, rays).mean(axis=1) for value in sky]
        light = np.stack(means, axis=1) if means else np.zeros((count, 0), np.float32)
        kept: Any = dr.compress(hit)
        if dr.width(kept) == 0:
            return _no_hits(count), light
        face = dr.gather(mi.UInt32, preliminary.prim_index, kept).numpy().astype(np.int32)
        uv = np.ascontiguousarray(dr.gather(mi.Point2f, preliminary.prim_uv, kept).numpy().T)
        return Hits(row_starts((kept // per_point).numpy(), count), face, uv), light

    def hemisphere_blocks(
        self, points: SurfacePoints, part: slice, directions: np.ndarray, shift: np.ndarray
    ) -> tuple[Hits, np.ndarray]:
        """Cast rays as `hemisphere_hits`; returns what blocks them, on front and back faces, and where each hit lies.

        The latter are the directions (h, 3) of the rays of the h hits. The face of a hit from behind is −face − 1.
        """
        mi = self.mi
        import drjit as dr

        count = part.stop - part.start
        per_point, origin, direction = self._hemisphere(points, part, directions, shift)
        preliminary = self._intersect(origin, direction)
        hit = preliminary.is_valid()
        front = dr.dot(self._facet_normal(preliminary.prim_index, hit), direction) < 0
        dr.eval(hit, front, preliminary.prim_index, preliminary.prim_uv, direction)
        kept: Any = dr.compress(hit)
        if dr.width(kept) == 0:
            return _no_hits(count), np.zeros((0, 3), np.float32)
        face = dr.gather(mi.UInt32, preliminary.prim_index, kept).numpy().astype(np.int32)
        face = np.where(dr.gather(mi.Bool, front, kept).numpy(), face, -face - 1)
        uv = np.ascontiguousarray(dr.gather(mi.Point2f, preliminary.prim_uv, kept).numpy().T)
        along = np.ascontiguousarray(dr.gather(mi.Vector3f, direction, kept).numpy().T)
        return Hits(row_starts((kept // per_point).numpy(), count), face, uv), along

    def _hemisphere(
        self, points: SurfacePoints, part: slice, directions: np.ndarray, shift: np.ndarray
    ) -> tuple[Any, Any, Any]:
        """(rays per point, origins, directions) of the rays of points[part], point by point, as kernel arrays.

        ``directions`` and ``shift`` as of `hemisphere_hits`.
        """
        mi = self.mi
        import drjit as dr

        count, rays = part.stop - part.start, len(directions)
        lane = dr.arange(mi.UInt32, count * rays)
        per_point = dr.opaque(mi.UInt32, rays)  # no literal in the code: one kernel serves every number of rays
        point: Any = lane // per_point
        sample: Any = lane - point * per_point
        table = mi.Float(directions.astype(np.float32).ravel())
        shifts = mi.Float(shift[part].astype(np.float32).ravel())
        square = dr.gather(mi.Point2f, table, sample) + dr.gather(mi.Point2f, shifts, point)
        square -= dr.floor(square)
        # Polar map of the unit square: sin²θ = u, φ = 2πv. The directions are cosine-distributed, and points that were
        # shifted around the square, modulo 1, go on around the angle φ without a seam.
        sin_theta, cos_theta = dr.sqrt(square.x), dr.sqrt(dr.maximum(1 - square.x, 0))
        sin_phi, cos_phi = dr.sincos(2 * dr.pi * square.y)
        normal = dr.gather(mi.Normal3f, mi.Float(points.normal[part].ravel()), point)
        direction = mi.Frame3f(normal).to_world(mi.Vector3f(sin_theta * cos_phi, sin_theta * sin_phi, cos_theta))
        return per_point, dr.gather(mi.Point3f, mi.Float(points.origin[part].ravel()), point), direction

    def hits_along(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Cast r rays, (r, 3) each; returns indices of those that hit, their faces (−face − 1 from behind) and uv."""
        import drjit as dr

        direction = self._vector(directions)
        preliminary = self._intersect(self._point(origins), direction)
        hit = preliminary.is_valid()
        front = dr.dot(self._facet_normal(preliminary.prim_index, hit), direction) < 0
        dr.eval(hit, front, preliminary.prim_index, preliminary.prim_uv)
        index = np.flatnonzero(hit.numpy())
        face = preliminary.prim_index.numpy()[index].astype(np.int32)
        return index, np.where(front.numpy()[index], face, -face - 1), preliminary.prim_uv.numpy().T[index]

    # ---- inside a kernel ----

    def _intersect(self, origin: Any, direction: Any) -> Any:
        return self.scene.ray_intersect_preliminary(self.mi.Ray3f(origin, direction))

    def _corners(self, face: Any, active: Any, buffer: Any, kind: Any) -> list[Any]:
        import drjit as dr

        corner: Any = dr.gather(self.mi.Vector3u, self._faces, face, active)
        return [dr.gather(kind, buffer, corner[k], active) for k in range(3)]

    def _facet_normal(self, face: Any, active: Any) -> Any:
        import drjit as dr

        a, b, c = self._corners(face, active, self._vertices, self.mi.Point3f)
        return dr.cross(b - a, c - a)

    def _surface(self, face: Any, uv: Any) -> tuple[Any, Any, Any]:
        """Ray start, interpolated normal and position, as `points_on_faces`, inside a kernel."""
        import drjit as dr

        vertices = self._corners(face, True, self._vertices, self.mi.Point3f)
        normals = self._corners(face, True, self._normals, self.mi.Normal3f)
        weights = [1 - uv.x - uv.y, uv.x, uv.y]
        position = sum((w * v for w, v in zip(weights[1:], vertices[1:], strict=True)), weights[0] * vertices[0])
        normal = dr.normalize(
            sum((w * n for w, n in zip(weights[1:], normals[1:], strict=True)), weights[0] * normals[0])
        )
        geometric = dr.normalize(dr.cross(vertices[1] - vertices[0], vertices[2] - vertices[0]))
        origin = position + self.offset * geometric
        for w, v, n in zip(weights, vertices, normals, strict=True):
            origin -= w * dr.minimum(dr.dot(position - v, n), 0) * n
        return origin, normal, position

    def _point(self, values: np.ndarray) -> Any:
        return self.mi.Point3f(np.ascontiguousarray(values.T, dtype=np.float32))

    def _vector(self, values: np.ndarray) -> Any:
        return self.mi.Vector3f(np.ascontiguousarray(values.T, dtype=np.float32))


class ScalarRayCaster(RayCaster):
    """A ray caster for the scalar variant, ray by ray: fast enough for rays of pixels, but not for hemispheres."""

    subpixels = 1

    def first_hits(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, SurfacePoints]:
        met = [self._one(o, d) for o, d in zip(origins.tolist(), directions.tolist(), strict=True)]
        found = np.array([m.is_valid() for m in met], dtype=bool)
        face = np.array([m.prim_index for m in met if m.is_valid()], dtype=np.int32)
        uv = np.array([[m.prim_uv[0], m.prim_uv[1]] for m in met if m.is_valid()], dtype=np.float32).reshape(-1, 2)
        return found, self.points_on(face, uv)

    def arriving(self, where: SurfacePoints | Hits, light: RayLight, square: np.ndarray | None) -> np.ndarray:
        mi = self.mi
        import drjit as dr

        assert isinstance(where, SurfacePoints)
        out = np.zeros((2, len(where.uv)), np.float32)
        for i, (origin, normal, position) in enumerate(
            zip(where.origin.tolist(), where.normal.tolist(), where.position.tolist(), strict=True)
        ):
            point = None if square is None else square[i].tolist()
            toward, distance, strength = light.toward(mi, dr, mi.Point3f(position), point)
            out[:, i] = max(dr.dot(mi.Vector3f(normal), toward), 0.0) * strength
            if out[0, i] > 0:
                ray = mi.Ray3f(mi.Point3f(origin), toward)
                if distance is not None:
                    ray.maxt = distance * (1 - 1e-4)
                out[1, i] *= not self.scene.ray_test(ray)
        return out

    def _one(self, origin: list[float], direction: list[float]) -> Any:
        return self.scene.ray_intersect_preliminary(self.mi.Ray3f(origin, direction))


def row_starts(row: np.ndarray, rows: int) -> np.ndarray:
    """Index of the first entry of each row, (rows + 1,), for entries that are in the order of their ``row``."""
    return np.concatenate([[0], np.cumsum(np.bincount(row, minlength=rows))])


def _no_hits(rows: int) -> Hits:
    return Hits(np.zeros(rows + 1, np.int64), np.zeros(0, np.int32), np.zeros((0, 2), np.float32))


def ray_caster(mi: ModuleType, mesh: Mesh, offset: float) -> RayCaster:
    """The ray caster that the variant of ``mi`` allows."""
    kind = ScalarRayCaster if is_scalar(mi) else RayCaster
    return kind(mi, mesh, offset)


def _chunks(count: int, size: int) -> list[slice]:
    return [slice(at, min(at + size, count)) for at in range(0, count, size)] or [slice(0, 0)]
