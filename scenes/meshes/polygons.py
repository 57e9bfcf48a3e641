"""Polygons as triangles that cover the same area, reentrant corners included.

A convex polygon is a fan of triangles about its first corner. Any other one is cut ear by ear: an ear is a convex
corner whose triangle holds no other corner of the polygon (G. H. Meisters, Polygons have ears, 1975).
"""

from dataclasses import dataclass

import numpy as np

from huesphere.configs.errors import InputError

MOST_CORNERS = 20_000  # of one polygon; the time to cut ears grows with the square


@dataclass(frozen=True)
class Polygons:
    """A mesh of polygons, as a file holds it."""

    vertices: np.ndarray  # (V, 3) float64
    corners: np.ndarray  # (sum of counts,) int64, the corners of all polygons, one polygon after the other
    counts: np.ndarray  # (P,) int64, corners of each polygon
    uv: np.ndarray | None = None  # (sum of counts, 2) texture coordinates of the corners; None if not all have some
    colour: np.ndarray | None = None  # (V, 3) linear R, G, B of the vertices, full scale 1


def require_indices(polygons: Polygons, where: object) -> None:
    """Raise InputError if the polygons have corners that are no vertices of the mesh."""
    corners = polygons.corners
    if len(corners) and (corners.min() < 0 or corners.max() >= len(polygons.vertices)):
        raise InputError("a mesh with triangles of vertices that it does not have", where=where)


def triangulated(polygons: Polygons, where: object) -> tuple[np.ndarray, int]:
    """(triangles (F, 3) int64, number of polygons that are not convex). Polygons of one or two corners are left out."""
    start = np.cumsum(polygons.counts) - polygons.counts
    triangles = polygons.corners[start[polygons.counts == 3][:, None] + np.arange(3)]
    quads = polygons.corners[start[polygons.counts == 4][:, None] + np.arange(4)]
    halves, reentrant = _halved(polygons.vertices, quads)
    parts = [triangles, halves]
    for number in np.flatnonzero(polygons.counts > 4):
        count = int(polygons.counts[number])
        if count > MOST_CORNERS:
            raise InputError("a polygon", got=f"{count} corners", expected=f"at most {MOST_CORNERS}", where=where)
        ring = polygons.corners[start[number] : start[number] + count]
        flat = _in_its_plane(polygons.vertices[ring])
        if (_turns(flat) >= 0).all() and _winds_once(flat):
            fan = np.stack([np.zeros(count - 2, int), np.arange(1, count - 1), np.arange(2, count)], axis=1)
        else:
            fan, reentrant = _ears(flat), reentrant + 1
        parts.append(ring[fan])
    return np.concatenate(parts).astype(np.int64), reentrant


def _halved(vertices: np.ndarray, quads: np.ndarray) -> tuple[np.ndarray, int]:
    """(triangles (2Q, 3) of quads (Q, 4), number of those with a reentrant corner).

    A quad is cut from its first to its third corner, unless a triangle would then lie outside the quad.
    """
    a, b, c, d = (vertices[quads[:, k]] for k in range(4))
    normal = np.cross(c - a, d - b)
    inside = [np.einsum("qc,qc->q", np.cross(q - p, r - p), normal) for p, q, r in ((a, b, c), (a, c, d))]
    other = (inside[0] < 0) | (inside[1] < 0)
    first = np.where(other[:, None], quads[:, [1, 2, 3]], quads[:, [0, 1, 2]])
    second = np.where(other[:, None], quads[:, [1, 3, 0]], quads[:, [0, 2, 3]])
    cuts = [np.einsum("qc,qc->q", np.cross(q - p, r - p), normal) < 0 for p, q, r in ((b, c, d), (b, d, a))]
    return np.concatenate([first, second]), int((other | cuts[0] | cuts[1]).sum())


def _in_its_plane(ring: np.ndarray) -> np.ndarray:
    """Corners (n, 3) of a polygon as points (n, 2) of its plane, counter-clockwise; by Newell's normal."""
    ring = ring - ring.mean(axis=0)
    normal = np.cross(ring, np.roll(ring, -1, axis=0)).sum(axis=0)
    axis = int(np.abs(normal).argmax())
    u, v = (axis + 1) % 3, (axis + 2) % 3
    return ring[:, [u, v]] if normal[axis] >= 0 else ring[:, [v, u]]


def _turns(flat: np.ndarray) -> np.ndarray:
    """Twice the area (n,) of the triangle of each corner and its neighbours; positive where the corner is convex."""
    before, after = flat - np.roll(flat, 1, axis=0), np.roll(flat, -1, axis=0) - flat
    return before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]


def _winds_once(flat: np.ndarray) -> bool:
    """Whether a polygon that turns to one side only goes round once, rather than as a star does."""
    edges = np.roll(flat, -1, axis=0) - flat
    angles = np.arctan2(edges[:, 1], edges[:, 0])
    turns = (np.roll(angles, -1) - angles + np.pi) % (2 * np.pi) - np.pi
    return bool(abs(turns.sum()) < 3 * np.pi)


def _ears(flat: np.ndarray) -> np.ndarray:
    """Triangles (n − 2, 3) of a polygon (n, 2), counter-clockwise, as numbers of its corners.

    A polygon that crosses itself has no ear at some point; then its most convex corner is cut off.
    """
    left = list(range(len(flat)))
    found = []
    while len(left) > 3:
        ring = flat[left]
        turns = _turns(ring)
        reentrant = np.flatnonzero(turns <= 0)
        candidates = np.flatnonzero(turns > 0)
        ear = next((k for k in candidates if _is_ear(ring, int(k), reentrant)), int(turns.argmax()))
        found.append([left[ear - 1], left[ear], left[(ear + 1) % len(left)]])
        del left[ear]
    return np.array([*found, left])


def _is_ear(ring: np.ndarray, k: int, reentrant: np.ndarray) -> bool:
    """Whether no reentrant corner lies in the triangle of the convex corner ``k`` and its neighbours."""
    a, b, c = ring[k - 1], ring[k], ring[(k + 1) % len(ring)]
    others = ring[reentrant]
    others = others[~((others == a).all(axis=1) | (others == b).all(axis=1) | (others == c).all(axis=1))]
    inside = np.ones(len(others), dtype=bool)
    for p, q in ((a, b), (b, c), (c, a)):
        inside &= (q[0] - p[0]) * (others[:, 1] - p[1]) - (q[1] - p[1]) * (others[:, 0] - p[0]) >= 0
    return not inside.any()
