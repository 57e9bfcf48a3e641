"""Which of two mirrored normals a whole region has, where the lights that it sees give both the same colour.

Two lights, or more whose directions lie in a plane, give one colour to a normal and to its mirror image in that plane:
the two sheets of a flat ellipsoid. A smooth surface is on one sheet until its normal passes through the plane, and on
the other from there on. So pixels whose normal is off the plane make up regions of one sheet, and two regions that face
each other across a band of pixels near the plane are on opposite sheets. One choice is left for all regions that hang
together in this way; the sum of their pixels' costs decides it.
"""

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components

from huesphere.recover.geometry.neighbours import components, edges_within

JOINED_COSINE = 0.98  # of the normals of neighbours on one sheet, from which they belong to one smooth surface
OFF_PLANE = 0.1  # component of a normal across the plane from which it is surely on one of the sheets
IN_PLANE = 0.04  # a surface that passes through the plane has a smaller component somewhere in the band
WIDEST_BAND = 0.2  # of the object's size, the root of its area
FEWEST_CROSSINGS = 3  # lines of pixels that lead from one region to the other across the band


def one_sheet_a_region(
    first: np.ndarray, second: np.ndarray, costs: np.ndarray, own: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(whether a pixel is on the second sheet (H, W), whether that is decided (H, W)).

    ``first``, ``second`` (H, W, 3): unit normals on the two sheets, of the pixels ``own`` (H, W). ``costs`` (2, H, W)
    of either. Undecided are pixels near the plane between the sheets, and regions whose bands contradict each other.
    """
    off = np.where(own, np.linalg.norm(first - second, axis=-1) / 2, 0.0)
    region, count = _regions(first, own & (off > OFF_PLANE))
    decided = region >= 0
    if not count:
        return np.zeros(own.shape, bool), decided
    crossings = _crossings(region, off, own & ~decided, count, WIDEST_BAND * np.sqrt(own.sum()))
    # Each region is two nodes, one for each sheet; those of opposite sheets are joined across a band.
    r, s = (crossings >= FEWEST_CROSSINGS).nonzero()
    rows, columns = np.concatenate([r, r + count]), np.concatenate([s + count, s])
    links = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(2 * count, 2 * count))
    together, group = connected_components(links, directed=False)
    own_costs = np.concatenate([np.bincount(region[decided], cost[decided], minlength=count) for cost in costs])
    total = np.bincount(group, own_costs, minlength=together)
    on_first, on_second = total[group[:count]], total[group[count:]]
    contradicted = group[:count] == group[count:]
    second_sheet, decided_region = on_second < on_first, ~contradicted
    at = np.where(decided, region, 0)
    return decided & second_sheet[at], decided & decided_region[at]


def _regions(n: np.ndarray, where: np.ndarray) -> tuple[np.ndarray, int]:
    """(number of each pixel's region (H, W), −1 elsewhere; how many): neighbours ``where`` (H, W) with like normals."""
    edges = edges_within(where)
    own = n[where]
    alike = np.sum(own[edges.i] * own[edges.j], axis=-1) > JOINED_COSINE
    region = np.full(where.shape, -1)
    region[where] = components(edges, len(own), alike)
    return region, int(region.max(initial=-1)) + 1


def _crossings(region: np.ndarray, off: np.ndarray, band: np.ndarray, count: int, widest: float) -> csr_matrix:
    """(count, count), sparse: how many lines of pixels, along rows or columns, lead across the band between regions.

    ``off`` (H, W): component across the plane; ``widest``: pixels of the ``band`` (H, W) on such a line, at most.
    """
    ends: list[np.ndarray] = []
    for regions, offs, bands in ((region, off, band), (region.T, off.T, band.T)):
        width = regions.shape[1]
        least, between = np.full(regions.shape, np.inf), np.ones(regions.shape, bool)
        for step in range(2, min(int(widest) + 2, width)):
            # ``between``: the step − 1 pixels after each one are all in the band; ``least``: of their components.
            inside = between[:, : width - step] & bands[:, step - 1 : width - 1]
            low = np.minimum(least[:, : width - step], offs[:, step - 1 : width - 1])
            between, least = inside, low
            here, there = regions[:, : width - step], regions[:, step:]
            across = inside & (low < IN_PLANE) & (here >= 0) & (there >= 0)
            ends.append(np.stack([here[across], there[across]]))
    p, q = np.concatenate(ends, axis=1) if ends else np.zeros((2, 0), int)
    out = coo_matrix((np.ones(len(p), int), (p, q)), shape=(count, count)).tocsr()
    return out + out.T
