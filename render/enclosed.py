"""Bounces in a closed room: light from its walls is integrated without sampling noise.

A room is a box: from any point inside, every ray ends on a wall, and the point where it does has a formula. So light
from the walls is integrated over the walls as if the object were not there. Rays that hit the object then add a
correction: the light that the object sends minus that of the wall behind it. Only the correction is sampled.
"""

from dataclasses import replace

import numba
import numpy as np
from scipy.spatial import cKDTree

from huesphere.render.bounces import BounceRequest, Bounces
from huesphere.render.gather import at_hits, mean_over_rays
from huesphere.render.raycast import CHUNK_RAYS, Hits, SurfacePoints, row_starts
from huesphere.scenes.lights.source import RayLight, UniformLight
from huesphere.scenes.quadrature import fibonacci_lattice

POINT_RAYS = 256  # rays from each point of walls and object at which the bounces after the first are computed
OBJECT_POINTS = 4096  # number of such points on the object
LIGHT_POINTS = 64  # sample points of an extended source, as seen from a wall
GAUSS = np.array([-1.0, 1.0]) / np.sqrt(3.0) / 2 + 0.5  # two-point Gauss–Legendre abscissae on [0, 1], equal weights
BLOCK = 512  # points whose form factors to the walls are in memory at once


# ---- geometry ------------------------------------------------------------------------------------------------------


@numba.njit(cache=True, inline="always")
def _frame(nx, ny, nz):
    """Two unit vectors that complete a normal to a right-handed frame (Duff et al. 2017)."""
    sign = 1.0 if nz >= 0 else -1.0
    a = -1.0 / (sign + nz)
    b = nx * ny * a
    return 1.0 + sign * nx * nx * a, sign * b, -sign * nx, b, sign + ny * ny * a, -ny


@numba.njit(parallel=True, cache=True)
def _directions(normal, square, shift):
    """Cosine-distributed directions (points × rays, 3) about each ``normal`` (points, 3).

    From a lattice ``square`` (rays, 2) in [0, 1)², shifted by ``shift`` (points, 2) for each point.
    """
    points, rays = normal.shape[0], square.shape[0]
    out = np.empty((points * rays, 3), np.float32)
    for i in numba.prange(points):
        sx, sy, sz, tx, ty, tz = _frame(normal[i, 0], normal[i, 1], normal[i, 2])
        for j in range(rays):
            u = (square[j, 0] + shift[i, 0]) % 1.0
            phi = 2 * np.pi * (square[j, 1] + shift[i, 1])
            a, b, c = np.sqrt(u) * np.cos(phi), np.sqrt(u) * np.sin(phi), np.sqrt(max(0.0, 1.0 - u))
            out[i * rays + j, 0] = a * sx + b * tx + c * normal[i, 0]
            out[i * rays + j, 1] = a * sy + b * ty + c * normal[i, 1]
            out[i * rays + j, 2] = a * sz + b * tz + c * normal[i, 2]
    return out


# More than seven parameters: an inlined function of numbers, called for every ray.
@numba.njit(cache=True, inline="always")
def _exit(ox, oy, oz, dx, dy, dz, low, high, detail):
    """Where a ray from o along d leaves the box from ``low`` to ``high``: (wall, cell u, cell v, share u, share v).

    Each wall has detail × detail cells; the shares, 0 to 1, are the place within the cell; u, v as in
    `Enclosure.rectangles`.
    """
    best, axis, up = np.inf, 0, False
    for k, (o, d) in enumerate(((ox, dx), (oy, dy), (oz, dz))):
        if d != 0.0:
            t = ((high[k] if d > 0 else low[k]) - o) / d
            if t < best:
                best, axis, up = t, k, d > 0
    px = (ox + best * dx - low[0]) / (high[0] - low[0]) * detail
    py = (oy + best * dy - low[1]) / (high[1] - low[1]) * detail
    pz = (oz + best * dz - low[2]) / (high[2] - low[2]) * detail
    if axis == 0:
        wall, u, v = (1, pz, py) if up else (0, py, pz)
    elif axis == 1:
        wall, u, v = (3, px, pz) if up else (2, pz, px)
    else:
        wall, u, v = (5, py, px) if up else (4, px, py)
    u, v = min(max(u, 0.0), detail * 1.0), min(max(v, 0.0), detail * 1.0)
    cu, cv = min(int(u), detail - 1), min(int(v), detail - 1)
    return wall, cu, cv, u - cu, v - cv


@numba.njit(parallel=True, cache=True)
def _wall_sums(start, origin, direction, low, high, detail, values):
    """(n, 6, C): light of the walls where the rays of each point end, summed for each wall.

    Point i at ``origin`` (n, 3) has the rays start[i]:start[i + 1] of ``direction``; ``values`` (6, g, g, C) is the
    light at the grid points of the walls, interpolated bilinearly.
    """
    points, columns = origin.shape[0], values.shape[-1]
    out = np.zeros((points, 6, columns), np.float32)
    for i in numba.prange(points):
        for j in range(start[i], start[i + 1]):
            wall, cu, cv, s, t = _exit(
                origin[i, 0],
                origin[i, 1],
                origin[i, 2],
                direction[j, 0],
                direction[j, 1],
                direction[j, 2],
                low,
                high,
                detail,
            )
            for c in range(columns):
                out[i, wall, c] += (1 - s) * (
                    (1 - t) * values[wall, cu, cv, c] + t * values[wall, cu, cv + 1, c]
                ) + s * ((1 - t) * values[wall, cu + 1, cv, c] + t * values[wall, cu + 1, cv + 1, c])
    return out


@numba.njit(parallel=True, cache=True)
def _form_factors(position, normal, targets, inward, area):
    """Form factors (n, G), cos cos A / (π r²), from G wall points of ``area`` A at ``targets`` to n surface points.

    ``inward`` (3,) is the normal of the wall.
    """
    out = np.empty((position.shape[0], targets.shape[0]), np.float32)
    for i in numba.prange(position.shape[0]):
        for g in range(targets.shape[0]):
            dx, dy, dz = targets[g, 0] - position[i, 0], targets[g, 1] - position[i, 1], targets[g, 2] - position[i, 2]
            square = dx * dx + dy * dy + dz * dz
            here = normal[i, 0] * dx + normal[i, 1] * dy + normal[i, 2] * dz
            there = -(inward[0] * dx + inward[1] * dy + inward[2] * dz)
            out[i, g] = max(here, 0.0) * max(there, 0.0) * area / (np.pi * square * square)
    return out


class EnclosedBounces(Bounces):
    """The bounces of a scene in a room; images and components are those of `Bounces`."""

    # Light after the first bounce, on the walls and at vertices of the object
    _solved: tuple[np.ndarray, np.ndarray] | None = None
    # Points, light of the walls, and the light that the points receive from the walls without the object between;
    # these need no rays, so they are computed once
    _open: tuple[SurfacePoints, np.ndarray, np.ndarray] | None = None

    def first_bounce(self, request: BounceRequest, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As `Bounces.first_bounce`; a room has no domes."""
        return self._images(replace(request, points=request.points.take(chosen)), None)

    def all_bounces(self, request: BounceRequest) -> tuple[np.ndarray, np.ndarray]:
        """As `Bounces.all_bounces`; a room has no domes."""
        if self._solved is None and self.orders > 1:
            # Computed once for all independent estimates: thousands of points average its noise to far below that of
            # the correction.
            self._solved = self._solve(request.seed[:1])
        return self._images(request, self._solved)

    # ---- light on the walls and what comes of it ----

    def _wall_points(self) -> SurfacePoints:
        """The grid points of the walls, moved a little away from the edges of the room, where light is undefined."""
        room = self._room
        mesh = room.mesh()
        middle = (room.low + room.high) / 2
        inset = 1 - 0.02 / room.detail
        position = (middle + (mesh.vertices - middle) * inset).astype(np.float32)
        nowhere = np.full(len(position), -1, np.int32)
        return SurfacePoints(
            nowhere, np.zeros((len(position), 2), np.float32), position, mesh.normals.astype(np.float32), position
        )

    @property
    def _room(self):
        assert self.scene.enclosure is not None
        return self.scene.enclosure

    def _direct(self, points: SurfacePoints) -> np.ndarray:
        """(n, L) direct light at points; that of extended sources is the mean over LIGHT_POINTS points of each."""
        out = np.zeros((len(points.uv), len(self.scene.lights)), np.float32)
        for i, light in enumerate(self.scene.lights):
            if isinstance(light, UniformLight):
                out[:, i] = 1.0
            elif isinstance(light, RayLight):  # a closed room has no sky
                lattice = fibonacci_lattice(LIGHT_POINTS if light.sampled else 1)
                squares = (np.broadcast_to(point, (len(out), 2)) for point in lattice)
                out[:, i] = sum(self.caster.arriving(points, light, square)[1] for square in squares) / len(lattice)
        return out

    def _on_walls(self, values: np.ndarray) -> np.ndarray:
        """(6 g², C) as (6, g, g, C)."""
        grid = self._room.detail + 1
        return np.ascontiguousarray(values.reshape(6, grid, grid, -1), dtype=np.float32)

    def _wall_sums(self, start: np.ndarray, origin: np.ndarray, direction: np.ndarray, light: np.ndarray) -> np.ndarray:
        """(n, 6, C): ``light`` (6 g², C) of the walls where the rays of each point end, summed for each wall."""
        room = self._room
        return _wall_sums(start, origin, direction, room.low, room.high, room.detail, self._on_walls(light))

    def _solve(self, seed: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Light of all bounces together that arrives at the wall points (6 g², C) and at object vertices (V, C).

        Columns are wavelength nodes by sources. On the object it is computed at OBJECT_POINTS vertices, and every other
        vertex takes the value of the nearest of them. That is accurate enough: this light reaches the picture only
        after another reflection.
        """
        rng = np.random.default_rng((*seed, 5))
        vertices = self.caster.all_vertex_points()
        chosen = np.sort(rng.permutation(len(vertices.uv))[:OBJECT_POINTS])
        scale = np.ptp(vertices.position, axis=0).max()
        place = np.concatenate([vertices.position, 0.3 * scale * vertices.normal], axis=1)
        nearest = cKDTree(place[chosen]).query(place)[1]
        walls, few = self._wall_points(), vertices.take(chosen)
        points = SurfacePoints(
            *(np.concatenate([getattr(walls, f), getattr(few, f)]) for f in walls.__dataclass_fields__)
        )
        rays = POINT_RAYS
        shift = rng.random((len(points.uv), 2))
        direction = _directions(points.normal, fibonacci_lattice(rays), shift)
        index, face, uv = self.caster.hits_along(np.repeat(points.origin, rays, axis=0), direction)
        hits = Hits(row_starts(index // rays, len(points.uv)), face, np.ascontiguousarray(uv, dtype=np.float32))
        free = np.delete(np.arange(len(direction)), index)
        free_start, free_direction = row_starts(free // rays, len(points.uv)), direction[free]
        count = len(walls.uv)
        direct_walls = self._direct(walls)
        at_wavelengths = self.scene.reflectances[:, self.nodes]  # (M, J)

        def reflected(wall_light: np.ndarray, hit_light: np.ndarray, factors: np.ndarray) -> np.ndarray:
            """Light of the next bounce at the points, (n, C), from light on walls (6 g², C) and at the hits (h, C)."""
            sums = self._wall_sums(free_start, points.origin, free_direction, wall_light) / rays
            first = self._room.first_material
            from_walls = np.einsum("nwc,wc->nc", sums, factors[first : first + 6])
            from_object = mean_over_rays(hits, np.zeros(len(hits.face), np.int32), 1, hit_light, rays)[:, 0]
            return from_walls + from_object

        lights = len(self.scene.lights)
        columns = len(self.nodes) * lights
        factors = np.repeat(at_wavelengths, lights, axis=1).astype(np.float32)
        front = self.with_weights(Hits(hits.start, np.maximum(hits.face, 0), hits.uv))
        on_object = self._reflected(front, factors)
        on_object[hits.face < 0] = 0.0  # seen from behind: black

        def spread(values: np.ndarray) -> np.ndarray:
            return np.tile(values[:, None], (1, len(self.nodes), 1)).reshape(len(values), columns)

        direct_hits = self._light_at(front, None, rng)
        term = reflected(spread(direct_walls), spread(direct_hits) * on_object, factors)
        total = term.copy()
        floor = self.negligible * max(float(np.abs(term).mean()), 1e-30)
        for _ in range(2, self.orders):
            at_vertices = term[count:][nearest]
            term = reflected(term[:count], at_hits(front, self.scene.mesh, at_vertices) * on_object, factors)
            total += term
            if np.abs(term).mean() <= floor:
                break
        return total[:count], total[count:][nearest]

    # ---- images at the pixels ----

    def _images(
        self, request: BounceRequest, later: tuple[np.ndarray, np.ndarray] | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """(light of domes (n, 0), images (L, C, n)): light of the unobstructed walls, plus the object's correction.

        ``later`` is the light of later bounces that ``_solve`` returns, None for the first bounce only.
        """
        points, rays, seed, report = request.points, request.rays, request.seed, request.report
        lights, kinds = len(self.scene.lights), len(self.reflecting)
        if self._open is None or self._open[0] is not points or later is None:
            direct = self._direct(self._wall_points())
            values = direct if later is None else np.concatenate([direct, later[0]], axis=1)
            self._open = points, values, self._open_walls(points, self._on_walls(values))
        wall_values, by_wall = self._open[1], self._open[2].copy()  # (6 g², L + C), (n, 6, L + C)
        first = np.zeros((len(points.uv), kinds, lights), np.float32)
        extra = 0 if later is None else later[0].shape[1]
        onward = np.zeros((len(points.uv), extra), np.float32)
        rng = np.random.default_rng((*seed, 6))
        square, shift = fibonacci_lattice(rays), rng.random((len(points.uv), 2))
        size = max(1, CHUNK_RAYS // rays)
        for at in range(0, len(points.uv), size):
            part = slice(at, min(at + size, len(points.uv)))
            hits, direction = self.caster.hemisphere_blocks(points, part, square, shift)
            by_wall[part] -= self._wall_sums(hits.start, points.origin[part], direction, wall_values) / rays
            front = self.with_weights(Hits(hits.start, np.maximum(hits.face, 0), hits.uv))
            light = self._light_at(front, None, rng)
            kind = np.where(hits.face >= 0, self.face_kind[front.face], -1).astype(np.int32)
            light[kind < 0] = 0.0
            first[part] += self.first_by_kind(front, kind, light, rays)
            if later is not None:
                sent = at_hits(front, self.scene.mesh, later[1]) * self._reflected(front, self._factor(extra))
                onward[part] += mean_over_rays(hits, np.minimum(kind, 0), 1, sent, rays)[:, 0]
            report(part.stop / len(points.uv))
        material = self._room.first_material + np.arange(6)
        for wall, number in enumerate(material):
            if self.kind[number] >= 0:
                first[:, self.kind[number]] += by_wall[:, wall, :lights]
        if later is not None:
            onward += np.einsum("nwc,wc->nc", by_wall[:, :, lights:], self._factor(extra)[material])
        images = np.concatenate([first, onward.reshape(len(first), -1, lights)], axis=1)
        return np.zeros((len(points.uv), 0), np.float32), images.transpose(2, 1, 0)

    def _reflected(self, hits: Hits, factor: np.ndarray) -> np.ndarray:
        """Factor (h, C) of the light that the hits reflect, from that of each material, ``factor`` (M, C)."""
        return factor[self.scene.mesh.material[hits.face]] if hits.weight is None else hits.weight @ factor

    def _open_walls(self, points: SurfacePoints, values: np.ndarray) -> np.ndarray:
        """(n, 6, C) light from each wall at points, with nothing between; ``values`` (6, g, g, C) on the walls."""
        room = self._room
        out = np.zeros((len(points.uv), 6, values.shape[-1]), np.float32)
        places = ((np.arange(room.detail)[:, None] + GAUSS) / room.detail).ravel()
        cell = np.minimum((places * room.detail).astype(int), room.detail - 1)
        share = (places * room.detail - cell)[:, None].astype(np.float32)
        for wall, (corner, u, v) in enumerate(room.rectangles()):
            targets = (corner + places[:, None, None] * u + places[None, :, None] * v).reshape(-1, 3)
            along = values[wall, cell] * (1 - share[..., None]) + values[wall, cell + 1] * share[..., None]
            at_gauss = along[:, cell] * (1 - share[None]) + along[:, cell + 1] * share[None]
            cross = np.cross(u, v)
            area = float(np.linalg.norm(cross))
            sent = at_gauss.reshape(len(targets), -1)
            for at in range(0, len(out), BLOCK):
                part = slice(at, at + BLOCK)
                factors = _form_factors(
                    points.position[part], points.normal[part], targets, cross / area, area / len(targets)
                )
                out[part, wall] = factors @ sent
        return out
