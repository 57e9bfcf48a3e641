"""A random solid: balls, struts and a ring run together, with hollows cut in, tunnels drilled through, and fine relief.

The solid is where a smooth signed distance f is negative (constructive solid geometry with a soft minimum: J. Hart,
"Sphere tracing", The Visual Computer 12, 1996; the soft minimum −s ln Σ exp(−f_k / s) of its pieces). f is sampled on
a grid and meshed by marching cubes; the vertices are then moved onto f = 0, whose gradient gives their normals.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numba
import numpy as np
from scipy import ndimage

from huesphere.scenes.mesh import Mesh, area_normals
from huesphere.scenes.primitives import rotation_matrix

SOFT = 0.07  # length over which pieces run into each other
LEAST_OVERHANG = 0.05  # share of the solid's columns that a ray along the view axis enters more than once
LEAST_VOLUME = 0.01  # share of the cube
SEARCH_CELLS = 40  # along an edge of the grid on which a draw is tried
MOST_DRAWS = 100  # after them the last solid is taken, whatever its overhang
ROUNDING = 2.0**-20  # of sampled distances, so that the last bits of a machine's arithmetic do not change the mesh
STEEPNESS = 1.6  # slope of the fine relief at amplitude 1: three standard deviations
RESOLVED = 0.8  # least cosine between the gradient and the mean normal of the faces around a vertex
LEAST_COSINE = 0.2  # between the normal of a face and those at its vertices
WAVES = 12  # plane waves that make up the fine relief

Distance = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class _Solid:
    """The pieces of a drawn solid; lengths in units of their own."""

    balls: np.ndarray  # (n, 4) centre and radius
    struts: np.ndarray  # (n, 7) both ends and radius
    rings: np.ndarray  # (n, 8) centre, unit axis, radius of the ring, radius of its tube
    hollows: np.ndarray  # (n, 4) centre and radius of balls that are cut out
    tunnels: np.ndarray  # (n, 7) a point, a unit direction and the radius of cylinders that are cut out
    waves: np.ndarray  # (n, 5) wave vector, phase and amplitude of the relief

    @property
    def reach(self) -> float:
        """Half the edge of a cube about 0 that holds the solid, with some space around it."""
        balls = np.abs(self.balls[:, :3]).max(axis=1) + self.balls[:, 3]
        struts = np.abs(self.struts[:, :6]).max(axis=1) + self.struts[:, 6]
        rings = np.abs(self.rings[:, :3]).max(axis=1) + self.rings[:, 6] + self.rings[:, 7]
        run_together = SOFT * np.log(len(balls) + len(struts) + len(rings)) + np.sum(np.abs(self.waves[:, 4]))
        return float(max(balls.max(), struts.max(), rings.max(initial=0.0)) + run_together)


def sculpture(
    seed: int,
    *,
    detail: int,
    size: float,
    holes: int,
    relief: float,
    rotation_deg: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Mesh:
    """The solid number ``seed``, turned by ``rotation_deg`` (about x, then y, then z) and scaled into [−1, 1]².

    ``detail``: grid cells along an edge of its cube. ``size``: factor of the radii of its parts, 1 as usual. ``holes``:
    tunnels that are drilled through it, close to the view axis. ``relief``: amplitude of the fine relief, 0 for none,
    1 for about a twentieth of the solid's radius. Camera frame. The same arguments give the same mesh on any machine.
    """
    rng = np.random.default_rng([seed, 0x5C])
    for _ in range(MOST_DRAWS):
        solid = _draw(rng, size, holes, relief)
        distance, reach = _distance(solid), solid.reach
        if _is_interesting(_largest_part(distance(_grid(SEARCH_CELLS, reach)) < 0)):
            break
    vertices, faces = _meshed(_near_surface(distance, detail, reach, 1 + STEEPNESS * relief), reach)
    normals = _gradient(distance, vertices, 1e-3)
    # One step of Newton's method onto f = 0.
    step = (distance(vertices) / np.maximum(np.sum(normals * normals, axis=1), 0.25))[:, None] * normals
    vertices = vertices - np.clip(step, -reach / detail, reach / detail)
    normals = _gradient(distance, vertices, 1e-3)
    vertices, faces, normals = _with_sharp_ends(vertices, faces, _sound(normals, vertices, faces))
    turn = rotation_matrix(rotation_deg)
    vertices, normals = vertices @ turn.T, normals @ turn.T
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    vertices = (vertices - middle) / np.abs((vertices - middle)[:, :2]).max()
    return Mesh(vertices, faces.astype(np.int32), normals, np.zeros(len(faces), np.int32))


def _grid(cells: int, reach: float) -> np.ndarray:
    """Points (cells, cells, cells, 3) of the cube from −reach to reach, indexed by x, y, z."""
    axis = np.linspace(-reach, reach, cells)
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)


# ---- what is drawn -------------------------------------------------------------------------------------------------


def _draw(rng: np.random.Generator, size: float, holes: int, relief: float) -> _Solid:
    centres = rng.normal(0, 0.5, (int(rng.integers(4, 8)), 3)).clip(-0.9, 0.9)
    balls = np.column_stack([centres, size * rng.uniform(0.22, 0.48, len(centres))])
    struts = []
    for _ in range(int(rng.integers(2, 6))):
        first, second = centres[rng.choice(len(centres), 2, replace=False)] * rng.uniform(0.8, 1.3)
        struts.append([*first, *second, size * rng.uniform(0.08, 0.2)])
    rings = []
    for _ in range(int(rng.integers(0, 3))):
        about = centres[rng.integers(len(centres))]
        rings.append([*about, *_unit(rng), rng.uniform(0.35, 0.6), size * rng.uniform(0.08, 0.15)])
    hollows = [[*rng.normal(0, 0.5, 3), size * rng.uniform(0.15, 0.35)] for _ in range(int(rng.integers(1, 4)))]
    tunnels = []
    for _ in range(holes):
        through = centres[rng.integers(len(centres))] + rng.normal(0, 0.1, 3)
        axis = np.array([*rng.normal(0, 0.35, 2), 1.0])
        tunnels.append([*through, *(axis / np.sqrt(np.sum(axis * axis))), rng.uniform(0.07, 0.16)])
    waves = np.empty((WAVES, 5))
    for wave in waves:
        length = np.exp(rng.uniform(np.log(0.18), np.log(0.8)))
        wave[:3] = 2 * np.pi / length * _unit(rng)
        wave[3] = rng.uniform(0, 2 * np.pi)
        wave[4] = 0.12 * relief * length / np.sqrt(WAVES)  # the slope is that of all lengths
    return _Solid(balls, _rows(struts, 7), _rows(rings, 8), _rows(hollows, 4), _rows(tunnels, 7), waves)


def _rows(drawn: list[list[float]], width: int) -> np.ndarray:
    """The parts of one kind as (n, width) float64, also where there are none."""
    return np.array(drawn, float).reshape(-1, width)


def _unit(rng: np.random.Generator) -> np.ndarray:
    """A unit vector (3,), uniform over the sphere."""
    vector = rng.normal(0, 1, 3)
    return np.asarray(vector / np.sqrt(np.sum(vector * vector)))


def _is_interesting(inside: np.ndarray) -> bool:
    """Whether a solid, given on a grid as (n, n, n) bool indexed by x, y, z, is large enough and overhangs itself."""
    entries = (np.diff(inside.astype(np.int8), axis=2, prepend=0) > 0).sum(axis=2)
    return bool(inside.mean() > LEAST_VOLUME and (entries > 1).sum() >= LEAST_OVERHANG * (entries > 0).sum())


# ---- the distance --------------------------------------------------------------------------------------------------


def _distance(solid: _Solid) -> Distance:
    """The smooth distance f (...,) of the solid, as a function of points (..., 3); negative inside."""

    def distance(points: np.ndarray) -> np.ndarray:
        flat = np.ascontiguousarray(points.reshape(-1, 3))
        values = _evaluate(flat, solid.balls, solid.struts, solid.rings, solid.hollows, solid.tunnels, solid.waves)
        return np.asarray(values).reshape(points.shape[:-1])

    return distance


# More than seven parameters: compiled code takes the arrays of the record one by one.
@numba.njit(parallel=True, cache=True)
def _evaluate(points, balls, struts, rings, hollows, tunnels, waves):
    """f at ``points`` (n, 3), from the arrays of `_Solid`."""
    out = np.empty(len(points))
    for i in numba.prange(len(points)):
        p = points[i]
        total = 0.0
        for ball in balls:
            total += np.exp(-(_apart(p, ball) - ball[3]) / SOFT)
        for strut in struts:
            along, square = 0.0, 1e-12
            for k in range(3):
                along += (p[k] - strut[k]) * (strut[k + 3] - strut[k])
                square += (strut[k + 3] - strut[k]) ** 2
            share = min(max(along / square, 0.0), 1.0)
            near = strut[:3] + share * (strut[3:6] - strut[:3])
            total += np.exp(-(_apart(p, near) - strut[6]) / SOFT)
        for ring in rings:
            height, radius = _cylindrical(p, ring)
            total += np.exp(-(np.sqrt((radius - ring[6]) ** 2 + height**2) - ring[7]) / SOFT)
        f = -SOFT * np.log(max(total, 1e-250))
        for hollow in hollows:
            f = _soft_maximum(f, hollow[3] - _apart(p, hollow))
        for tunnel in tunnels:
            f = _soft_maximum(f, tunnel[6] - _cylindrical(p, tunnel)[1])
        for wave in waves:
            f += wave[4] * np.cos(p[0] * wave[0] + p[1] * wave[1] + p[2] * wave[2] + wave[3])
        out[i] = f
    return out


@numba.njit(cache=True)
def _apart(p, q):
    """Distance of two points, of which the first three coordinates count."""
    return np.sqrt((p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2)


@numba.njit(cache=True)
def _cylindrical(p, line):
    """(height of p along a line, distance from it); ``line``: a point on it, then its unit direction."""
    height = 0.0
    for k in range(3):
        height += (p[k] - line[k]) * line[k + 3]
    return height, np.sqrt(max(_apart(p, line) ** 2 - height**2, 0.0))


@numba.njit(cache=True)
def _soft_maximum(a, b):
    """The larger of two lengths, rounded off as pieces are."""
    return max(a, b) + SOFT * np.log1p(np.exp(-abs(a - b) / SOFT))


def _gradient(distance: Distance, points: np.ndarray, step: float) -> np.ndarray:
    """Gradient (n, 3) of f at ``points`` (n, 3), by centred differences over ``step``."""
    steps = np.eye(3) * step
    return np.stack([(distance(points + s) - distance(points - s)) / (2 * step) for s in steps], axis=1)


def _sound(normals: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """``normals`` (V, 3) as unit vectors; those of the faces around a vertex where the grid did not resolve f.

    That is the case at the thin ends of walls, where the gradient turns within a cell or vanishes.
    """
    area = area_normals(vertices, faces)
    around = np.zeros_like(vertices)
    for corner in range(3):
        for axis in range(3):
            around[:, axis] += np.bincount(faces[:, corner], area[:, axis], len(vertices))
    unit, around = (v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-12) for v in (normals, around))
    return np.where((np.sum(unit * around, axis=1) < RESOLVED)[:, None], around, unit)


def _with_sharp_ends(
    vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The mesh with corners of their own, and with its own normal, for each face that its vertices' normals turn away.

    Those are a few faces at the thin ends of walls. (vertices (V, 3), faces (F, 3), normals (V, 3)).
    """
    facet = area_normals(vertices, faces)
    facet /= np.maximum(np.linalg.norm(facet, axis=1, keepdims=True), 1e-12)
    sharp = (np.einsum("fkc,fc->fk", normals[faces], facet) < LEAST_COSINE).any(axis=1)
    new = np.arange(3 * sharp.sum()).reshape(-1, 3) + len(vertices)
    vertices = np.concatenate([vertices, vertices[faces[sharp]].reshape(-1, 3)])
    normals = np.concatenate([normals, np.repeat(facet[sharp], 3, axis=0)])
    faces = faces.copy()
    faces[sharp] = new
    return vertices, faces, normals


# ---- the mesh ------------------------------------------------------------------------------------------------------


def _largest_part(inside: np.ndarray) -> np.ndarray:
    """The largest connected part of a solid on a grid, (n, n, n) bool."""
    part, count = ndimage.label(inside)
    if count <= 1:
        return inside
    return np.asarray(part == 1 + np.argmax(np.bincount(part.ravel())[1:]))


def _near_surface(distance: Distance, cells: int, half: float, steepest: float) -> np.ndarray:
    """f on the grid of (cells)³ points, exact at the corners of all cells that f = 0 passes through.

    Elsewhere it is that of a point two steps away at most, with the right sign, as f is nowhere steeper than
    ``steepest``.
    """
    points = _grid(cells, half)
    coarse = distance(points[::2, ::2, ::2])
    reach = 2 * np.sqrt(3.0) * (2 * half / (cells - 1)) * steepest
    sampled = coarse.repeat(2, axis=0).repeat(2, axis=1).repeat(2, axis=2)[:cells, :cells, :cells]
    near = np.abs(sampled) < reach
    sampled[near] = distance(points[near])
    return sampled


def _meshed(sampled: np.ndarray, half: float) -> tuple[np.ndarray, np.ndarray]:
    """(vertices (V, 3), faces (F, 3)) of the largest part of f = 0, by marching cubes; faces look outward.

    ``sampled``: f on the grid of the cube from −half to half.
    """
    from skimage.measure import marching_cubes

    sampled = np.round(sampled / ROUNDING) * ROUNDING
    inside = sampled < 0
    others = inside & ~_largest_part(inside)
    sampled = np.where(others, -sampled + ROUNDING, sampled)
    vertices, faces, _, _ = marching_cubes(sampled, 0.0, allow_degenerate=False)
    vertices = vertices.astype(np.float64) * (2 * half / (len(sampled) - 1)) - half
    return _outermost(vertices, faces)


def _outermost(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The largest connected part of a mesh: bubbles enclosed in the solid cannot be seen."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    first, second = faces.ravel(), faces[:, [1, 2, 0]].ravel()
    graph = coo_array((np.ones(len(first), np.int8), (first, second)), shape=(len(vertices), len(vertices)))
    _, part = connected_components(graph, directed=False)
    largest = np.argmax(np.bincount(part[faces[:, 0]]))
    kept = faces[part[faces[:, 0]] == largest]
    used, renumbered = np.unique(kept, return_inverse=True)
    return vertices[used], renumbered.reshape(-1, 3)
