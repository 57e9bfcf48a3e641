"""Turns the faces of a mesh so that neighbours agree, and closed parts outward.

Two faces that share an edge agree where they run along it in opposite directions. Whether a set of connected faces can
be made to agree, and which of them are to be turned, follows from the double cover: each face is two nodes, as it is
and turned, and an edge joins the nodes that agree. If both nodes of a face are connected, as on a Möbius strip, its
part cannot be oriented and is left as it is; otherwise the part falls into two halves, the two ways to orient it.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components


@dataclass(frozen=True)
class Parts:
    """The connected parts of a mesh, numbered from 0; faces are connected where exactly two meet at an edge."""

    of_face: np.ndarray  # (F,) int, number of the part
    reverse: np.ndarray  # (F,) bool, the faces to turn so that all faces of a part agree
    closed: np.ndarray  # (parts,) bool, whether every edge of the part has two faces
    orientable: np.ndarray  # (parts,) bool

    @property
    def count(self) -> int:
        return len(self.closed)


def parts_of(faces: np.ndarray) -> Parts:
    """The parts of a mesh of ``faces`` (F, 3) without degenerate faces, whose vertices at one place are one vertex."""
    number = len(faces)
    tails, heads = faces[:, [0, 1, 2]].ravel(), faces[:, [1, 2, 0]].ravel()
    low, high = np.minimum(tails, heads).astype(np.int64), np.maximum(tails, heads).astype(np.int64)
    order = np.argsort(low * (int(faces.max()) + 1) + high, kind="stable")
    keys = (low * (int(faces.max()) + 1) + high)[order]
    start = np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]]))
    size = np.diff(np.concatenate([start, [len(keys)]]))
    one, other = order[start[size == 2]], order[start[size == 2] + 1]
    agree = tails[one] != tails[other]
    f, g = one // 3, other // 3
    shift = np.where(agree, 0, number)
    rows = np.concatenate([f, f + number])
    cols = np.concatenate([g + shift, (g + number - shift)])
    graph = coo_array((np.ones(len(rows), bool), (rows, cols)), shape=(2 * number, 2 * number))
    _, label = connected_components(graph, directed=False)
    as_it_is, turned = label[:number], label[number:]
    _, of_face = np.unique(np.minimum(as_it_is, turned), return_inverse=True)
    count = int(of_face.max()) + 1
    orientable = np.ones(count, dtype=bool)
    orientable[of_face[as_it_is == turned]] = False
    open_edges = order[np.repeat(size != 2, size)] // 3
    closed = np.ones(count, dtype=bool)
    closed[of_face[open_edges]] = False
    return Parts(of_face, as_it_is > turned, closed, orientable)


def oriented(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, int]:
    """(faces (F, 3), the number of those that were turned) such that neighbours agree and closed parts face outward.

    A part that is not closed keeps the side on which most of its faces are wound counter-clockwise. So does a closed
    part whose faces agree, all inward, within another: the wall of a cavity.
    """
    parts = parts_of(faces)
    turn = parts.reverse & parts.orientable[parts.of_face]
    in_part = np.bincount(parts.of_face, minlength=parts.count)
    turned = np.bincount(parts.of_face, weights=turn, minlength=parts.count)
    volume = _volumes(vertices, faces, parts, turn)
    mixed = (turned > 0) & (turned < in_part)
    other_side = turned > in_part / 2  # keeps most faces
    solid = parts.closed & parts.orientable & (volume != 0)
    other_side[solid] = volume[solid] < 0
    cavity = solid & ~mixed & _inside_another(vertices, faces, parts, np.abs(volume))
    other_side[cavity] = turned[cavity] > 0
    other_side &= parts.orientable
    turn ^= other_side[parts.of_face]
    return np.where(turn[:, None], faces[:, ::-1], faces), int(turn.sum())


def _volumes(vertices: np.ndarray, faces: np.ndarray, parts: Parts, turn: np.ndarray) -> np.ndarray:
    """Signed volume (parts,) that each part encloses with some faces turned; without meaning for open parts."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    # About the middle of each part, so that parts far from the origin lose no digits.
    sums = np.stack([np.bincount(parts.of_face, weights=a[:, k], minlength=parts.count) for k in range(3)], axis=1)
    middle = sums / np.bincount(parts.of_face, minlength=parts.count)[:, None]
    a, b, c = (corner - middle[parts.of_face] for corner in (a, b, c))
    six = np.einsum("fc,fc->f", a, np.cross(b, c)) * np.where(turn, -1.0, 1.0)
    return np.bincount(parts.of_face, weights=six, minlength=parts.count) / 6


def _inside_another(vertices: np.ndarray, faces: np.ndarray, parts: Parts, volume: np.ndarray) -> np.ndarray:
    """Whether the bounding box of each part (parts,) lies within that of a closed part of larger ``volume``."""
    low = np.full((parts.count, 3), np.inf)
    high = np.full((parts.count, 3), -np.inf)
    for k in range(3):
        np.minimum.at(low, parts.of_face, vertices[faces[:, k]])
        np.maximum.at(high, parts.of_face, vertices[faces[:, k]])
    inside = np.zeros(parts.count, dtype=bool)
    for outer in np.argsort(-volume)[:64]:  # the largest ones: a part with a cavity is larger than the cavity
        if parts.closed[outer]:
            within = (low > low[outer]).all(axis=1) & (high < high[outer]).all(axis=1)
            inside |= within & (volume < volume[outer])
    return inside
