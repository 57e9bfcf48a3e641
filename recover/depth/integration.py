"""Depth from slopes that are known here and not there (report 2.4): Poisson, and Harris' coupled depth and slope.

Where slopes are known they alone decide, by least squares. Gaps are bridged by a surface whose slopes are unknowns
too and vary as little as may be: J. G. Harris, "A new approach to surface reconstruction: the coupled depth/slope
model", ICCV 1987 (the report's [24]). Differences are taken only between pixels of the object, which makes its outline
free: the natural boundary conditions of Y. Li, UBC TR-91-24 (1991), the report's [27].
Frame: camera, x right, y up, z toward the camera, in pixels; image row 0 at the top.
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph
from scipy.sparse.linalg import LinearOperator, cg, splu

from huesphere.recover.depth.parameters import DEPTH
from huesphere.recover.robust_scale import mad_scale

MODELS = ("coupled", "poisson", "robust", "harris")
DIRECT_UP_TO = 30_000  # unknowns: below, a factorisation is quicker than a multigrid hierarchy, and exact
TOLERANCE = 1e-5  # of conjugate gradients, on the residual: 5e-5 px of depth at 1024²; slopes of 8 bits leave 0.02 px
MOST_ROUNDS = 40  # of reweighting in "robust": the scale has shrunk to its least long before


@dataclass(frozen=True)
class Edges:
    """Pairs of 4-neighbours (i, j) within the object, by pixel number in raster order; j is right of or above i."""

    i: np.ndarray  # (E,)
    j: np.ndarray  # (E,)
    upward: np.ndarray  # (E,) bool: j is above i, and not to its right


def depth_from_normals(
    normals: np.ndarray, valid: np.ndarray, mask: np.ndarray, *, model: str = "coupled"
) -> np.ndarray:
    """Depth (H, W) in pixels toward the camera, NaN off ``mask`` (H, W), from normals (H, W, 3) known where ``valid``.

    ``model``: "coupled" (known slopes as they are, Harris' surface over the gaps), "poisson" (gaps as a soft
    membrane), "robust" (as coupled, but depth may jump where slopes say so: occlusions), "harris" (the coupled model as
    published, slopes unknown everywhere: the slow reference). Mean 0 over each connected piece of the mask, for nothing
    ties one to another. Raises ValueError for an unknown model or shapes that do not agree.
    """
    if model not in MODELS:
        raise ValueError(f"model: got {model!r}, expected one of {', '.join(MODELS)}")
    if normals.shape != (*mask.shape, 3) or valid.shape != mask.shape:
        raise ValueError(f"normals {normals.shape}, valid {valid.shape} and mask {mask.shape} do not agree")
    with np.errstate(invalid="ignore"):
        known = mask & valid & (normals[..., 2] > DEPTH.steepest_n3)
    n = np.where(known[..., None], normals, [0.0, 0.0, 1.0]).astype(np.float64)
    return depth_from_slopes(-n[..., 0] / n[..., 2], -n[..., 1] / n[..., 2], known, mask, model=model)


def depth_from_slopes(
    p: np.ndarray, q: np.ndarray, known: np.ndarray, mask: np.ndarray, *, model: str = "coupled"
) -> np.ndarray:
    """As ``depth_from_normals``, from p = ∂z/∂x and q = ∂z/∂y (H, W) that count where ``known`` (H, W)."""
    edges = edges_within(mask)
    p, q, inside = (image[mask] for image in (np.where(known, p, 0.0), np.where(known, q, 0.0), known & mask))
    solve = {"coupled": _coupled, "poisson": _poisson, "robust": _torn, "harris": _harris}[model]
    z = solve(p, q, inside, edges)
    piece = _components(edges, len(z), np.ones(len(edges.i), bool))
    z -= (np.bincount(piece, z) / np.bincount(piece))[piece]
    depth = np.full(mask.shape, np.nan)
    depth[mask] = z
    return depth


def edges_within(mask: np.ndarray) -> Edges:
    """All pairs of 4-neighbours of which both are in ``mask`` (H, W)."""
    number = np.cumsum(mask.ravel()).reshape(mask.shape) - 1
    right, up = mask[:, :-1] & mask[:, 1:], mask[1:] & mask[:-1]
    i = np.concatenate([number[:, :-1][right], number[1:][up]])
    j = np.concatenate([number[:, 1:][right], number[:-1][up]])
    return Edges(i, j, np.arange(len(i)) >= right.sum())


def rise(p: np.ndarray, q: np.ndarray, known: np.ndarray, edges: Edges) -> np.ndarray:
    """z_j − z_i (E,) that the slopes of the two ends ask for: their mean, or the one that is known, or 0."""
    at_i = np.where(edges.upward, q[edges.i], p[edges.i])
    at_j = np.where(edges.upward, q[edges.j], p[edges.j])
    ends = known[edges.i].astype(float) + known[edges.j]
    return (at_i * known[edges.i] + at_j * known[edges.j]) / np.maximum(ends, 1)


# ---- the models, each z (P,) of the object's pixels in raster order --------------------------------------------------


def _poisson(p: np.ndarray, q: np.ndarray, known: np.ndarray, edges: Edges) -> np.ndarray:
    """Least Σ w (z_j − z_i − rise)², with w = 1 between known slopes and DEPTH.gap_weight elsewhere."""
    weight = np.where(known[edges.i] & known[edges.j], 1.0, DEPTH.gap_weight)
    return _membrane(rise(p, q, known, edges), weight, edges, len(p))


def _coupled(p: np.ndarray, q: np.ndarray, known: np.ndarray, edges: Edges) -> np.ndarray:
    return _bridged(p, q, known, edges, np.ones(len(edges.i)))


def _torn(p: np.ndarray, q: np.ndarray, known: np.ndarray, edges: Edges) -> np.ndarray:
    """Reweighted least squares (Geman–McClure) on the differences of depth between known slopes.

    The scale beyond which a difference counts as torn begins at the largest residual and shrinks (graduated
    non-convexity): least squares smears a jump over its surroundings, and a small scale would freeze it there.
    """
    firm = known[edges.i] & known[edges.j]
    asked = rise(p, q, known, edges)
    weight = np.where(firm, 1.0, DEPTH.gap_weight)
    scale = np.inf
    for _ in range(MOST_ROUNDS):
        z = _membrane(asked, weight, edges, len(p))
        off = np.abs(z[edges.j] - z[edges.i] - asked)[firm]
        if not len(off):
            break
        least = max(DEPTH.tear_width * mad_scale(off), DEPTH.least_tear_px)
        scale = max(least, min(DEPTH.tear_shrink * scale, float(off.max())))
        weight[firm] = np.maximum(1 / (1 + (off / scale) ** 2) ** 2, 1e-6)
        if scale <= least:
            break
    return _bridged(p, q, known, edges, weight)


def _harris(p: np.ndarray, q: np.ndarray, known: np.ndarray, edges: Edges, *, gap_weight: float = 1.0) -> np.ndarray:
    """Harris 1987 with p and q unknown at every gap pixel, all equations at once, factorised: the reference."""
    firm = known[edges.i] & known[edges.j]
    count = len(p)
    return _plate(p, q, known, edges, np.where(firm, 1.0, gap_weight), np.zeros(count), np.arange(count), firm)


def _bridged(p: np.ndarray, q: np.ndarray, known: np.ndarray, edges: Edges, weight: np.ndarray) -> np.ndarray:
    """Known slopes first, gaps after.

    Harris' energy where everything that touches a gap counts infinitely less than known slopes do, so that a poor
    bridge never bends what is known. Then each piece of known slopes is rigid, all but its height, and the unknowns of
    the second system are those heights and depth and slopes of the gaps' pixels.
    """
    firm = known[edges.i] & known[edges.j]
    flat = np.where(firm, weight, 0.0)
    z = _membrane(rise(p, q, known, edges), flat, edges, len(p))
    if firm.all():
        return z
    # A piece torn off but for next to nothing is a piece still: it hangs on what little weight is left.
    piece = _components(edges, len(p), firm)
    return _plate(p, q, known, edges, np.ones(len(edges.i)), np.where(known, z, 0.0), piece, np.zeros_like(firm))


def _membrane(asked: np.ndarray, weight: np.ndarray, edges: Edges, count: int) -> np.ndarray:
    """z (P,) with least Σ weight (z_j − z_i − asked)², a Poisson equation; pieces that no weight ties have one zero."""
    piece = _components(edges, count, weight > 0)
    degree = np.bincount(edges.i, weight, count) + np.bincount(edges.j, weight, count)
    A = sparse.coo_array((-weight, (edges.i, edges.j)), (count, count)).tocsr()
    A = A + A.T + sparse.diags_array(degree + _first_of_each(piece))
    flow = weight * asked
    right = np.bincount(edges.j, flow, count) - np.bincount(edges.i, flow, count)
    tied = np.flatnonzero(degree)  # the others, as most of a gap's pixels are, stay zero
    z = np.zeros(count)
    z[tied] = _solve(A.tocsr()[tied][:, tied], right[tied])
    return z


def _plate(  # eight parameters: the two models that call it differ in the last four
    p: np.ndarray,
    q: np.ndarray,
    known: np.ndarray,
    edges: Edges,
    weight: np.ndarray,
    z0: np.ndarray,
    piece: np.ndarray,
    counted: np.ndarray,
) -> np.ndarray:
    """z = z0 + h[piece] (P,) with h and the slopes of unknown pixels such that Harris' energy is least.

    Σ weight (z_j − z_i − (s_i + s_j) / 2)² over all edges that are ``counted`` or touch an unknown pixel, plus
    DEPTH.gap_weight Σ weight ((p_j − p_i)² + (q_j − q_i)²) over the latter, where s is p to the right and q upward.
    """
    heights, gaps = int(piece.max()) + 1, int((~known).sum())
    slope = np.full(len(p), -1)
    slope[~known] = np.arange(gaps)
    touch = ~(known[edges.i] & known[edges.j])

    use = np.flatnonzero(touch | counted)
    i, j, up = edges.i[use], edges.j[use], edges.upward[use]
    asked = z0[i] - z0[j]
    rows, columns, values = [np.arange(len(use))] * 2, [piece[j], piece[i]], [np.ones(len(use)), -np.ones(len(use))]
    for end in (i, j):
        unknown = slope[end] >= 0
        rows.append(np.flatnonzero(unknown))
        columns.append((heights + gaps * up + slope[end])[unknown])
        values.append(np.full(int(unknown.sum()), -0.5))
        asked = asked + np.where(unknown, 0.0, np.where(up, q[end], p[end]) / 2)
    equations = [(rows, columns, values, asked, weight[use])]

    i, j = edges.i[touch], edges.j[touch]
    for axis, image in enumerate((p, q)):
        rows, columns, values, asked = [], [], [], np.zeros(len(i))
        for end, sign in ((j, 1.0), (i, -1.0)):
            unknown = slope[end] >= 0
            rows.append(np.flatnonzero(unknown))
            columns.append((heights + gaps * axis + slope[end])[unknown])
            values.append(np.full(int(unknown.sum()), sign))
            asked -= np.where(unknown, 0.0, sign * image[end])
        equations.append((rows, columns, values, asked, DEPTH.gap_weight * weight[touch]))

    size = heights + 2 * gaps
    A, right = sparse.csr_array((size, size)), np.zeros(size)
    for rows, columns, values, asked, w in equations:
        D = sparse.csr_array(
            (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), (len(asked), size)
        )
        A = A + D.T @ (sparse.diags_array(w) @ D)
        right += D.T @ (w * asked)
    # What nothing fixes is set to zero: one height for each piece of the object, and slopes that no known one reaches.
    whole = _components(edges, len(p), np.ones(len(edges.i), bool))
    free = np.full(size, 1e-12)
    free[piece[_first_of_each(whole) > 0]] = 1.0
    return z0 + _factorised(A + sparse.diags_array(free), right)[piece]


def _components(edges: Edges, count: int, joined: np.ndarray) -> np.ndarray:
    """Number (P,) of the connected piece that each pixel is in, by the edges that are ``joined`` (E,)."""
    graph = sparse.coo_array((np.ones(int(joined.sum()), np.int8), (edges.i[joined], edges.j[joined])), (count, count))
    return np.asarray(csgraph.connected_components(graph, directed=False)[1])


def _first_of_each(piece: np.ndarray) -> np.ndarray:
    """1.0 at one pixel of each piece and 0 elsewhere, (P,)."""
    first = np.zeros(len(piece))
    first[np.unique(piece, return_index=True)[1]] = 1.0
    return first


def _solve(A: sparse.csr_array, right: np.ndarray) -> np.ndarray:
    """x of A x = right, A a weighted Laplacian: by factorisation, or by multigrid and conjugate gradients if large."""
    if A.shape[0] <= DIRECT_UP_TO:
        return _factorised(A, right)
    from pyamg import ruge_stuben_solver

    indices, indptr = A.indices.astype(np.int32), A.indptr.astype(np.int32)
    # A preconditioner need not be precise, and single precision moves half as much memory.
    hierarchy = ruge_stuben_solver(
        sparse.csr_matrix((A.data.astype(np.float32), indices, indptr), A.shape),
        max_coarse=500,
        presmoother=("gauss_seidel", {"sweep": "forward"}),
        postsmoother=("gauss_seidel", {"sweep": "backward"}),
    )

    def cycle(residual: np.ndarray) -> np.ndarray:
        scale = float(np.abs(residual).max()) or 1.0
        x = hierarchy.solve((residual / scale).astype(np.float32), maxiter=1, tol=1e-12)
        return np.asarray(x, np.float64) * scale

    preconditioner = LinearOperator(A.shape, cycle, dtype=np.float64)
    x, failed = cg(A, right, rtol=TOLERANCE, atol=0.0, maxiter=500, M=preconditioner)
    return np.asarray(_factorised(A, right) if failed else x)


def _factorised(A: sparse.sparray, right: np.ndarray) -> np.ndarray:
    order = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
    panels = {"relax": 1, "panel_size": 2}  # rows as short as these gain nothing from wide ones: a tenth off or more
    return np.asarray(splu(A.tocsc(), **order, **panels).solve(right))
