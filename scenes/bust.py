"""The built-in portrait bust: a head with a periwig and a coat, as the zero set of a distance function, and its mesh.

The distance function joins primitives (ellipsoids, capsules) with the polynomial smooth minimum; both are those of
I. Quilez ("distance functions", "smooth minimum", iquilezles.org). A part with blending radius k changes the joined
distance only at points where its own distance is less than that of the rest plus k (for a carved part: less than minus
that distance plus k), so that it can be skipped at all others. The mesh is made by marching cubes (Lewiner et al.,
"Efficient implementation of marching cubes' cases with topological guarantees", JGT 2003, as in scikit-image).

Frames: the bust is modelled with its full depth in the camera frame (x right, y up, z toward the camera; the sitter's
left is at +x). The unit is half the picture's side. Then its depth is scaled by RELIEF, which makes it a relief. The
parts of the head have a frame of their own, with its origin between the ears at the height of the eyes; the head is
rotated a little relative to the shoulders.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from skimage.measure import marching_cubes

from huesphere.scenes.mesh import Mesh

Floats = NDArray[np.floating]
Triple = tuple[float, float, float]

# ── The pose ─────────────────────────────────────────────────────────────────────────────────────────────────────────
RELIEF = 0.66  # factor of the depth, which makes the slopes of the surface smaller; the view from the front is the same
HEAD_ORIGIN = (0.0, 0.215, 0.0)  # origin of the head's frame in the bust's
HEAD_TURN = 9.0  # degrees about y, toward +x
HEAD_TILT = -2.5  # degrees about z
BOTTOM = -0.93  # y of the plane that cuts the chest
BACK = 0.0  # z, before the depth is scaled, of the plane that cuts the back
EXTENT = (0.96, 0.96, 0.42)  # half sides of the box that contains the bust, after the depth is scaled


# ── Parts ────────────────────────────────────────────────────────────────────────────────────────────────────────────
@dataclass(frozen=True)
class Ellipsoid:
    """An ellipsoid, rotated by `roll` degrees about z (positive from x to y)."""

    centre: Triple
    radii: Triple
    roll: float = 0.0

    def bound(self) -> tuple[Floats, float]:
        """Centre (3,) and radius of a sphere that holds the part."""
        return np.array(self.centre), max(self.radii)

    def distance(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """Approximate signed distance, negative inside: (k − 1) / |∇k| with k = |(x/a, y/b, z/c)|, 1 on the surface.

        Near the surface its error is of second order in the distance. a, b, c are the radii.
        """
        x, y, z = x - self.centre[0], y - self.centre[1], z - self.centre[2]
        if self.roll:
            c, s = np.cos(np.deg2rad(self.roll)), np.sin(np.deg2rad(self.roll))
            x, y = float(c) * x + float(s) * y, float(c) * y - float(s) * x
        a, b, c = self.radii
        x, y, z = x / a, y / b, z / c
        scaled = np.sqrt(x * x + y * y + z * z)
        slope = np.sqrt((x / a) ** 2 + (y / b) ** 2 + (z / c) ** 2)
        return scaled * (scaled - 1.0) / np.maximum(slope, 1e-6)


@dataclass(frozen=True)
class Limb:
    """A capsule from `start` to `end` whose radius goes linearly from the first of `radii` to the second."""

    start: Triple
    end: Triple
    radii: tuple[float, float]

    def bound(self) -> tuple[Floats, float]:
        """Centre (3,) and radius of a sphere that holds the part."""
        start, end = np.array(self.start), np.array(self.end)
        return (start + end) / 2, float(np.linalg.norm(end - start)) / 2 + max(self.radii)

    def distance(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """Distance to the axis less the radius there, which is a little less than the true distance if radii differ."""
        ux, uy, uz = (e - s for s, e in zip(self.start, self.end))
        x, y, z = x - self.start[0], y - self.start[1], z - self.start[2]
        along = np.clip((x * ux + y * uy + z * uz) / (ux * ux + uy * uy + uz * uz), 0.0, 1.0)
        x, y, z = x - along * ux, y - along * uy, z - along * uz
        along = along * along * (3.0 - 2.0 * along)  # makes the radius a smooth function at both ends
        return np.sqrt(x * x + y * y + z * z) - (self.radii[0] + (self.radii[1] - self.radii[0]) * along)


@dataclass(frozen=True)
class Lid:
    """The part of a ball on the far side of a plane with unit `normal`, at the distance `gap` from the centre."""

    centre: Triple
    radius: float
    normal: Triple
    gap: float
    softness: float

    def bound(self) -> tuple[Floats, float]:
        """Centre (3,) and radius of a sphere that holds the part."""
        return np.array(self.centre), self.radius

    def distance(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """Smooth intersection of ball and half-space."""
        x, y, z = x - self.centre[0], y - self.centre[1], z - self.centre[2]
        ball = np.sqrt(x * x + y * y + z * z) - self.radius
        plane = self.gap - (x * self.normal[0] + y * self.normal[1] + z * self.normal[2])
        return -smooth_minimum(-ball, -plane, self.softness)


@dataclass(frozen=True)
class Part:
    """One step of the modelling: a form that is added to the solid so far, or carved from it.

    `blend` is the blending radius. A `paired` part is made on both sides of the plane x = 0.
    """

    name: str
    do: Literal["add", "carve"]
    form: Ellipsoid | Limb | Lid
    blend: float
    paired: bool = False


EYE = (0.152, -0.005, 0.320)  # centre of the sitter's left eyeball, head's frame
EYE_RADIUS = 0.085  # larger than in life, as sculptors make it, so that the lids are several pixels wide


def _unit(x: float, y: float, z: float) -> Triple:
    """The direction (x, y, z) at length 1."""
    n = float(np.sqrt(x * x + y * y + z * z))
    return (x / n, y / n, z / n)


# Listed in the order of modelling. Head and hair are in the head's frame, the torso in the bust's.
HEAD = (
    Part("cranium", "add", Ellipsoid((0, 0.17, -0.06), (0.37, 0.43, 0.47)), 0.0),
    Part("face", "add", Ellipsoid((0, -0.10, 0.12), (0.315, 0.44, 0.325)), 0.15),
    Part("forehead", "add", Ellipsoid((0, 0.24, 0.20), (0.29, 0.22, 0.235)), 0.14),
    Part("jaw", "add", Ellipsoid((0, -0.36, 0.13), (0.265, 0.20, 0.26)), 0.12),
    Part("chin", "add", Ellipsoid((0, -0.50, 0.325), (0.10, 0.075, 0.085)), 0.12),
    Part("cheekbone", "add", Ellipsoid((0.20, -0.14, 0.29), (0.085, 0.085, 0.09)), 0.14, True),
    Part("mouth mound", "add", Ellipsoid((0, -0.335, 0.35), (0.14, 0.12, 0.10)), 0.12),
    Part("eye socket", "carve", Ellipsoid((0.155, 0.010, 0.470), (0.12, 0.066, 0.12), -4), 0.08, True),
    Part("brow", "add", Limb((0.065, 0.080, 0.425), (0.25, 0.10, 0.335), (0.026, 0.02)), 0.10, True),
    Part("eyeball", "add", Ellipsoid(EYE, (EYE_RADIUS,) * 3), 0.015, True),
    Part("upper lid", "add", Lid(EYE, EYE_RADIUS + 0.026, _unit(-0.03, 1, -0.50), 0.002, 0.022), 0.024, True),
    Part("lower lid", "add", Lid(EYE, EYE_RADIUS + 0.020, _unit(0, -1, -0.36), 0.002, 0.022), 0.024, True),
    Part("nose bridge", "add", Limb((0, 0.08, 0.405), (0, -0.17, 0.535), (0.026, 0.042)), 0.09),
    Part("nose tip", "add", Ellipsoid((0, -0.195, 0.535), (0.056, 0.046, 0.055)), 0.05),
    Part("nose wing", "add", Ellipsoid((0.064, -0.208, 0.470), (0.034, 0.036, 0.058)), 0.05, True),
    Part("nostril", "carve", Ellipsoid((0.032, -0.252, 0.51), (0.02, 0.014, 0.03)), 0.03, True),
    Part("philtrum", "carve", Limb((0, -0.26, 0.492), (0, -0.30, 0.487), (0.014, 0.014)), 0.03),
    Part("upper lip", "add", Limb((0.026, -0.322, 0.440), (0.11, -0.349, 0.355), (0.028, 0.010)), 0.06, True),
    Part("lower lip", "add", Limb((0.0, -0.380, 0.438), (0.10, -0.355, 0.355), (0.033, 0.012)), 0.06, True),
    Part("mouth", "carve", Limb((0, -0.352, 0.472), (0.115, -0.349, 0.445), (0.012, 0.007)), 0.045, True),
    Part("under the lip", "carve", Ellipsoid((0, -0.435, 0.455), (0.08, 0.02, 0.03)), 0.05),
    Part("fold of the cheek", "carve", Limb((0.105, -0.19, 0.480), (0.160, -0.27, 0.450), (0.02, 0.015)), 0.09, True),
)

HAIR = (
    Part("crown", "add", Ellipsoid((0, 0.22, -0.10), (0.47, 0.46, 0.48)), 0.0),
    Part("toupee", "add", Ellipsoid((0, 0.50, 0.12), (0.33, 0.15, 0.22)), 0.14),
    Part("side", "add", Ellipsoid((0.38, 0.02, -0.06), (0.21, 0.32, 0.27), 8), 0.15, True),
    Part("face opening", "carve", Ellipsoid((0, -0.09, 0.42), (0.30, 0.455, 0.50)), 0.06),
    Part("upper curl", "add", Limb((0.43, 0.17, 0.20), (0.44, 0.20, -0.25), (0.09, 0.10)), 0.03, True),
    Part("middle curl", "add", Limb((0.46, -0.03, 0.20), (0.48, 0.0, -0.25), (0.09, 0.10)), 0.03, True),
    Part("lower curl", "add", Limb((0.43, -0.22, 0.18), (0.46, -0.20, -0.25), (0.085, 0.10)), 0.03, True),
)

TORSO = (
    Part("chest", "add", Ellipsoid((0, -1.10, -0.12), (0.80, 0.60, 0.46)), 0.0),
    Part("shoulder", "add", Limb((0.14, -0.60, -0.14), (0.725, -0.83, -0.12), (0.17, 0.24)), 0.16, True),
    Part("neck", "add", Limb((0, 0.0, -0.06), (0, -0.70, -0.06), (0.21, 0.23)), 0.10),
    Part("neck muscle", "add", Limb((0.20, -0.2, -0.02), (0.05, -0.60, 0.115), (0.05, 0.035)), 0.06, True),
    Part("collar", "add", Ellipsoid((0.27, -0.56, 0.0), (0.075, 0.20, 0.20), 24), 0.05, True),
    Part("lapel", "add", Ellipsoid((0.29, -0.82, 0.17), (0.12, 0.27, 0.09), 14), 0.09, True),
    Part("cravat", "add", Ellipsoid((0, -0.57, 0.05), (0.235, 0.09, 0.17)), 0.03),
    Part("knot", "add", Ellipsoid((0, -0.63, 0.21), (0.075, 0.06, 0.06)), 0.03),
    Part("jabot", "add", Ellipsoid((0.0, -0.84, 0.21), (0.15, 0.25, 0.10)), 0.05),
)

PAIR_SOFTNESS = 0.02  # width over which |x| is rounded for paired parts, so that there is no crease at x = 0
HAIR_BLEND = 0.035  # blending radius of the hair with the head
NECK_BLEND = 0.05  # blending radius of head and hair with neck and coat
EDGE = 0.02  # blending radius of the bust with the planes that cut it


# ── The solid ────────────────────────────────────────────────────────────────────────────────────────────────────────
def smooth_minimum(a: Floats, b: Floats, blend: float) -> Floats:
    """`min(a, b)` where |a − b| ≥ blend; elsewhere up to blend/4 less, with a continuous slope."""
    if blend <= 0:
        return np.minimum(a, b)
    overlap = np.maximum(blend - np.abs(a - b), 0.0)
    return np.minimum(a, b) - overlap * overlap / (4.0 * blend)


def joined_distance(parts: tuple[Part, ...], points: Floats, *, skip: bool = True) -> Floats:
    """Signed distance (N,) to the solid of all parts, joined in their order, at points (3, N) of the parts' frame.

    With `skip`, a part is evaluated only at points whose distance to a sphere around the part is less than the distance
    found so far (for a carved part, the negative of that distance) plus 1.5 blending radii; elsewhere the part does not
    change the result. Half a radius of this is a margin, because the distances to ellipsoids are approximate. (Far from
    the surface the result may differ a little all the same.)
    """
    x, y, z = points
    beside = np.sqrt(x * x + x.dtype.type(PAIR_SOFTNESS**2))
    d = parts[0].form.distance(x, y, z)
    for part in parts[1:]:
        across = beside if part.paired else x
        sign = 1.0 if part.do == "add" else -1.0
        near: slice | NDArray[np.intp] = slice(None)
        if skip:
            (cx, cy, cz), radius = part.form.bound()
            reach = np.maximum(sign * d + (radius + 1.5 * part.blend), 0.0)
            near = np.flatnonzero((across - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2 < reach * reach)
        form = part.form.distance(across[near], y[near], z[near])
        d[near] = sign * smooth_minimum(sign * d[near], form, part.blend)
    return d


def _locks(points: Floats) -> Floats:
    """Height (N,) of the locks of hair at points (3, N) of the head's frame: waves that fan out from the face."""
    x, y, _ = points
    y = y + 0.1  # centre of the fan, at the root of the nose, where the height of the locks is 0
    square = x * x + y * y
    angle = np.arctan2(x, y)
    fan = np.sin(19.0 * angle + 1.6 * np.sin(11.0 * np.sqrt(square + 0.02) + 2.0 * angle))
    return 0.016 * square / (square + 0.03) * fan


def _folds(points: Floats) -> Floats:
    """Height (N,) of the folds of the cloth at points (3, N): a fan in the jabot, slanting waves in the sleeves."""
    x, y, _ = points
    beside = np.sqrt(x * x + x.dtype.type(PAIR_SOFTNESS**2))
    jabot = np.exp(-((x / 0.16) ** 2) - ((y + 0.88) / 0.17) ** 2)
    fan = np.cos(34.0 * x / (0.75 - np.clip(y + 0.75, -0.3, 0.3)))
    sleeve = np.exp(-(((beside - 0.68) / 0.24) ** 2))
    drape = np.sin(26.0 * (beside - 0.35 * y) + 5.0 * y * y)
    return 0.020 * jabot * fan + 0.016 * sleeve * drape


def _turned(points: Floats, degrees: float, axes: tuple[int, int]) -> Floats:
    """Coordinates (3, N) of points in a frame rotated by an angle from the first of two axes toward the second."""
    c, s = float(np.cos(np.deg2rad(degrees))), float(np.sin(np.deg2rad(degrees)))
    turned = points.copy()
    turned[axes[0]] = c * points[axes[0]] + s * points[axes[1]]
    turned[axes[1]] = c * points[axes[1]] - s * points[axes[0]]
    return turned


def bust_distance(points: Floats) -> Floats:
    """Signed distance to the bust, negative inside.

    Parameters: points (…, 3), camera frame, in halves of the picture's side; float32 or float64.
    Returns: (…,) in the same unit. It is zero at the surface and has the right sign everywhere. Its size is only an
    estimate of the distance, mostly too small: by up to the factor `RELIEF` where the depth is scaled, by more at
    smooth joins, and by an unknown amount deep inside overlapping parts.
    """
    points = np.asarray(points)
    precision = "float32" if points.dtype == np.float32 else "float64"
    flat: Floats = points.reshape(-1, 3).T.astype(precision)
    flat[2] /= RELIEF
    local: Floats = flat - np.array(HEAD_ORIGIN, dtype=precision)[:, None]
    local = _turned(_turned(local, HEAD_TILT, (0, 1)), HEAD_TURN, (2, 0))

    head = joined_distance(HEAD, local)
    hair = joined_distance(HAIR, local) - _locks(local)
    torso = joined_distance(TORSO, flat) - _folds(flat)
    d = smooth_minimum(smooth_minimum(head, hair, HAIR_BLEND), torso, NECK_BLEND)
    for inside in (flat[1] - BOTTOM, flat[2] - BACK):
        d = -smooth_minimum(-d, inside, EDGE)
    return (RELIEF * d).reshape(points.shape[:-1])


# ── The mesh ─────────────────────────────────────────────────────────────────────────────────────────────────────────
BLOCK = 4  # grid points along the side of a block; the distance at its centre decides whether the surface can be in it
STEP = 1e-4  # of the central differences; their error is far smaller than that of the facets


def _gradient(points: Floats) -> Floats:
    """Gradient (V, 3) of the distance at points (V, 3), by central differences."""
    steps = STEP * np.eye(3)
    return np.stack([bust_distance(points + s) - bust_distance(points - s) for s in steps], axis=1) / (2 * STEP)


def _distance_grid(cell: float) -> tuple[Floats, Floats]:
    """Signed distances on a regular grid over the whole bust, for marching cubes.

    Near the surface they are those of `bust_distance`. In blocks of BLOCK³ points that the surface cannot cross, all
    points have the distance at the block's centre, which has the right sign; this saves most evaluations.

    Parameters: cell, the spacing of the grid, in halves of the picture's side.
    Returns: the distances (X, Y, Z), float32, and the position (3,) of the first grid point, camera frame.
    """
    blocks = np.ceil(2 * np.array(EXTENT) / (BLOCK * cell)).astype(int)
    corner = -blocks * BLOCK * cell / 2
    axes = [(np.arange(n) + 0.5) * BLOCK * cell + c for n, c in zip(blocks, corner)]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).astype(np.float32)
    within = (np.stack(np.meshgrid(*[np.arange(BLOCK)] * 3, indexing="ij"), axis=-1) + (1 - BLOCK) / 2) * cell

    coarse = bust_distance(centres)
    distance = np.broadcast_to(coarse[..., None, None, None], coarse.shape + 3 * (BLOCK,)).copy()
    near = np.abs(coarse) < 0.5 * np.sqrt(3) * (BLOCK + 1) * cell  # half the diagonal of a block with a margin
    distance[near] = bust_distance(centres[near][:, None, None, None] + within.astype(np.float32))
    return distance.transpose(0, 3, 1, 4, 2, 5).reshape(blocks * BLOCK), corner + cell / 2


def bust_mesh(resolution: int = 180) -> Mesh:
    """The bust as a closed mesh with the normals of the solid itself.

    Parameters: resolution, cells of the meshing grid along the side of the picture's square.
    Returns: a mesh in the camera frame, centred, within [−0.95, 0.95]² in x and y, cut flat below and behind, of one
    material. Vertices lie on the zero of `bust_distance` (two Newton steps from marching cubes, none longer than a
    cell), and normals are its gradient there.
    """
    cell = 2.0 / resolution
    distance, first = _distance_grid(cell)
    vertices, faces, _, _ = marching_cubes(distance, 0.0)
    vertices = vertices.astype(np.float64) * cell + first
    gradient = _gradient(vertices)
    for _ in range(2):
        step = bust_distance(vertices) / np.maximum(np.sum(gradient**2, axis=1), 0.1)
        vertices -= np.clip(step, -cell, cell)[:, None] * gradient
    normals = _gradient(vertices)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Mesh(vertices, faces.astype(np.int32), normals, np.zeros(len(faces), np.int32))
