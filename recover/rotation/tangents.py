"""The rotation by maximum likelihood: the one for which some depth map has tangents orthogonal to all the normals.

The normal n = Rᵀ N of the surface z is orthogonal to both of its tangents: (1, 0, z_x)·n = (0, 1, z_y)·n = 0. These two
residuals are linear in N = Ĝρ, so their covariance follows exactly from that of the colours' noise, and the sum of
their squares in units of that noise is a likelihood without a free scale. A rotation that makes n3 small does not make
this sum small, and its mean is 1 where noise is the only error. For a given rotation the best z is the solution of one
banded linear system (``recover.geometry.depth_grid``); Gauss–Newton over the rotation updates z with each step. No
window has to fit between the accepted pixels and all spatial frequencies contribute, so the rotation is determined far
better than from the curl under test functions (``recover.rotation.weak_form``). In perspective z is the relief of
``recover.geometry.rays``, and its normal m takes the place of n.

The steps are not those of ``recover.geometry.least_squares``: the weights, their scale and the slopes at which the
tangents are taken change with every step, so there is no fixed loss by which a step could be accepted or rejected.
Instead, a step that turns back from the direction of the one before is halved.

Frame: camera, x right, y up, z toward the camera, image row 0 at the top.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from huesphere.recover.cues.silhouette import SilhouetteRotation
from huesphere.recover.geometry.depth_grid import DepthGrid
from huesphere.recover.geometry.quadratic import MONOMIALS, design
from huesphere.recover.geometry.rays import facing_camera, of_relief
from huesphere.recover.geometry.rotations import TWIN, rotation_by, turn_between
from huesphere.recover.geometry.slopes import slopes_by_rotation
from huesphere.recover.geometry.threads import in_threads
from huesphere.recover.rotation.parameters import ROTATION
from huesphere.recover.status import RecoveryFailure

START_FLATTEST_N3 = 0.05  # The slopes of the start are n n3 / (n3² + this²), finite for normals that are edge on.

# Steps on coarse cells end with one that turned by less; the last one must, to have converged (radians).
COARSE_TOLERANCE_RAD = 2e-2

LEAST_FREEDOM = 30  # With fewer residuals in excess of unknowns, the pixels are too scattered (degrees of freedom).

# Most cells of the grid on which the best rotation is refined; starts are compared on a fifth of them (cells).
FINE_CELLS = 5000

# A step after one that it turns back from is halved, down to this share; the factor restores it (share of a step,
# factor).
STEP_SHARES = (0.1, 1.5)

LEAST_PROMISING = 3  # At least so many starts are refined further (starts).

# Most steps of every start, of the promising ones in all, and of the best on fine cells.
REFINEMENT_STEPS = (4, 10, 20)

# Median squared residual of a cell whose only error is noise, in units of the variance. χ² with two degrees of freedom
# has the median 2 ln 2; the fitted depth takes up one of the two, which leaves half of that.
MEDIAN_OF_NOISE = 0.69
SYMMETRIC = np.array(
    [
        np.outer(a, b) + (np.outer(b, a) if k > 2 else 0)
        for k, (a, b) in enumerate((np.eye(3)[i], np.eye(3)[j]) for i, j in MONOMIALS)
    ]
)  # (6, 3, 3) a basis of the symmetric matrices, in the order of z (``recover.geometry.quadratic.MONOMIALS``)


@dataclass(frozen=True)
class TangentRotation:
    """The orthogonal matrix Rᵀ with n = Rᵀ N, det of either sign, its covariance, and the evidence for it."""

    rotation: np.ndarray  # (3, 3) Rᵀ
    stretch: np.ndarray  # (3, 3) symmetric, near 𝟙: n ∝ rotation · stretch · N, a correction of the ellipsoid
    covariance: np.ndarray  # (3, 3) radians², of a small rotation of the camera frame, with the stretch unknown too
    misfit: float  # weighted mean square of the residuals in units of the noise; 1 where noise is the only error
    freedom: int  # degrees of freedom: residuals less unknowns
    runner_up: float  # (L' / L − 1) · freedom, L the loss of the chosen solution and L' of the best distinct other one
    robust_loss: float  # robust loss on coarse cells over freedom: 0.2–0.4 for noise, more if spatially correlated
    starts: int  # number of rotations that were refined
    converged: bool
    # rotation and stretch of the convex/concave twin; None for parallel rays, where it is TWIN · rotation
    twin: tuple[np.ndarray, np.ndarray] | None
    twin_ratio: float  # square root of the twin's loss over the chosen one's; 1 for parallel rays, where they are equal


@dataclass(frozen=True)
class _Refined:
    """The state of a descent: as in ``TangentRotation``, and the residuals of the P cells."""

    rotation: np.ndarray
    stretch: np.ndarray
    squared: np.ndarray  # (P,) squared residual of each cell in units of its noise
    pooled: np.ndarray  # (P,) square of the mean residual of each cell's neighbourhood, in units of that mean's noise
    backward: float  # share of the cells whose normal faces away from the camera
    covariance: np.ndarray
    misfit: float
    freedom: int
    turned: float  # angle of the last step, radians


def tangent_rotation(
    N: np.ndarray,
    inside: np.ndarray,
    noise: np.ndarray,
    starts: list[np.ndarray],
    ray: np.ndarray | None = None,
    silhouette: SilhouetteRotation | None = None,
) -> TangentRotation:
    """The rotation (report Eqs. 11 and 12) that makes N = Ĝρ (H, W, 3) over ``inside`` (H, W) normals of a surface.

    ``noise`` (3, 3) is the covariance of a pixel's N. ``starts`` are orthogonal matrices Rᵀ (3, 3). All are refined on
    a grid of coarse cells and compared there; the best is refined on fine cells. For parallel rays its twin
    diag(−1, −1, 1) Rᵀ has the same residuals. The last refinement also estimates a stretch of N, a correction of the
    ellipsoid. The condition |N| = 1 at all pixels is an observation of it, with a standard error larger by the factor
    ``ROTATION.ellipsoid_overconfidence`` than noise alone would give. ``ray`` (H, W, 2) in perspective
    (``recover.geometry.rays``), where the twin is refined too, and the better of the two is taken. ``silhouette``: an
    estimate of the rotation from the silhouette, used as one more observation.
    Raises RecoveryFailure: too-scattered; no-convergence where the equations of every start are singular.
    """
    known = _stretch_information(N[inside], noise) / ROTATION.ellipsoid_overconfidence**2
    coarse, fine = (
        DepthGrid(N, inside, max(1, int(np.ceil(np.sqrt(inside.sum() / most)))), ray)
        for most in (FINE_CELLS // 5, FINE_CELLS)
    )
    if coarse.freedom < LEAST_FREEDOM:
        raise RecoveryFailure("too-scattered", f"{len(coarse)} blocks of accepted pixels, too few side by side")
    ends = _coarse_solutions(coarse, starts, noise, silhouette)
    if not ends:
        raise RecoveryFailure("no-convergence", "no rotation makes the colours those of a surface")
    losses = _losses(ends, silhouette)
    best = ends[int(np.argmin(losses))]
    others = [
        loss for loss, end in zip(losses, ends) if turn_between(end.rotation, best.rotation) > ROTATION.distinct_rad
    ]
    last, twin, ratio = _refined(fine, best, noise, known, silhouette), None, 1.0
    if ray is not None:
        twin = _refined(fine, replace(best, rotation=TWIN @ last.rotation), noise, known, silhouette)
        loss, loss_of_twin = _losses([last, twin])  # comparable: both have converged on the same fine cells
        if loss_of_twin < loss:
            last, twin, loss, loss_of_twin = twin, last, loss_of_twin, loss
        ratio = float(np.sqrt(loss_of_twin / max(loss, 1e-300)))
    return TangentRotation(
        rotation=last.rotation,
        stretch=last.stretch,
        covariance=last.covariance,
        misfit=last.misfit,
        freedom=last.freedom,
        runner_up=(min(others) / max(min(losses), 1e-300) - 1) * best.freedom if others else float("inf"),
        robust_loss=_losses([best])[0] / best.freedom,
        starts=len(starts),
        converged=last.turned < COARSE_TOLERANCE_RAD,
        twin=None if twin is None else (twin.rotation, twin.stretch),
        twin_ratio=ratio,
    )


def _refined(
    cells: DepthGrid, end: _Refined, noise: np.ndarray, known: np.ndarray, silhouette: SilhouetteRotation | None
) -> _Refined:
    """``end``, found on coarse cells, refined on ``cells`` with the stretch unknown too.

    ``known`` (6, 6) is the inverse covariance of the stretch. Where the equations are singular ``end`` is returned.
    """
    descent = _Descent(cells, end.rotation, noise, known, silhouette)
    try:
        descent.steps(REFINEMENT_STEPS[2], ROTATION.step_tolerance_rad)
    except np.linalg.LinAlgError:
        return end
    return descent.end()


def without_edge(inside: np.ndarray) -> np.ndarray:
    """``inside`` (H, W) without its border pixels, where most outliers lie; all of it if half would be lost."""
    inner = ndimage.binary_erosion(inside, np.ones((3, 3)))
    return inner if inner.sum() > 0.5 * inside.sum() else inside


def _losses(ends: list["_Refined"], silhouette: SilhouetteRotation | None = None) -> list[float]:
    """Robust loss of each of the ``ends``: log(1 + …) of the residuals of cells and of neighbourhoods, summed.

    All use the same scales, those of the end with the smallest median residual. With the silhouette's loss, if given.
    """
    own, pooled = _scales(min(float(np.median(end.squared)) for end in ends))
    return [
        float(
            np.log1p(
                end.squared / (ROTATION.cell_robust_width**2 * own)
                + 2 * end.pooled / (ROTATION.pooled_robust_width**2 * pooled)
            ).sum()
        )
        + (0.0 if silhouette is None else 2 * ROTATION.silhouette_weight * silhouette.loss(end.rotation))
        for end in ends
    ]


def _scales(typical: float) -> tuple[float, float]:
    """Scales of a cell's squared residual and of its neighbourhood's, in units of the variance of the noise.

    ``typical`` is the median squared residual of the cells. It exceeds that of noise where the surface is curved
    within cells, which are fitted by planes; the scale of a cell's residual includes that error. The residual of a
    neighbourhood shows cells that miss a light, so its scale is that of the noise. Only where the error of the planes
    far exceeds the noise, as in pictures without noise, its scale grows too; nearly all cells would be outliers
    otherwise.
    """
    own = max(1.0, typical / MEDIAN_OF_NOISE)
    return own, max(1.0, own / ROTATION.typical_misfit)


def _coarse_solutions(
    cells: DepthGrid, starts: list[np.ndarray], noise: np.ndarray, silhouette: SilhouetteRotation | None = None
) -> list[_Refined]:
    """The solutions reached from the ``starts`` on coarse cells.

    All starts make a few steps; only those whose loss is then promising are continued. Solutions with normals that face
    away from the camera are left out if there are others. In perspective the twins of the starts are used too.
    """
    first_steps, most_steps, _ = REFINEMENT_STEPS
    twins = [] if cells.ray is None else [TWIN @ start for start in starts]
    begun = _after(first_steps, [_Descent(cells, start, noise, None, silhouette) for start in [*starts, *twins]])
    if not begun:
        return []
    losses = _losses([end for _, end in begun], silhouette)
    limit = max(ROTATION.promising_loss * min(losses), sorted(losses)[:LEAST_PROMISING][-1])
    promising = [descent for (descent, _), loss in zip(begun, losses) if loss <= limit]
    found = [end for _, end in _after(most_steps - first_steps, promising)]
    found += [end for (_, end), loss in zip(begun, losses) if loss > limit]
    return [end for end in found if end.backward <= ROTATION.most_backward_share] or found


def _after(steps: int, descents: list["_Descent"]) -> list[tuple["_Descent", "_Refined"]]:
    """Each descent after ``steps`` more steps, and its state; descents with singular equations are left out."""

    def one(descent: _Descent) -> tuple[_Descent, _Refined] | None:
        try:
            descent.steps(steps, COARSE_TOLERANCE_RAD)
        except np.linalg.LinAlgError:
            return None
        return descent, descent.end()

    return [end for end in in_threads(one, descents) if end is not None]


def _stretch_information(N: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Inverse covariance (6, 6) of s in a stretch 𝟙 + Σ s_k SYMMETRIC_k, as the condition |stretch · N| = 1 gives it.

    N (P, 3) are the rotated normals of the inliers and ``noise`` (3, 3) is the covariance of each.
    """
    n = N / np.linalg.norm(N, axis=1, keepdims=True)
    M = design(n)
    return (M / np.einsum("pi,ij,pj->p", n, noise, n)[:, None]).T @ M


class _Descent:
    """Gauss–Newton over the rotation and all depths, from a first ``rotation`` Rᵀ (3, 3).

    The stretch is estimated too if ``known`` (6, 6), its inverse covariance about 𝟙, is given. ``noise`` (3, 3) is the
    covariance of a pixel's N. ``silhouette`` is one more observation of the rotation. Steps raise LinAlgError if their
    equations are singular.

    Pixels that miss a light and yet lie on the ellipsoid are noticed only by spatially correlated residuals. So the
    weight of a cell depends on the mean residual of its neighbourhood as well as on its own.

    Tangents, weights and derivatives are taken at smoothed slopes, so that residuals are linear in the noise of each
    pixel. At the noisy slopes themselves they would be correlated with the noise, which biases the rotation by degrees.
    """

    def __init__(
        self,
        cells: DepthGrid,
        rotation: np.ndarray,
        noise: np.ndarray,
        known: np.ndarray | None = None,
        silhouette: SilhouetteRotation | None = None,
    ) -> None:
        self.cells, self.rotation, self.noise, self.known, self.silhouette = cells, rotation, noise, known, silhouette
        spread = np.sqrt(np.trace(noise) * 2 / 3 / cells.count.mean())  # noise of a cell's normal, radians
        least = ROTATION.slope_blur_px
        # A Gaussian of standard deviation s, in cells, divides independent noise by 2 √π s.
        wanted = spread * cells.block / (2 * np.sqrt(np.pi) * ROTATION.blurred_normal_noise_rad)
        self.blur = float(np.clip(wanted, least, 4 * least))  # standard deviation of the smoothing, pixels
        m = of_relief(cells.smoothed(cells.mean, self.blur) @ rotation.T, cells.ray)
        # (P, 2) slopes −m1/m3, −m2/m3 of the depths; the constant keeps them finite where m3 is near 0.
        self.slope = -m[:, :2] * (m[:, 2:] / (m[:, 2:] ** 2 + START_FLATTEST_N3**2))
        self.weight, self.misfit = np.ones(len(cells)), 1.0  # (P,) robust weights; as in ``TangentRotation``
        self.s = np.zeros(6 if known is not None else 0)  # the six numbers of the stretch
        # Residuals (P, 2) of the last step, their inverse covariance, and its normal equations
        self.residual, self.W, self.H = np.empty((0, 2)), np.empty((0, 2, 2)), np.empty((0, 0))
        self.taken, self.turned = 0, np.inf  # number of steps; angle of the last one before it was shortened, radians
        self.step_share, self.last_turn = 1.0, np.zeros(3)  # share of each step that is taken; rotation vector

    def steps(self, count: int, tolerance: float) -> None:
        """Make at most ``count`` steps; stop after one that turns by less than ``tolerance`` radians."""
        for _ in range(count):
            if self.taken > 1 and self.turned < tolerance:
                break
            self._step()

    def _step(self) -> None:
        """One Gauss–Newton step of rotation, stretch and depths, at weights that follow from the last residuals."""
        cells, known, freedom = self.cells, self.known, max(1, self.cells.freedom)
        stretch = np.eye(3) + np.einsum("k,kij->ij", self.s, SYMMETRIC[: len(self.s)])
        M = self.rotation @ stretch
        m = of_relief(cells.mean @ M.T, cells.ray)
        slope = np.clip(cells.smoothed(self.slope, self.blur), -ROTATION.steepest_slope, ROTATION.steepest_slope)
        self.W = _precision(slope, _relief_covariance(M @ self.noise @ M.T, cells.ray), cells.count)
        if self.taken > 0:
            squared, pooled = _squares(cells, self.residual, self.W)
            own, of_pooled = _scales(float(np.median(squared)))
            weight = 1 / (
                squared / (ROTATION.cell_robust_width**2 * own)
                + (1 + pooled / (ROTATION.pooled_robust_width**2 * of_pooled)) ** 2
            )
            self.weight = weight / np.quantile(weight, ROTATION.full_weight_quantile)
            self.misfit = _misfit(self.weight, squared, freedom)
        V = self.W * self.weight[:, None, None]
        e = m[:, :2] + slope * m[:, 2:]
        m3 = _relief_n3(slope, cells.ray)
        # Column 0: the residual at zero slope of the depths; then its derivatives by rotation (3) and stretch (6). The
        # depths are eliminated: each column is completed by the depth map that makes it least.
        columns = [(e - m3[:, None] * slope)[..., None], -slopes_by_rotation(slope, cells.ray) * m3[:, None, None]]
        columns += [_stretching(slope, m3, self.rotation, M, cells.ray)] if known is not None else []
        terms = np.concatenate(columns, axis=-1)
        gradient = cells.least_squares_slopes(V, m3, -terms)
        residual = terms + m3[:, None, None] * gradient
        flat = residual.reshape(-1, residual.shape[2])
        H = flat.T @ (V @ residual).reshape(flat.shape) / max(1.0, self.misfit)
        if known is not None:
            H[4:, 4:] += known
            H[4:, 0] += known @ self.s
        if self.silhouette is not None:
            away, information = self.silhouette.pull(self.rotation)
            H[1:4, 1:4] += ROTATION.silhouette_weight * information
            H[1:4, 0] -= ROTATION.silhouette_weight * information @ away
        self.residual, self.H = residual[:, :, 0], H
        move = -np.linalg.lstsq(H[1:, 1:], H[1:, 0])[0]
        self.turned = float(np.linalg.norm(move[:3]))
        # Weights and slopes change with each step, so that the next step may undo it: such a step is halved.
        least, grow = STEP_SHARES
        back = move[:3] @ self.last_turn < 0
        self.step_share = max(least, self.step_share / 2) if back else min(1.0, grow * self.step_share)
        self.last_turn = move[:3]
        move = move * min(self.step_share, ROTATION.distinct_rad / max(self.turned, 1e-300))
        self.slope = gradient[..., 0] + gradient[..., 1:] @ move
        self.rotation = rotation_by(move[:3]) @ self.rotation
        self.s = self.s + move[3:]
        self.taken += 1

    def end(self) -> _Refined:
        """The state after the last step."""
        cells, freedom = self.cells, max(1, self.cells.freedom)
        squared, pooled = _squares(cells, self.residual, self.W)
        covariance = np.linalg.pinv(self.H[1:, 1:], hermitian=True)
        if self.known is not None:
            freedom = max(1, round(freedom - 6 + float(np.trace(self.known @ covariance[3:, 3:]))))
        toward_camera = facing_camera(cells.smoothed(cells.mean, self.blur) @ self.rotation.T, cells.ray)
        return _Refined(
            rotation=self.rotation,
            stretch=np.eye(3) + np.einsum("k,kij->ij", self.s, SYMMETRIC[: len(self.s)]),
            squared=squared,
            pooled=pooled,
            backward=float((toward_camera < 0).mean()),
            covariance=covariance[:3, :3],
            misfit=_misfit(self.weight, squared, freedom),
            freedom=freedom,
            turned=self.turned,
        )


def _misfit(weight: np.ndarray, squared: np.ndarray, freedom: int) -> float:
    """Weighted mean square of the residuals in units of the noise."""
    return float(weight @ squared) / (freedom * max(float(weight.mean()), 1e-9))


def _relief_n3(slope: np.ndarray, ray: np.ndarray | None) -> np.ndarray:
    """m3 (P,) of the relief's normal m at ``slope`` (P, 2), if the surface's normal n is a unit vector."""
    p, q = slope.T
    s = 1.0 if ray is None else 1 - (ray * slope).sum(axis=1)
    return 1 / np.sqrt(s * s + p * p + q * q)  # type: ignore[no-any-return]


def _relief_covariance(covariance: np.ndarray, ray: np.ndarray | None) -> np.ndarray:
    """Covariance (P, 3, 3) of the relief's normals m from that of n (3, 3); for parallel rays that of n itself."""
    if ray is None:
        return covariance
    return of_relief(of_relief(covariance, ray[:, None, :]).swapaxes(1, 2), ray[:, None, :])


def _stretching(
    slope: np.ndarray, m3: np.ndarray, rotation: np.ndarray, M: np.ndarray, ray: np.ndarray | None
) -> np.ndarray:
    """Derivatives (P, 2, 6) of (1, 0, p)·m and (0, 1, q)·m by the stretch's six numbers, in the order of SYMMETRIC.

    m is the normal of the relief with the ``slope`` (P, 2); ``m3`` (P,) is its third component. ``M`` (3, 3) is
    rotation · stretch. ``ray`` (P, 2), or None for parallel rays.
    """
    n = np.column_stack([-slope * m3[:, None], m3])  # m; for parallel rays that is the surface's normal n
    if ray is not None:
        n[:, 2] += (ray * n[:, :2]).sum(axis=1)  # n3 = m3 + ray · (n1, n2)
    change = np.tensordot(n @ np.linalg.inv(M).T, rotation @ SYMMETRIC, axes=(1, 2))
    change = of_relief(change, None if ray is None else ray[:, None, :])
    return np.stack([change[..., i] + slope[:, i, None] * change[..., 2] for i in range(2)], axis=1)


def _squares(cells: DepthGrid, residual: np.ndarray, W: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Squared residuals (P,) of the cells, and of the means over their neighbourhoods (P,), in units of the noise.

    ``residual`` (P, 2) has the inverse covariance ``W`` (P, 2, 2).
    """
    x, y = residual.T
    a = np.sqrt(W[:, 0, 0])  # Cholesky: W = LLᵀ, and Lᵀ residual is white
    b = W[:, 0, 1] / a
    white = np.stack([a * x + b * y, np.sqrt(np.maximum(W[:, 1, 1] - b * b, 0.0)) * y], axis=-1)
    mean = cells.smoothed(white, ROTATION.neighbourhood_cells * cells.block)
    return (white**2).sum(axis=1), (mean**2).sum(axis=1) * 4 * np.pi * ROTATION.neighbourhood_cells**2


def _precision(slope: np.ndarray, noise: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Inverse covariance (P, 2, 2) of the residuals (1, 0, p)·m and (0, 1, q)·m at ``slope`` (P, 2).

    m is the mean over the ``count`` (P,) pixels of a cell; ``noise`` (3, 3) or (P, 3, 3) is the covariance of one
    pixel's m.
    """
    p, q = slope.T
    n11, n12, n13, n22, n23, n33 = (noise[..., i, j] for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)))
    xx = n11 + p * (2 * n13 + p * n33)
    yy = n22 + q * (2 * n23 + q * n33)
    xy = n12 + p * n23 + q * n13 + p * q * n33
    return np.stack([yy, -xy, -xy, xx], axis=-1).reshape(-1, 2, 2) * (count / (xx * yy - xy * xy))[:, None, None]  # type: ignore[no-any-return]
