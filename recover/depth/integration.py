"""Integration of slopes that are known at some pixels only (report 2.4): Poisson, and Harris' coupled depth and slope.

Where slopes are known, the depth is their least-squares integral. Gaps, the pixels of the object without a known slope,
get a surface whose slopes are unknowns too and change as little as possible from pixel to pixel: J. G. Harris, "A new
approach to surface reconstruction: the coupled depth/slope model", ICCV 1987 (the report's [24]). Differences are taken
only between pixels of the object, so nothing is prescribed along its outline: the natural boundary conditions of Y. Li,
UBC TR-91-24 (1991), the report's [27].

Inside, an image over the mask is a vector (P,) of the object's P pixels in raster order (`geometry.neighbours`).
Frame: camera, x right, y up, z toward the camera, in pixels; image row 0 at the top.
"""

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, cg, splu

from huesphere.recover.depth.large import Slopes, refined, slopes_of_blocks, with_mean_zero
from huesphere.recover.depth.parameters import DEPTH
from huesphere.recover.geometry.neighbours import Edges, components, edges_within, laplacian
from huesphere.recover.geometry.reduction import reduction_of
from huesphere.recover.robust_scale import mad_scale

TEAR_SHRINK = 0.85  # Factor of the scale of residuals from one round of the robust model to the next.

MOST_AT_ONCE = 300_000  # pixels of an object whose depth is solved for in one system; larger ones: ``depth.large``
MODELS = ("coupled", "poisson", "robust", "harris")
DIRECT_UP_TO = 30_000  # unknowns: below, a factorisation is quicker than a multigrid hierarchy, and exact
# Relative residual at which conjugate gradients stop. At 1024² pixels that is an error of depth of 5e-5 pixels; slopes
# rounded to 8 bits cause 0.02 pixels.
TOLERANCE = 1e-5
MOST_ROUNDS = 40  # of reweighting in "robust": its scale reaches its lower limit long before


def depth_from_normals(
    normals: np.ndarray, valid: np.ndarray, mask: np.ndarray, *, model: str = "coupled"
) -> np.ndarray:
    """Depth (H, W) in pixels toward the camera, NaN off ``mask`` (H, W), from normals (H, W, 3) known where ``valid``.

    ``model``: "coupled" (least squares over known slopes, then Harris' surface over the gaps), "poisson" (one Poisson
    equation that prefers, with a small weight, equal depths in gaps), "robust" (as coupled, but depth may jump where
    the slopes contradict each other: occlusions), "harris" (the published coupled model, all equations in one system:
    the slow reference). The depth has mean 0 over each connected component of the mask, because slopes do not
    determine the offset between components. Normals with n3 below ``DEPTH.steepest_n3`` count as unknown.
    Raises ValueError for an unknown model or shapes that do not agree. Source: report 2.4.
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
    """Depth (H, W) as ``depth_from_normals`` gives it, from the slopes p = ∂z/∂x and q = ∂z/∂y (H, W).

    ``known`` (H, W) bool: where p and q are valid; elsewhere they are ignored. Of objects of over MOST_AT_ONCE pixels
    the depth of blocks of pixels is solved for first (``recover.depth.large``).
    """
    by = reduction_of(mask, MOST_AT_ONCE) if model == "coupled" else None
    if by is not None:
        slopes = Slopes(
            np.where(known, p, 0.0).astype(np.float32), np.where(known, q, 0.0).astype(np.float32), known & mask, mask
        )
        small = slopes_of_blocks(slopes, by)
        return with_mean_zero(refined(slopes, depth_from_slopes(small.p, small.q, small.known, small.mask), by), mask)
    edges = edges_within(mask)
    p, q, inside = (image[mask] for image in (np.where(known, p, 0.0), np.where(known, q, 0.0), known & mask))
    solve = {"coupled": _coupled, "poisson": _poisson, "robust": _robust, "harris": _harris}[model]
    z = solve(p, q, inside, edges)
    component = components(edges, len(z), np.ones(len(edges.i), bool))
    z -= (np.bincount(component, z) / np.bincount(component))[component]
    depth = np.full(mask.shape, np.nan)
    depth[mask] = z
    return depth


def rise(p: np.ndarray, q: np.ndarray, known: np.ndarray, edges: Edges) -> np.ndarray:
    """Difference of depth z_j − z_i (E,), pixels, that the slopes (P,) predict for each edge.

    It is the mean of the slopes at i and j, the one that is ``known`` (P,) if only one is, and 0 if neither is.
    """
    at_i = np.where(edges.upward, q[edges.i], p[edges.i])
    at_j = np.where(edges.upward, q[edges.j], p[edges.j])
    ends = known[edges.i].astype(float) + known[edges.j]
    return (at_i * known[edges.i] + at_j * known[edges.j]) / np.maximum(ends, 1)


# ---- the models: each returns z (P,), pixels, from p, q and known (P,) -----------------------------------------------


def _poisson(p: np.ndarray, q: np.ndarray, known: np.ndarray, edges: Edges) -> np.ndarray:
    """Minimise Σ w (z_j − z_i − rise)², with w = 1 between two known slopes and DEPTH.gap_weight elsewhere."""
    weight = np.where(known[edges.i] & known[edges.j], 1.0, DEPTH.gap_weight)
    return _poisson_solution(rise(p, q, known, edges), weight, edges, len(p))


def _coupled(p: np.ndarray, q: np.ndarray, known: np.ndarray, edges: Edges) -> np.ndarray:
    return _known_slopes_then_gaps(p, q, known, edges, np.ones(len(edges.i)))


def _robust(p: np.ndarray, q: np.ndarray, known: np.ndarray, edges: Edges) -> np.ndarray:
    """Reweighted least squares with the loss of Geman and McClure on the differences of depth between known slopes.

    The scale of the loss, beyond which a residual is taken for a jump of depth, starts at the largest residual and
    shrinks from round to round (graduated non-convexity). The first solution, plain least squares, spreads each jump
    over its surroundings; a loss that starts with a small scale would keep that solution.
    """
    both_known = known[edges.i] & known[edges.j]
    predicted = rise(p, q, known, edges)
    weight = np.where(both_known, 1.0, DEPTH.gap_weight)
    scale = np.inf
    for _ in range(MOST_ROUNDS):
        z = _poisson_solution(predicted, weight, edges, len(p))
        residual = np.abs(z[edges.j] - z[edges.i] - predicted)[both_known]
        if not len(residual):
            break
        least_scale = max(DEPTH.tear_width * mad_scale(residual), DEPTH.least_tear_px)
        scale = max(least_scale, min(TEAR_SHRINK * scale, float(residual.max())))
        weight[both_known] = np.maximum(1 / (1 + (residual / scale) ** 2) ** 2, 1e-6)
        if scale <= least_scale:
            break
    return _known_slopes_then_gaps(p, q, known, edges, weight)


def _harris(p: np.ndarray, q: np.ndarray, known: np.ndarray, edges: Edges, *, gap_weight: float = 1.0) -> np.ndarray:
    """Harris 1987: depth unknown at every pixel and slopes at every gap pixel, one factorised system. The reference."""
    both_known = known[edges.i] & known[edges.j]
    count = len(p)
    weight = np.where(both_known, 1.0, gap_weight)
    return _coupled_solution(p, q, known, edges, weight, np.zeros(count), np.arange(count), both_known)


def _known_slopes_then_gaps(
    p: np.ndarray, q: np.ndarray, known: np.ndarray, edges: Edges, weight: np.ndarray
) -> np.ndarray:
    """z (P,) in two steps: integrate the known slopes with ``weight`` (E,) on the edges, then fill the gaps.

    This is the limit of Harris' energy when the weight of all terms that touch a gap goes to 0, so that a poor fill
    never bends the part that is known. In the second step each connected component of known slopes keeps its shape and
    has one unknown, its height; the other unknowns are depth and slopes of the gaps' pixels.
    """
    both_known = known[edges.i] & known[edges.j]
    z = _poisson_solution(rise(p, q, known, edges), np.where(both_known, weight, 0.0), edges, len(p))
    if both_known.all():
        return z
    # Components are those of all edges between known slopes, whatever the weight of these: across a jump of depth the
    # weight is small but positive, and the first step has determined the height of both sides.
    component = components(edges, len(p), both_known)
    start = np.where(known, z, 0.0)
    return _coupled_solution(p, q, known, edges, np.ones(len(edges.i)), start, component, np.zeros_like(both_known))


def _poisson_solution(predicted: np.ndarray, weight: np.ndarray, edges: Edges, count: int) -> np.ndarray:
    """z (P,) that minimises Σ weight (z_j − z_i − predicted)² over the edges, a Poisson equation.

    The sum fixes z up to a constant for each component that edges of positive weight connect: there z = 0 at its first
    pixel.
    """
    component = components(edges, count, weight > 0)
    degree = np.bincount(edges.i, weight, count) + np.bincount(edges.j, weight, count)
    A = laplacian(edges, weight, degree + _first_of_each(component))
    flow = weight * predicted
    right = np.bincount(edges.j, flow, count) - np.bincount(edges.i, flow, count)
    connected = np.flatnonzero(degree)  # pixels without such an edge, as most of a gap's are, stay 0
    z = np.zeros(count)
    z[connected] = _solve(A[connected][:, connected], right[connected])
    return z


# More than seven parameters, because the two models that call this differ in the last four; more than sixty lines for
# two kinds of equations that share their unknowns.
def _coupled_solution(
    p: np.ndarray,
    q: np.ndarray,
    known: np.ndarray,
    edges: Edges,
    weight: np.ndarray,
    z0: np.ndarray,
    group: np.ndarray,
    counted: np.ndarray,
) -> np.ndarray:
    """z = z0 + h[group] (P,), where the heights h and the slopes of gap pixels minimise Harris' energy.

    The energy is Σ weight (z_j − z_i − (s_i + s_j) / 2)² over the edges that are ``counted`` (E,) or have an end in a
    gap, plus DEPTH.gap_weight Σ weight ((p_j − p_i)² + (q_j − q_i)²) over the edges with an end in a gap; s is p for an
    edge to the right and q for one upward. ``z0`` (P,) is a first depth in pixels, and all pixels of one ``group``
    (P,), an integer from 0, move up or down together. ``weight`` (E,).

    The unknowns are ordered: heights of the groups, p of the gap pixels, q of the gap pixels.
    """
    heights, gaps = int(group.max()) + 1, int((~known).sum())
    gap_number = np.full(len(p), -1)  # number of each pixel among the gaps; −1 where its slopes are known
    gap_number[~known] = np.arange(gaps)
    at_gap = ~(known[edges.i] & known[edges.j])

    # Equations z_j − z_i = (s_i + s_j) / 2: rows and columns of the coefficients, their values, the right side, weights
    used = np.flatnonzero(at_gap | counted)
    i, j, up = edges.i[used], edges.j[used], edges.upward[used]
    target = z0[i] - z0[j]
    rows, columns = [np.arange(len(used))] * 2, [group[j], group[i]]
    values = [np.ones(len(used)), -np.ones(len(used))]
    for end in (i, j):
        unknown = gap_number[end] >= 0
        rows.append(np.flatnonzero(unknown))
        columns.append((heights + gaps * up + gap_number[end])[unknown])
        values.append(np.full(int(unknown.sum()), -0.5))
        target = target + np.where(unknown, 0.0, np.where(up, q[end], p[end]) / 2)
    equations = [(rows, columns, values, target, weight[used])]

    # Equations p_j − p_i = 0 and q_j − q_i = 0
    i, j = edges.i[at_gap], edges.j[at_gap]
    for axis, image in enumerate((p, q)):
        rows, columns, values, target = [], [], [], np.zeros(len(i))
        for end, sign in ((j, 1.0), (i, -1.0)):
            unknown = gap_number[end] >= 0
            rows.append(np.flatnonzero(unknown))
            columns.append((heights + gaps * axis + gap_number[end])[unknown])
            values.append(np.full(int(unknown.sum()), sign))
            target -= np.where(unknown, 0.0, sign * image[end])
        equations.append((rows, columns, values, target, DEPTH.gap_weight * weight[at_gap]))

    size = heights + 2 * gaps
    A, right = sparse.csr_array((size, size)), np.zeros(size)
    for rows, columns, values, target, w in equations:
        D = sparse.csr_array(
            (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), (len(target), size)
        )
        A = A + D.T @ (sparse.diags_array(w) @ D)
        right += D.T @ (w * target)
    # The energy leaves free one height for each component of the object, and the slopes of components without a known
    # slope: small terms on the diagonal set these to 0.
    component = components(edges, len(p), np.ones(len(edges.i), bool))
    diagonal = np.full(size, 1e-12)
    diagonal[group[_first_of_each(component) > 0]] = 1.0
    return z0 + _factorised(A + sparse.diags_array(diagonal), right)[group]


def _first_of_each(component: np.ndarray) -> np.ndarray:
    """1.0 at the first pixel of each component, numbers (P,), and 0 elsewhere: (P,)."""
    first = np.zeros(len(component))
    first[np.unique(component, return_index=True)[1]] = 1.0
    return first


def _solve(A: sparse.csr_array, right: np.ndarray) -> np.ndarray:
    """Solution x (P,) of A x = right for a weighted Laplacian A: factorisation, or conjugate gradients with multigrid.

    The second where there are more than DIRECT_UP_TO unknowns.
    """
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
    """Solution x of A x = right for a symmetric positive definite A, by sparse LU factorisation."""
    order = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
    panels = {"relax": 1, "panel_size": 2}  # narrow panels, which save a tenth of the time with rows as short as these
    return np.asarray(splu(A.tocsc(), **order, **panels).solve(right))
