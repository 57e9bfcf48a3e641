"""Pairs of neighbouring pixels of an object, what they connect, and the discrete Laplacian over them.

An image over the object is a vector (P,) of its P pixels in raster order; pairs hold the numbers of pixels in it.
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph


@dataclass(frozen=True)
class Edges:
    """Pairs of 4-neighbours (i, j) within the object, by pixel number in raster order; j is right of or above i."""

    i: np.ndarray  # (E,)
    j: np.ndarray  # (E,)
    upward: np.ndarray  # (E,) bool: j is above i, and not to its right


def edges_within(mask: np.ndarray) -> Edges:
    """All pairs of 4-neighbours with both pixels in ``mask`` (H, W)."""
    number = np.cumsum(mask.ravel()).reshape(mask.shape) - 1
    right, up = mask[:, :-1] & mask[:, 1:], mask[1:] & mask[:-1]
    i = np.concatenate([number[:, :-1][right], number[1:][up]])
    j = np.concatenate([number[:, 1:][right], number[:-1][up]])
    return Edges(i, j, np.arange(len(i)) >= right.sum())


def components(edges: Edges, count: int, joined: np.ndarray) -> np.ndarray:
    """Number (P,) of the connected component that each of ``count`` pixels is in, by the edges ``joined`` (E,) bool."""
    graph = sparse.coo_array((np.ones(int(joined.sum()), np.int8), (edges.i[joined], edges.j[joined])), (count, count))
    return np.asarray(csgraph.connected_components(graph, directed=False)[1])


def laplacian(edges: Edges, weight: np.ndarray, diagonal: np.ndarray) -> sparse.csr_array:
    """The symmetric matrix (P, P) with −``weight`` (E,) at the pixels of each edge and the given ``diagonal`` (P,).

    With the sum of the weights at each pixel on the diagonal it is that of the form Σ weight (z_j − z_i)².
    """
    count = len(diagonal)
    A = sparse.coo_array((-weight, (edges.i, edges.j)), (count, count)).tocsr()
    return (A + A.T + sparse.diags_array(diagonal)).tocsr()
