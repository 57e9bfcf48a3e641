"""Integrability: pointwise |p_y − q_x| (report 2.3), and its weak form, from which the rotation is estimated.

The slopes p and q of a surface without discontinuities satisfy ∫ (p φ_y − q φ_x) = 0 for every smooth test function φ
that vanishes outside the known pixels: Green's theorem moves the derivative from the noisy slopes to φ. Here the test
functions are thousands of small bumps φ, and the integrals are called curls. The estimated rotation minimises a robust
sum of squared curls. In perspective p and q are the slopes of the relief (``recover.geometry.rays``).
Frame: camera, x right, y up, z toward the camera, image row 0 at the top.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, TypedDict

import numpy as np
from scipy import ndimage, sparse

from huesphere.recover.geometry.least_squares import Schedule, descend
from huesphere.recover.geometry.rays import facing_camera
from huesphere.recover.geometry.rotations import TWIN, rotation_by
from huesphere.recover.geometry.slopes import centred_differences, slopes_by_rotation
from huesphere.recover.geometry.sphere import fibonacci
from huesphere.recover.robust_scale import mad_scale
from huesphere.recover.rotation.parameters import ROTATION
from huesphere.recover.status import RecoveryFailure

# Noise of normals that is always assumed in comparing the two solutions: sums over pixels are no integrals (radians).
GRAIN_RAD = 1e-4

FLATTEST_N3 = 0.02  # Slopes are n n3 / (n3² + this²): a normal that is edge on has none, rather than an infinite one.

# Starts that are refined; twice as many in perspective, and ten times as many are compared there (starts).
REFINED_STARTS = 4

# Descent within a round.
WEAK_DESCENT = Schedule(first_damping=1e-4, most_steps=12, trials=8, relative_gain=0.0, raise_by=8.0, lower_by=8.0)

WEAK_ROUNDS = 4  # Most rounds of reweighting.
CONVERGED = 2e-3  # Change of the rotation (Frobenius norm) in the last round, below which the fit has converged.
ROUND_TOLERANCE = 1e-5  # Change of the rotation in a round, below which no further round follows.
SCAN_FACING_SHARE = 0.97  # Normals that must face the camera under a direction r3 that is scanned.
DISTINCT_TRACE = 2.93  # Trace of the rotation between two starts, below which they are distinct: some 15 degrees.

POWER = 5  # φ = (1 − |x|²/radius²)^POWER: so smooth that summing over pixels is as good as integrating
SMALLER = 0.7  # factor of the radius from one try to the next where too few bumps fit
# The next four bound the time that the estimate takes.
MOST_BUMPS = 3000  # number of test functions
MOST_SAMPLES = 600_000  # pixels under all bumps, a pixel counted once for each
SCAN_SAMPLES = 50_000  # the same for the bumps that are used to scan rotations and compare starts
SCAN_DIRECTIONS = 400  # directions r3 that are scanned, over the sphere
LEAST_PROMISE = 1e-7  # a descent ends where the normal equations predict a smaller relative gain of the loss than this
LEAST_WIDTH = 1e-14  # least width of the robust loss; the curls of exact data are rounding errors


@dataclass(frozen=True)
class TestFunctions:
    """The gradients of K bumps φ, sampled at the P pixels where slopes are known (in raster order)."""

    phi_x: sparse.csr_array  # (K, P)
    phi_y: sparse.csr_array  # (K, P)
    radius: float  # pixels
    power: sparse.csr_array  # (K, P) φ_x² + φ_y²: variance of a curl for slopes with noise of variance 1
    block: np.ndarray  # (K,) number of the square, of side ROTATION.independent_radii · radius, that the centre is in

    def curl(self, p: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Curls Σ (p φ_y − q φ_x) over the pixels, (K, …), of slopes p and q (P, …): zero for those of a surface."""
        return self.phi_y @ p - self.phi_x @ q

    def subset(self, samples: int) -> tuple["TestFunctions", np.ndarray]:
        """Bumps chosen evenly over the picture, with about ``samples`` pixels under them, and these pixels (P,) bool.

        The matrices of the subset have columns for these pixels only.
        """
        total = self.phi_x.shape[0]
        count = max(ROTATION.fewest_bumps, min(total, samples * total // max(1, self.power.nnz)))
        chosen = np.linspace(0, total - 1, count).round().astype(int)
        covered = np.zeros(self.phi_x.shape[1], bool)
        covered[self.power[chosen].indices] = True
        phi_x, phi_y, power = (matrix[chosen][:, covered] for matrix in (self.phi_x, self.phi_y, self.power))
        return TestFunctions(phi_x, phi_y, self.radius, power, self.block[chosen]), covered


@dataclass(frozen=True)
class WeakRotation:
    """The orthogonal matrix Rᵀ, n = Rᵀ N, that minimises the curls."""

    rotation: np.ndarray  # (3, 3) Rᵀ, orthogonal
    scale: float  # robust standard deviation of the weighted curls
    covariance: np.ndarray  # (3, 3) radians², of a small rotation of the camera frame
    stencil: str  # "continuous" or "centred", whichever of the two samplings of φ gave the smaller scale
    functions: int  # number of test functions φ
    radius: float  # of the support of a test function, pixels
    starts: int  # number of candidates that were refined
    other_hand: float  # least scale among solutions with the other sign of det, over ``scale``; inf if there were none
    converged: bool
    # (3, 3) the rotation of the convex/concave twin; None for parallel rays, where it is TWIN · rotation
    twin: np.ndarray | None
    # Noise of the normals that explains the curls of the twin, over that for the chosen rotation; 1 for parallel rays,
    # where both solutions have the same curls
    twin_ratio: float


@dataclass(frozen=True)
class _RotatedNormals:
    """Rotated normals N = Ĝρ of P pixels and the pixels' rays, with components in the first axis."""

    N: np.ndarray  # (3, P)
    ray: np.ndarray | None  # (2, P)

    def slopes(self, rotation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Slopes p = −n1/n3 and q = −n2/n3, (P,) each, of the normals n = rotation · N; bounded where n3 is nearly 0.

        In perspective n·v takes the place of n3.
        """
        n, n3 = self._toward_camera(rotation)
        inverse = -n3 / (n3**2 + FLATTEST_N3**2)
        return n[0] * inverse, n[1] * inverse

    def facing_share(self, rotation: np.ndarray) -> float:
        """Share of the normals n = rotation · N that face the camera."""
        return float((self._toward_camera(rotation)[1] > 0).mean())

    def _toward_camera(self, rotation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n = rotation · N (3, P), n3 (P,) or n·v in its place)."""
        n = rotation @ self.N
        return n, n[2] if self.ray is None else n[2] - self.ray[0] * n[0] - self.ray[1] * n[1]

    def at(self, chosen: np.ndarray) -> "_RotatedNormals":
        """Those of the pixels ``chosen`` (P,) bool."""
        ray = None if self.ray is None else np.ascontiguousarray(self.ray[:, chosen])
        return _RotatedNormals(np.ascontiguousarray(self.N[:, chosen]), ray)


@dataclass(frozen=True)
class _Refined:
    """A rotation that minimises the robust loss near its start."""

    rotation: np.ndarray  # (3, 3)
    scale: float  # robust standard deviation of the weighted curls
    converged: bool


def curl_image(normals: np.ndarray, inside: np.ndarray, ray: np.ndarray | None = None) -> np.ndarray:
    """|p_y − q_x| (H, W) of the normals (H, W, 3) by centred differences, NaN where the stencil leaves ``inside``.

    The report's Fig. 1(e). ``ray`` (H, W, 2) in perspective, where the slopes are the relief's
    (``recover.geometry.rays``); None for parallel rays.
    """
    n3 = facing_camera(normals, ray)
    inside = inside & (n3 > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = np.where(inside[..., None], -normals[..., :2] / n3[..., None], 0.0)
    D_x, D_y, where = centred_differences(slopes, inside)
    return np.where(where, np.abs(D_y[..., 0] - D_x[..., 1]), np.nan)


def without_specks(inlier: np.ndarray) -> np.ndarray:
    """The pixels (H, W) bool with a majority of ``inlier`` (H, W) around them, after a morphological opening by 3 × 3.

    Thresholds on the residuals of single pixels leave isolated holes all over the inlier set, and no test function
    would fit between them; so the holes are filled here, and isolated inliers are removed.
    """
    return ndimage.binary_opening(
        ndimage.uniform_filter(inlier.astype(np.float64), ROTATION.speck_window_px) > 0.5, np.ones((3, 3))
    )


def test_functions(inside: np.ndarray, *, radius: float, stencil: str) -> TestFunctions:
    """Test functions of one ``radius`` (pixels) with their support within ``inside`` (H, W), on a square grid.

    ``stencil`` "continuous" takes ∇φ at the pixels' centres, which suits the normals of a smooth surface. "centred"
    takes centred differences of φ; then the curls are exactly 0 for normals that were computed by centred differences
    of a depth grid.
    """
    reach = int(np.ceil(radius)) + 1
    row, column = np.mgrid[-reach : reach + 1, -reach : reach + 1]

    def phi(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.maximum(1 - (x * x + y * y) / radius**2, 0.0) ** POWER

    x, y = column, -row
    if stencil == "centred":
        gradient_x = (phi(x + 1, y) - phi(x - 1, y)) / 2
        gradient_y = (phi(x, y + 1) - phi(x, y - 1)) / 2
    else:
        steepness = -2 * POWER / radius**2 * np.maximum(1 - (x * x + y * y) / radius**2, 0.0) ** (POWER - 1)
        gradient_x, gradient_y = steepness * x, steepness * y
    support = (gradient_x != 0) | (gradient_y != 0)
    row, column = row[support], column[support]

    # A disc of this size fits where the nearest pixel outside, or the picture's edge, is farther away.
    clearance = ndimage.distance_transform_edt(np.pad(inside, 1))[1:-1, 1:-1]
    rows, columns = np.nonzero(clearance > np.sqrt((row**2 + column**2).max()))
    most = min(MOST_BUMPS, MOST_SAMPLES // len(row))
    stride = max(1, round(radius / 2), int(np.ceil(np.sqrt(len(rows) / most))))
    on_grid = (rows % stride == 0) & (columns % stride == 0)
    rows, columns = rows[on_grid], columns[on_grid]

    number = np.cumsum(inside.ravel()).reshape(inside.shape) - 1
    pixel = number[rows[:, None] + row, columns[:, None] + column]
    starts = np.arange(len(rows) + 1) * len(row)
    shape = (len(rows), int(inside.sum()))

    def matrix(values: np.ndarray) -> sparse.csr_array:
        return sparse.csr_array((np.tile(values, len(rows)), pixel.ravel(), starts), shape)

    gradient_x, gradient_y = gradient_x[support], gradient_y[support]
    side = ROTATION.independent_radii * radius
    block = np.unique((rows // side) * inside.shape[1] + columns // side, return_inverse=True)[1]
    power = matrix(gradient_x**2 + gradient_y**2)
    return TestFunctions(matrix(gradient_x), matrix(gradient_y), radius, power, block)


# More than sixty lines: scan, comparison and refinement are one sequence; a third is docstring and result.
def weak_rotation(
    N: np.ndarray,
    inside: np.ndarray,
    starts: list[np.ndarray],
    ray: np.ndarray | None = None,
    *,
    search: bool = True,
) -> WeakRotation:
    """The orthogonal matrix Rᵀ (3, 3), det of either sign, that makes n = Rᵀ N integrable over ``inside`` (H, W).

    N (H, W, 3) are unit vectors. Robust least squares on the curls, from ``starts`` (each a Rᵀ, such as the closed
    form's) and, if ``search``, from a scan over r3 with both signs of det; of all solutions the one with the smallest
    robust scale of the curls is taken. Curls have less weight where the surface is steep. The weights have a geometric
    mean of 1, as maximum likelihood with noise of unknown size requires; otherwise rotations that make n3 small, and
    all weights with it, would have a smaller sum. ``ray`` (H, W, 2) in perspective (``recover.geometry.rays``), where
    the curls of the convex/concave twins differ, and the twin is refined too.
    Raises RecoveryFailure: too-scattered.
    """
    normals = _RotatedNormals(
        np.ascontiguousarray(N[inside].T), None if ray is None else np.ascontiguousarray(ray[inside].T)
    )
    functions = {stencil: functions_that_fit(inside, stencil) for stencil in ("continuous", "centred")}

    # Candidates are compared, and the best of them refined, on a subset of the test functions.
    few, covered = functions["continuous"].subset(SCAN_SAMPLES)
    sample = normals.at(covered)

    def scale(rotation: np.ndarray) -> float:
        return mad_scale(_weighted_curls(sample, rotation, few))

    scanned = [(scale(start), start) for start in starts] + (_scan(sample, few) if search else [])
    candidates = [rotation for _, rotation in sorted(scanned, key=lambda pair: pair[0])]
    if ray is not None:  # the scan takes rays for parallel, where twins have equal curls
        with_twins = [
            twin @ rotation for rotation in [*starts, *candidates[: 10 * REFINED_STARTS]] for twin in (np.eye(3), TWIN)
        ]
        candidates = sorted(with_twins, key=scale)
    count = REFINED_STARTS if ray is None else 2 * REFINED_STARTS
    refined = [_refine(sample, start, few) for start in _distinct(candidates, count)]
    refined.sort(key=lambda found: found.scale)
    best = refined[0]
    other_hand = [f.scale for f in refined if np.linalg.det(f.rotation) * np.linalg.det(best.rotation) < 0]

    # The best is refined on all test functions, with both stencils.
    finished = {stencil: _refine(normals, best.rotation, functions[stencil]) for stencil in functions}
    stencil = min(finished, key=lambda name: finished[name].scale)
    found, twin, ratio = finished[stencil], None, 1.0
    if ray is not None:
        other = _refine(normals, TWIN @ found.rotation, functions[stencil])
        noise, noise_of_other = (_noise_explaining(normals, end.rotation, functions[stencil]) for end in (found, other))
        if noise_of_other < noise:
            found, other, noise, noise_of_other = other, found, noise_of_other, noise
        grain = GRAIN_RAD
        twin, ratio = other.rotation, float(np.hypot(noise_of_other, grain) / np.hypot(noise, grain))
    return WeakRotation(
        rotation=found.rotation,
        scale=found.scale,
        covariance=_covariance(normals, found.rotation, functions[stencil]),
        stencil=stencil,
        functions=functions[stencil].phi_x.shape[0],
        radius=functions[stencil].radius,
        starts=len(refined),
        other_hand=min(other_hand) / max(best.scale, 1e-300) if other_hand else float("inf"),
        converged=found.converged,
        twin=twin,
        twin_ratio=ratio,
    )


def functions_that_fit(inside: np.ndarray, stencil: str) -> TestFunctions:
    """Test functions of the largest radius of which ROTATION.fewest_bumps fit into ``inside`` (H, W).

    The first radius grows with the size of the region. Raises RecoveryFailure: too-scattered.
    """
    usual = ROTATION.bump_radius_px
    radius = float(np.clip(ROTATION.bump_radius_share * np.sqrt(inside.sum()), usual, 2 * usual))
    while True:
        functions = test_functions(inside, radius=radius, stencil=stencil)
        if functions.phi_x.shape[0] >= ROTATION.fewest_bumps:
            return functions
        if radius <= usual / 2:
            raise RecoveryFailure(
                "too-scattered", f"discs of {usual / 2:.2g} pixels' radius hardly fit the accepted pixels"
            )
        radius = max(usual / 2, SMALLER * radius)


def _weights(p: np.ndarray, q: np.ndarray, functions: TestFunctions) -> np.ndarray:
    """Weights (K,) of the curls, of geometric mean 1: less where the surface is steep.

    A small error δ of a normal changes its slopes by up to (1 + p² + q²) δ. For noise the best weights are the inverse
    of the standard deviation that this gives a curl; for an error of the model, such as interreflection, equal weights
    are better. These are the geometric mean of the two.
    """
    slope_variance = (1 + p * p + q * q) ** 2
    logarithm = -0.25 * np.log(functions.power @ slope_variance)
    return np.exp(logarithm - logarithm.mean())


def _weighted_curls(normals: _RotatedNormals, rotation: np.ndarray, functions: TestFunctions) -> np.ndarray:
    """Curls (K,) of the slopes of n = rotation · N, times their weights."""
    p, q = normals.slopes(rotation)
    return functions.curl(p, q) * _weights(p, q, functions)


def _noise_explaining(normals: _RotatedNormals, rotation: np.ndarray, functions: TestFunctions) -> float:
    """Standard deviation of independent noise in the components of n that would cause curls as large as those measured.

    The noise is in radians, for it is small. Unlike the scale of the weighted curls, it can be compared between the two
    twins, of which one may be steep where the other is not. A small change δn changes p by −(e1 + p v)·δn / m3 and q by
    −(e2 + q v)·δn / m3. Here e1 and e2 are the camera's x and y axes, m3 = n·v, and v = (−x, −y, 1) points toward the
    camera along the ray (x, y), in units of the focal length: not a unit vector, but (0, 0, 1) for parallel rays.
    """
    p, q = normals.slopes(rotation)
    x, y = (0.0, 0.0) if normals.ray is None else normals.ray
    squared = 1 + x * x + y * y
    inverse_square = (1 - x * p - y * q) ** 2 + p * p + q * q  # 1 / m3²
    pp, qq = 1 - 2 * x * p + p * p * squared, 1 - 2 * y * q + q * q * squared
    pq = p * q * squared - q * x - p * y
    variance = functions.phi_y.power(2) @ (pp * inverse_square) + functions.phi_x.power(2) @ (qq * inverse_square)
    variance -= 2 * (functions.phi_x * functions.phi_y) @ (pq * inverse_square)
    return mad_scale(functions.curl(p, q) / np.sqrt(variance))


def _scan(normals: _RotatedNormals, functions: TestFunctions) -> list[tuple[float, np.ndarray]]:
    """(robust scale of the weighted curls, Rᵀ) for directions r3 over the sphere, each with its best α, Eq. (18).

    With both signs of det, and only for those r3 that turn nearly all normals toward the camera. A rotation by α about
    r3 does not change the steepness of the surface, so the weights are the same for all α. Rays are taken for parallel.
    """
    N, parallel = normals.N, _RotatedNormals(normals.N, None)
    directions = fibonacci(SCAN_DIRECTIONS)
    facing_share = (directions @ N[:, :: max(1, N.shape[1] // 2000)] > 0).mean(axis=1)
    found = []
    for r3 in directions[facing_share >= min(SCAN_FACING_SHARE, facing_share.max())]:
        u1 = np.linalg.svd(r3[None])[2][1]
        frame = np.stack([u1, np.cross(r3, u1), r3])
        U, V = parallel.slopes(frame)
        weights = _weights(U, V, functions)
        both = np.stack([U, V], axis=-1)
        (U_x, V_x), (U_y, V_y) = ((phi @ both).T * weights for phi in (functions.phi_x, functions.phi_y))
        for chirality in (1.0, -1.0):
            # The weak form of Eq. (18): each curl is cos α A + sin α B, so their sum of squares is a quadratic form in
            # (cos α, sin α), which is least at the eigenvector of the smaller eigenvalue.
            AB = np.stack([U_y - chirality * V_x, V_y + chirality * U_x])
            cos, sin = np.linalg.eigh(AB @ AB.T)[1][:, 0]
            scale = mad_scale(cos * AB[0] + sin * AB[1])
            found.append((scale, np.array([[cos, sin, 0], [-chirality * sin, chirality * cos, 0], [0, 0, 1]]) @ frame))
    return found


def _distinct(candidates: list[np.ndarray], count: int) -> list[np.ndarray]:
    """The first of the candidates that differ by more than some 15 degrees, ``count`` / 2 of each sign of det."""
    kept: list[np.ndarray] = []
    for chirality in (1, -1):
        own: list[np.ndarray] = []
        for c in candidates:
            if (
                len(own) < count // 2
                and np.linalg.det(c) * chirality > 0
                and all(np.trace(c @ o.T) < DISTINCT_TRACE for o in own)
            ):
                own.append(c)
        kept += own
    return kept


def _refine(normals: _RotatedNormals, start: np.ndarray, functions: TestFunctions) -> _Refined:
    """Minimise Cauchy's loss Σ log(1 + (w r / width)²) over the rotation; r are the curls and w their weights.

    Of a rotation and its negative, which have equal slopes, the one is returned that turns most normals toward the
    camera. Weights and width are fixed during a descent and updated from its end before the next.
    """
    rotation, converged = start, False
    for _ in range(WEAK_ROUNDS):
        state = _State(rotation, *normals.slopes(rotation))
        weights = _weights(state.p, state.q, functions)
        width = ROTATION.pooled_robust_width * max(mad_scale(functions.curl(state.p, state.q) * weights), LEAST_WIDTH)
        outcome = descend(state, **_cauchy(normals, functions, weights, width), schedule=WEAK_DESCENT)
        turned = float(np.linalg.norm(outcome.state.rotation - rotation))
        rotation, converged = outcome.state.rotation, turned < CONVERGED
        if turned < ROUND_TOLERANCE:
            break
    if normals.facing_share(rotation) < 1 / 2:  # n and −n have the same slopes
        rotation = -rotation
    return _Refined(rotation, mad_scale(_weighted_curls(normals, rotation, functions)), converged)


class _State(NamedTuple):
    """A rotation (3, 3) and the slopes p, q (P,) that it gives."""

    rotation: np.ndarray
    p: np.ndarray
    q: np.ndarray


class _Functions(TypedDict):
    """The three functions of a state that ``recover.geometry.least_squares.descend`` takes."""

    loss: Callable[[_State], float]
    linearise: Callable[[_State], tuple[float, np.ndarray, np.ndarray]]
    step: Callable[[_State, tuple[float, np.ndarray, np.ndarray], float], _State | None]


def _cauchy(normals: _RotatedNormals, functions: TestFunctions, weights: np.ndarray, width: float) -> _Functions:
    """Cauchy's loss, its normal equations and steps of the rotation, for curls times ``weights`` (K,), and a width."""

    def residual(state: _State) -> np.ndarray:
        return functions.curl(state.p, state.q) * weights

    def loss(state: _State) -> float:
        return float(np.log1p((residual(state) / width) ** 2).sum())

    def linearise(state: _State) -> tuple[float, np.ndarray, np.ndarray]:
        r = residual(state)
        robust = 1 / (1 + (r / width) ** 2)
        J = _jacobian(state.p, state.q, normals.ray, functions) * weights[:, None]
        return float(np.log1p((r / width) ** 2).sum()), (J * robust[:, None]).T @ J, J.T @ (robust * r)

    def step(state: _State, equations: tuple[float, np.ndarray, np.ndarray], damping: float) -> _State | None:
        current, H, g = equations
        move = -np.linalg.solve(H + damping * np.diag(np.diag(H)) + 1e-300 * np.eye(3), g)
        if -(g @ move) < LEAST_PROMISE * current * width**2:  # gain of the loss that the equations predict
            return None
        rotation = rotation_by(move) @ state.rotation
        return _State(rotation, *normals.slopes(rotation))

    return {"loss": loss, "linearise": linearise, "step": step}


def _jacobian(p: np.ndarray, q: np.ndarray, ray: np.ndarray | None, functions: TestFunctions) -> np.ndarray:
    """Derivative (K, 3) of the curls by a small rotation of the camera frame, radians; ``ray`` (2, P) or None."""
    change = slopes_by_rotation(np.stack([p, q], axis=-1), None if ray is None else ray.T)
    return functions.curl(change[:, 0], change[:, 1])


def _covariance(normals: _RotatedNormals, rotation: np.ndarray, functions: TestFunctions) -> np.ndarray:
    """Covariance (3, 3) of the rotation, radians², by the sandwich estimate over blocks of test functions.

    It uses the scatter of the curls themselves, because the noise that causes it is unknown. Blocks are taken for
    independent (overlapping test functions are not). Source: P. J. Huber, Proc. 5th Berkeley Symp. 1 (1967) 221–233.
    """
    p, q = normals.slopes(rotation)
    weights = _weights(p, q, functions)
    residual = functions.curl(p, q) * weights
    robust = 1 / (1 + (residual / (ROTATION.pooled_robust_width * max(mad_scale(residual), LEAST_WIDTH))) ** 2)
    J = _jacobian(p, q, normals.ray, functions) * weights[:, None]
    bread = np.linalg.pinv((J * robust[:, None]).T @ J, hermitian=True)
    scores = np.zeros((functions.block.max() + 1, 3))
    np.add.at(scores, functions.block, J * (robust * residual)[:, None])
    return bread @ (scores.T @ scores) @ bread
