"""The rotation of greatest likelihood: the one for which some depth map's tangents lie best across all the normals.

A normal n = R N of the surface z is across both of its tangents, (1, 0, z_x)·n = (0, 1, z_y)·n = 0. In N = Ĝρ this is
linear, so the noise of colours is carried to it exactly, and the sum of squares over that noise is a likelihood with no
free scale: no rotation gains by looking at the surface edge on, and a misfit of 1 says that nothing is wrong. For every
rotation the best z is one linear system with a narrow band; Gauss–Newton over the rotation moves z along. No window has
to fit between the accepted pixels and every length of wave counts for what it knows, so that the rotation is known far
better than from integrability in bumps (``recover.rotation.weak_form``). In perspective z is the relief of
``recover.geometry.rays``, and its normal m takes the place of n. Frame: camera, image row 0 at the top.
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
from huesphere.recover.status import RecoveryFailure

MOST_CELLS, FEW_CELLS = 5000, 1000  # blocks of pixels, for the last refinement and for the choice among starts
FEWEST_FREE = 30  # residuals less unknowns
STEPS, FEW_STEPS, TRIED_STEPS = 20, 10, 4
HOPEFUL, LEAST_HOPEFUL = 1.3, 3  # times the least loss, after the first steps, of starts that go on, and how many do
SETTLED, BARELY_SETTLED = 1e-3, 2e-2  # radians a step turns
LARGEST_STEP = 0.25  # radians
LEAST_PACE, PICKED_UP = 0.1, 1.5  # share of a step that is taken at least, and its growth while steps go one way
STEEPEST = 15.0  # slope that a tangent is taken at
SMOOTH, SMOOTHEST, CALM = 1.0, 4.0, 0.035  # pixels; and the noise of a normal, radians, that is let through to tangents
CAUCHY = 3.0  # standard deviations, beyond which a residual counts ever less
SHARED, REACH = 2.5, 2.5  # standard deviations of the residual's mean over neighbours, and cells that it reaches over
FAR_BEYOND = 10.0  # times the noise's square in the typical cell, beyond which what neighbours share is no stranger's
OUTLINE, OUTLINE_LOSS = 1.5, 3.0  # how much more the outline counts than by its own account; the same in the loss
CHANCE = 0.69  # median of the squared residuals of noise: of two freedoms a cell one went to z
MOST_BACKWARD = 0.05  # share of normals that may face away in a start worth keeping
RIVAL = 0.25  # radians between rotations that are not one
BELIEVED = 6.0  # times less than by noise alone the ellipsoid is known: strangers among its pixels, on dev scenes
SYMMETRIC = np.array(
    [
        np.outer(a, b) + (np.outer(b, a) if k > 2 else 0)
        for k, (a, b) in enumerate((np.eye(3)[i], np.eye(3)[j]) for i, j in MONOMIALS)
    ]
)  # (6, 3, 3) the symmetric matrices' basis, in the order of z


@dataclass(frozen=True)
class TangentRotation:
    """The rotation (or rotation and reflection) Rᵀ, n = Rᵀ N, and how well it is known."""

    rotation: np.ndarray  # (3, 3)
    stretch: np.ndarray  # (3, 3) symmetric, near 𝟙: n ∝ rotation · stretch · N, what the surface says of the ellipsoid
    covariance: np.ndarray  # (3, 3) radians², of a small rotation of the camera frame, the stretch being in doubt
    misfit: float  # mean square of the residuals over that of the noise: 1 where nothing is wrong
    freedom: int  # residuals less unknowns
    rival: float  # loss of the best start that ended elsewhere over that of the chosen, less 1, times freedom
    strain: float  # robust loss over freedom, on few blocks: 0.2–0.4 of noise, more where neighbours misfit together
    starts: int  # rotations that were refined
    converged: bool
    twin: tuple[np.ndarray, np.ndarray] | None  # rotation, stretch of the convex/concave twin; None: parallel rays
    twin_ratio: float  # root of its loss over the chosen one's: 1 where rays are parallel, and both are as good


@dataclass(frozen=True)
class _Refined:
    rotation: np.ndarray
    stretch: np.ndarray
    squared: np.ndarray  # (P,) squared residual of each cell in units of its noise
    shared: np.ndarray  # (P,) the same of what neighbours have in common
    backward: float  # share of the cells whose normal faces away
    covariance: np.ndarray
    misfit: float
    freedom: int
    turned: float  # radians, of the last step


def tangent_rotation(
    N: np.ndarray,
    inside: np.ndarray,
    noise: np.ndarray,
    starts: list[np.ndarray],
    ray: np.ndarray | None = None,
    outlined: SilhouetteRotation | None = None,
) -> TangentRotation:
    """The rotation for which N (H, W, 3) = Ĝρ over ``inside`` (H, W) is the normals of a surface.

    ``noise`` (3, 3) is the covariance of a pixel's N, ``starts`` are rotations or reflections to begin from. All are
    refined on few blocks of pixels and compared there, the best is refined on many. Its twin diag(−1, −1, 1) R is as
    good. The last refinement turns and stretches: that all N are of length 1 tells the stretch, BELIEVED times less
    surely than noise would have it. ``ray`` (H, W, 2): of a picture in perspective (``recover.geometry.rays``), where
    the twin is refined too, and may be the better one. ``outlined``: what the outline tells of the rotation; it counts
    besides, and in the covariance. Raises RecoveryFailure: too-scattered, no-convergence where no start led anywhere.
    """
    known = _stretch_information(N[inside], noise) / BELIEVED**2
    few, many = (
        DepthGrid(N, inside, max(1, int(np.ceil(np.sqrt(inside.sum() / n)))), ray) for n in (FEW_CELLS, MOST_CELLS)
    )
    if few.freedom < FEWEST_FREE:
        raise RecoveryFailure("too-scattered", f"{len(few)} blocks of accepted pixels, too few side by side")
    ends = _ends(few, starts, noise, outlined)
    if not ends:
        raise RecoveryFailure("no-convergence", "no rotation makes the colours those of a surface")
    losses = _losses(ends, outlined)
    best = ends[int(np.argmin(losses))]
    others = [loss for loss, end in zip(losses, ends) if turn_between(end.rotation, best.rotation) > RIVAL]
    last, twin, ratio = _finished(many, best, noise, known, outlined), None, 1.0
    if ray is not None:
        twin = _finished(many, replace(best, rotation=TWIN @ last.rotation), noise, known, outlined)
        own, turned = _losses([last, twin])  # of blocks as small as these, and settled: a start is not compared
        last, twin = (twin, last) if turned < own else (last, twin)
        ratio = float(np.sqrt(max(own, turned) / max(min(own, turned), 1e-300)))
    return TangentRotation(
        rotation=last.rotation,
        stretch=last.stretch,
        covariance=last.covariance,
        misfit=last.misfit,
        freedom=last.freedom,
        rival=(min(others) / max(min(losses), 1e-300) - 1) * best.freedom if others else float("inf"),
        strain=_losses([best])[0] / best.freedom,
        starts=len(starts),
        converged=last.turned < BARELY_SETTLED,
        twin=None if twin is None else (twin.rotation, twin.stretch),
        twin_ratio=ratio,
    )


def _finished(
    cells: DepthGrid, end: _Refined, noise: np.ndarray, known: np.ndarray, outlined: SilhouetteRotation | None
) -> _Refined:
    """What was found on few blocks, refined on ``cells``, stretch and all; as it is where that breaks down."""
    descent = _Descent(cells, end.rotation, noise, known, outlined)
    try:
        descent.steps(STEPS, SETTLED)
    except np.linalg.LinAlgError:
        return end
    return descent.end()


def without_edge(inside: np.ndarray) -> np.ndarray:
    """``inside`` (H, W) less its edge, where what a cut has accepted holds strangers, unless that is half of it."""
    inner = ndimage.binary_erosion(inside, np.ones((3, 3)))
    return inner if inner.sum() > 0.5 * inside.sum() else inside


def _losses(ends: list["_Refined"], outlined: SilhouetteRotation | None = None) -> list[float]:
    """Robust sums of squares, in units of the noise or of what the best leaves if that is more."""
    own, shared = _scales(min(float(np.median(end.squared)) for end in ends))
    return [
        float(np.log1p(end.squared / (CAUCHY**2 * own) + 2 * end.shared / (SHARED**2 * shared)).sum())
        + (0.0 if outlined is None else OUTLINE_LOSS * outlined.loss(end.rotation))
        for end in ends
    ]


def _scales(typical: float) -> tuple[float, float]:
    """What squared residuals count against, a cell's own and its neighbours' mean, in units of the noise.

    From the median of the former: more than noise in the typical cell is the error of taking blocks for planes. What
    neighbours share shows up cells that miss a light, and is held against noise, until that error far exceeds it, as
    without noise: no step would lead anywhere then.
    """
    own = max(1.0, typical / CHANCE)
    return own, max(1.0, own / FAR_BEYOND)


def _ends(
    cells: DepthGrid, starts: list[np.ndarray], noise: np.ndarray, outlined: SilhouetteRotation | None = None
) -> list[_Refined]:
    """Where the starts lead to, of those that begin well; only such whose normals face the camera, if there are any.

    In perspective their twins are starts as well.
    """
    twins = [] if cells.ray is None else [TWIN @ start for start in starts]
    begun = _after(TRIED_STEPS, [_Descent(cells, start, noise, None, outlined) for start in [*starts, *twins]])
    if not begun:
        return []
    losses = _losses([end for _, end in begun], outlined)
    limit = max(HOPEFUL * min(losses), sorted(losses)[:LEAST_HOPEFUL][-1])
    hopeful = [descent for (descent, _), loss in zip(begun, losses) if loss <= limit]
    found = [end for _, end in _after(FEW_STEPS - TRIED_STEPS, hopeful)]
    found += [end for (_, end), loss in zip(begun, losses) if loss > limit]
    return [end for end in found if end.backward <= MOST_BACKWARD] or found


def _after(steps: int, descents: list["_Descent"]) -> list[tuple["_Descent", "_Refined"]]:
    """The descents that ``steps`` more of them did not break down, and where each stands."""

    def one(descent: _Descent) -> tuple[_Descent, _Refined] | None:
        try:
            descent.steps(steps, BARELY_SETTLED)
        except np.linalg.LinAlgError:
            return None
        return descent, descent.end()

    return [end for end in in_threads(one, descents) if end is not None]


def _stretch_information(N: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Inverse covariance (6, 6) of a stretch 𝟙 + Σ s_k SYMMETRIC_k, from lengths of N (P, 3), noise (3, 3) in each."""
    n = N / np.linalg.norm(N, axis=1, keepdims=True)
    M = design(n)
    return (M / np.einsum("pi,ij,pj->p", n, noise, n)[:, None]).T @ M


class _Descent:
    """Gauss–Newton over the rotation and all depths, from a rotation (3, 3). Steps raise LinAlgError at a breakdown.

    Over the stretch too, if it is ``known`` (6, 6): its inverse covariance about 𝟙.
    Pixels that miss a light and yet lie on the ellipsoid betray themselves only here: neighbours misfit together. So a
    cell counts by the residual's mean over its neighbours, with noise's own share in it, as well as by its own.
    Tangents, weights and derivatives are taken at smooth slopes, so that what is fitted is linear in the noise of each
    pixel. Were they taken at the noisy slopes themselves the noise would turn the rotation, by degrees.
    """

    def __init__(
        self,
        cells: DepthGrid,
        rotation: np.ndarray,
        noise: np.ndarray,
        known: np.ndarray | None = None,
        outlined: SilhouetteRotation | None = None,
    ) -> None:
        self.cells, self.rotation, self.noise, self.known, self.outlined = cells, rotation, noise, known, outlined
        spread = np.sqrt(np.trace(noise) * 2 / 3 / cells.count.mean())  # of a cell's normal, radians
        self.reach = float(np.clip(spread * cells.block / (2 * np.sqrt(np.pi) * CALM), SMOOTH, SMOOTHEST))
        m = of_relief(cells.smoothed(cells.mean, self.reach) @ rotation.T, cells.ray)
        self.slope = -m[:, :2] * (m[:, 2:] / (m[:, 2:] ** 2 + 0.05**2))
        self.weight, self.turned, self.misfit = np.ones(len(cells)), np.inf, 1.0
        self.s = np.zeros(6 if known is not None else 0)
        self.residual, self.W, self.H = np.empty((0, 2)), np.empty((0, 2, 2)), np.empty((0, 0))
        self.taken, self.pace, self.before = 0, 1.0, np.zeros(3)

    def steps(self, count: int, settled: float) -> None:
        """So many steps, or fewer if one turns by less than ``settled`` radians."""
        for _ in range(count):
            if self.taken > 1 and self.turned < settled:
                break
            self._step()

    def _step(self) -> None:
        cells, known, freedom = self.cells, self.known, max(1, self.cells.freedom)
        stretch = np.eye(3) + np.einsum("k,kij->ij", self.s, SYMMETRIC[: len(self.s)])
        M = self.rotation @ stretch
        m = of_relief(cells.mean @ M.T, cells.ray)
        slope = np.clip(cells.smoothed(self.slope, self.reach), -STEEPEST, STEEPEST)
        self.W = _precision(slope, _twice(M @ self.noise @ M.T, cells.ray), cells.count)
        if self.taken > 0:
            squared, shared = _squares(cells, self.residual, self.W)
            own, common = _scales(float(np.median(squared)))
            weight = 1 / (squared / (CAUCHY**2 * own) + (1 + shared / (SHARED**2 * common)) ** 2)
            self.weight = weight / np.quantile(weight, 0.9)  # an error that all cells share leaves the best believed
            self.misfit = _misfit(self.weight, squared, freedom)
        V = self.W * self.weight[:, None, None]
        e = m[:, :2] + slope * m[:, 2:]
        m3 = _relief_n3(slope, cells.ray)
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
        if self.outlined is not None:
            away, counts = self.outlined.pull(self.rotation)
            H[1:4, 1:4] += OUTLINE * counts
            H[1:4, 0] -= OUTLINE * counts @ away
        self.residual, self.H = residual[:, :, 0], H
        move = -np.linalg.lstsq(H[1:, 1:], H[1:, 0])[0]
        self.turned = float(np.linalg.norm(move[:3]))
        # Weights and slopes that follow each step may send it to and fro: where it turns back it is halved.
        back = move[:3] @ self.before < 0
        self.pace = max(LEAST_PACE, self.pace / 2) if back else min(1.0, PICKED_UP * self.pace)
        self.before = move[:3]
        move = move * min(self.pace, LARGEST_STEP / max(self.turned, 1e-300))
        self.slope = gradient[..., 0] + gradient[..., 1:] @ move
        self.rotation = rotation_by(move[:3]) @ self.rotation
        self.s = self.s + move[3:]
        self.taken += 1

    def end(self) -> _Refined:
        """Where it stands after its last step."""
        cells, freedom = self.cells, max(1, self.cells.freedom)
        squared, shared = _squares(cells, self.residual, self.W)
        covariance = np.linalg.pinv(self.H[1:, 1:], hermitian=True)
        if self.known is not None:
            freedom = max(1, round(freedom - 6 + float(np.trace(self.known @ covariance[3:, 3:]))))
        toward_camera = facing_camera(cells.smoothed(cells.mean, self.reach) @ self.rotation.T, cells.ray)
        return _Refined(
            rotation=self.rotation,
            stretch=np.eye(3) + np.einsum("k,kij->ij", self.s, SYMMETRIC[: len(self.s)]),
            squared=squared,
            shared=shared,
            backward=float((toward_camera < 0).mean()),
            covariance=covariance[:3, :3],
            misfit=_misfit(self.weight, squared, freedom),
            freedom=freedom,
            turned=self.turned,
        )


def _misfit(weight: np.ndarray, squared: np.ndarray, freedom: int) -> float:
    """Mean square of the residuals in units of the noise, by what each counts."""
    return float(weight @ squared) / (freedom * max(float(weight.mean()), 1e-9))


def _relief_n3(slope: np.ndarray, ray: np.ndarray | None) -> np.ndarray:
    """m3 (P,) of the relief's normals whose surface normals n are unit, at ``slope`` (P, 2)."""
    p, q = slope.T
    s = 1.0 if ray is None else 1 - (ray * slope).sum(axis=1)
    return 1 / np.sqrt(s * s + p * p + q * q)  # type: ignore[no-any-return]


def _twice(covariance: np.ndarray, ray: np.ndarray | None) -> np.ndarray:
    """Covariance (P, 3, 3) of m from that of n (3, 3), which it is where rays are parallel."""
    if ray is None:
        return covariance
    return of_relief(of_relief(covariance, ray[:, None, :]).swapaxes(1, 2), ray[:, None, :])


def _stretching(
    slope: np.ndarray, m3: np.ndarray, rotation: np.ndarray, M: np.ndarray, ray: np.ndarray | None
) -> np.ndarray:
    """Change (P, 2, 6) of (1, 0, p)·m and (0, 1, q)·m by the stretch's six numbers, at the smooth normals.

    ``M`` (3, 3) is rotation · stretch.
    """
    n = np.column_stack([-slope * m3[:, None], m3])
    if ray is not None:
        n[:, 2] += (ray * n[:, :2]).sum(axis=1)
    change = np.tensordot(n @ np.linalg.inv(M).T, rotation @ SYMMETRIC, axes=(1, 2))
    change = of_relief(change, None if ray is None else ray[:, None, :])
    return np.stack([change[..., i] + slope[:, i, None] * change[..., 2] for i in range(2)], axis=1)


def _squares(cells: DepthGrid, residual: np.ndarray, W: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(own, of the neighbours' mean) squared residuals (P,) in units of noise, of ``residual`` (P, 2) weighted W."""
    x, y = residual.T
    a = np.sqrt(W[:, 0, 0])  # Cholesky: W = LLᵀ, and Lᵀ residual is white
    b = W[:, 0, 1] / a
    white = np.stack([a * x + b * y, np.sqrt(np.maximum(W[:, 1, 1] - b * b, 0.0)) * y], axis=-1)
    mean = cells.smoothed(white, REACH * cells.block)
    return (white**2).sum(axis=1), (mean**2).sum(axis=1) * 4 * np.pi * REACH**2


def _precision(slope: np.ndarray, noise: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Inverse covariance (P, 2, 2) of (1, 0, p)·m and (0, 1, q)·m at ``slope`` (P, 2), m the mean of ``count`` (P,).

    ``noise`` (3, 3) or (P, 3, 3) is that of one pixel's m.
    """
    p, q = slope.T
    n11, n12, n13, n22, n23, n33 = (noise[..., i, j] for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)))
    xx = n11 + p * (2 * n13 + p * n33)
    yy = n22 + q * (2 * n23 + q * n33)
    xy = n12 + p * n23 + q * n13 + p * q * n33
    return np.stack([yy, -xy, -xy, xx], axis=-1).reshape(-1, 2, 2) * (count / (xx * yy - xy * xy))[:, None, None]  # type: ignore[no-any-return]
