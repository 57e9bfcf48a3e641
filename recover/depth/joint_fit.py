"""Depth and F fitted together to the picture by Gauss–Newton: one unknown a pixel for three measured channels.

The colour of a single pixel determines one component of its slope well and the other badly, and normals estimated pixel
by pixel keep that noise. A surface has one depth a pixel where normals have two slopes, so what one pixel determines
badly follows from its neighbours, without any smoothing. The residual of a pixel is e = ρ − F_S n(z_x, z_y), where F_S
is the matrix of the lights that the pixel sees; unknowns are the depths at the corners of pixels and the nine entries
of F. Each step is one banded factorisation (``recover.geometry.depth_grid``) and the Schur complement of F. The fit is
valid only where its residuals are noise: an error of the model, such as interreflection, would be fitted by the shape.

The first descent has Cauchy's loss, which finds the depth from a poor start, and holds F: pixels of a shadow that has
no label keep some influence under that loss, and thousands of them would turn F by degrees. The second has the loss of
Geman and McClure, under which the influence of an outlier falls to nothing, and F is free. Pixels in neighbourhoods of
a large mean residual are then left out: large noise is isolated, shadows are not.

In perspective z is the relief of ``recover.geometry.rays``, and n ∝ (−p, −q, 1 − x p − y q) along the ray (x, y).
"""

from dataclasses import dataclass, replace
from typing import Literal

import numba
import numpy as np
from scipy import ndimage

from huesphere.recover.depth.parameters import DEPTH
from huesphere.recover.geometry.banded import BandedFactor
from huesphere.recover.geometry.depth_grid import DepthGrid
from huesphere.recover.geometry.least_squares import Schedule, descend
from huesphere.recover.geometry.rays import of_relief
from huesphere.recover.geometry.slopes import normals_of_slopes
from huesphere.recover.lights.model import Lights, numbered, without
from huesphere.recover.pixels.uncertain_component import without_uncertain_part
from huesphere.recover.problem import Problem
from huesphere.recover.solution import Solution

START_STEEPEST_N3 = 0.08  # a normal of the start with less n3 is given this n3, so that its slope stays finite

# The first depth is integrated from the given normals. Those of the solution's inliers have weight 1 there, all others
# this one.
START_WEIGHT = 1e-2

# Objects of at least so many pixels are fitted in cells of COARSE × COARSE pixels first; then so many steps with F held
# bring in what the coarse surface does not show.
COARSE_FROM_PIXELS, COARSE, HELD_AGAIN = 16_000, 2, 2

# The last rounds of the fit: in each, neighbourhoods that are not explained are found anew and left out, and at most so
# many Gauss–Newton steps follow.
OUTLIER_ROUNDS = (2, 2, 2)

# Descent of the depths and F, under the loss of Geman and McClure.
FREE_DESCENT = Schedule(
    first_damping=1e-7,
    most_steps=12,
    trials=4,
    relative_gain=3e-4,
    least_damping=1e-7,
    least_raised=3e-5,
    raise_by=30.0,
    lower_by=5.0,
)

# The same from a surface and F that an earlier descent has found.
NEAR_DESCENT, NEAR_ROUNDS = replace(FREE_DESCENT, most_steps=5), (1, 1, 1)

# Descent of the depths with F held, under the Cauchy loss.
HELD_DESCENT = replace(FREE_DESCENT, most_steps=6, relative_gain=1e-3)

Weights = Literal["cauchy", "geman-mcclure"]

# Factor of the weight of pixels in outlying neighbourhoods; and the least weight of any slope, relative to the largest,
# which keeps the equations definite.
NEXT_TO_NOTHING = 1e-9


@dataclass(frozen=True)
class Colours:
    """The P pixels of a fit. Everything here is in units of the noise: picture units over its standard deviation.

    So is the matrix F that the methods take: it is F over the noise.
    """

    rho: np.ndarray  # (P, 3) colours
    lost: np.ndarray  # (P, 3, 3) F − F_S, the part of F that belongs to the lights that a pixel misses
    precision: np.ndarray  # (P, 3, 3) inverse covariance of rho; the unit matrix where noise is the only uncertainty
    ray: np.ndarray  # (P, 2) as in ``recover.geometry.rays``, 0 where rays are parallel

    def weighted(self, weight: np.ndarray) -> "Colours":
        """A copy with each pixel's precision multiplied by its ``weight`` (P,)."""
        return Colours(self.rho, self.lost, self.precision * weight[:, None, None], self.ray)

    def squares(self, slope: np.ndarray, F: np.ndarray) -> np.ndarray:
        """Squared residuals eᵀ precision e (P,) at the slopes (P, 2) and the matrix ``F`` (3, 3), over the noise."""
        residual = self.rho - np.einsum("pij,pj->pi", F - self.lost, normals_of_slopes(slope, self.ray))
        return np.maximum(np.einsum("pi,pij,pj->p", residual, self.precision, residual), 0.0)  # type: ignore[no-any-return]

    def loss(self, slope: np.ndarray, F: np.ndarray, weights: Weights) -> float:
        """The robust loss, summed over the pixels, at the slopes (P, 2) and the matrix ``F`` (3, 3), over the noise."""
        return float(
            _loss(
                self.rho, self.ray, slope, F, self.lost, self.precision, weights == "geman-mcclure", DEPTH.robust_width
            )
        )


@dataclass(frozen=True)
class Joint:
    """The surface and the matrix F that were fitted together."""

    normals: np.ndarray  # (H, W, 3), NaN off the object
    F: np.ndarray  # (3, 3), picture units
    misfit: np.ndarray  # (H, W) √(eᵀ precision e), the residual in standard deviations; NaN off the object
    explained: np.ndarray  # (H, W) bool, pixels whose neighbourhood has residuals no larger than noise causes
    steps: int  # of Gauss–Newton, in all descents together
    loss: float  # of Geman and McClure, summed over all pixels
    noise: float  # standard deviation of a channel, picture units
    cells: DepthGrid  # one cell a pixel
    colours: Colours  # what was fitted
    slope: np.ndarray  # (P, 2) of the cells
    scaled: np.ndarray  # (3, 3) F / noise
    covariance: np.ndarray  # (9, 9) covariance of the entries of ``scaled``, row by row


def fit_jointly(
    problem: Problem,
    solution: Solution,
    normals: np.ndarray,
    missed: np.ndarray,
    lights: Lights,
    *,
    finest: int = 1,
) -> Joint:
    """Refine ``normals`` (H, W, 3) of the object, and F of the ``solution``, against the colours of the ``problem``.

    The first depth is the integral of the given normals, in which those of the solution's inliers have the most weight.
    ``missed`` (H, W): bits of the ``lights`` that a pixel misses; −1 where that is unknown. Such a pixel is treated as
    missing none: if that is wrong, its residual is large and the robust loss gives it little influence. Subtracted
    indirect light is uncertain, so the component of a pixel's colour along the colour of that light has less weight
    (``recover.pixels.uncertain_component``). Of a large object a picture of half the size is fitted first, where a step
    takes a tenth of the time; the descent of the picture itself starts at that surface and F. ``finest``: side of a
    cell of the last fit, pixels; the images of the result have one value a cell. Raises LinAlgError where the equations
    are singular.

    Weights: D. Geman and G. Reynolds, IEEE TPAMI 14(3) (1992) 367–383, after Geman and McClure (1987).
    """
    blocks = [COARSE, finest] if finest < COARSE and problem.mask.sum() >= COARSE_FROM_PIXELS else [finest]
    scaled, information, fit = solution.F / problem.noise, None, None
    for block in blocks:
        cells, colours, start, weight = _cells(problem, solution, normals, missed, lights, block)
        information = Information(len(cells))
        steps = 0 if fit is None else fit.steps
        if fit is not None:
            at = (np.argwhere(cells.where).T + 0.5) * block / COARSE - 0.5
            start, weight, scaled = fit.cells.interpolated(fit.slope, at), np.ones(len(cells)), fit.scaled
        right = (start * weight[:, None])[..., None]
        slope = cells.solve(cells.factor(weight, 0 * weight, weight), right)[..., 0]
        held = HELD_DESCENT if fit is None else replace(HELD_DESCENT, most_steps=HELD_AGAIN)
        slope, scaled, more = _descend(information, cells, colours, slope, scaled, "cauchy", held)
        fit = _fitted(information, cells, colours, slope, scaled, problem.noise, steps + more, near=fit is not None)
    assert fit is not None
    return fit


def _cells(
    problem: Problem, solution: Solution, normals: np.ndarray, missed: np.ndarray, lights: Lights, block: int
) -> tuple[DepthGrid, Colours, np.ndarray, np.ndarray]:
    """Cells of ``block`` × ``block`` pixels, their colours, slopes (P, 2) of ``normals`` and the weights (P,) of these.

    Arguments as for ``fit_jointly``. A cell has the mean of what its pixels have.
    """
    mask, F, noise = problem.mask, solution.F, problem.noise
    numbers = np.where(mask, np.maximum(missed, 0), 0)
    lost = np.zeros((*mask.shape, 9))
    for number in np.unique(numbers[numbers > 0]):
        lost[numbers == number] = (F - without(F, lights.found, numbered(int(number)))).ravel()
    weight = np.where(solution.inlier, 1.0, START_WEIGHT)[..., None]
    images = (problem.rgb / noise, lost / noise, problem.removed / noise, np.nan_to_num(normals) * weight, weight)
    cells = DepthGrid(np.concatenate(images, axis=-1, dtype=np.float64), mask, block, problem.ray)
    rho, lost, g, n, weight = np.split(cells.mean, (3, 12, 15, 18), axis=1)
    precision = np.stack(
        [without_uncertain_part(np.broadcast_to(channel, g.shape), g, 1.0) for channel in np.eye(3)], axis=1
    )
    along = np.zeros((len(cells), 2)) if cells.ray is None else cells.ray
    n = of_relief(n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-12), cells.ray)
    n[:, 2] = np.maximum(n[:, 2], START_STEEPEST_N3)
    colours = Colours(np.ascontiguousarray(rho), lost.reshape(-1, 3, 3), precision, along)
    return cells, colours, -n[:, :2] / n[:, 2:], weight[:, 0]


def fit_again(fit: Joint, slope: np.ndarray) -> Joint:
    """The ``fit`` continued from other slopes (P, 2), such as those that a prior has denoised.

    The loss of Geman and McClure has many local minima. Starting from noisy slopes and the first F, it takes pixels for
    outliers that fit the model, and F stays biased by the others; a start from better slopes avoids that.
    """
    return _fitted(Information(len(slope)), fit.cells, fit.colours, slope, fit.scaled, fit.noise, fit.steps, near=True)


# More than seven parameters: the state of the descent, each part on its own.
def _fitted(
    information: "Information",
    cells: DepthGrid,
    colours: Colours,
    slope: np.ndarray,
    scaled: np.ndarray,
    noise: float,
    steps: int,
    near: bool,
) -> Joint:
    """The fit under the loss of Geman and McClure with F free, starting from slopes (P, 2) that are about right.

    ``scaled`` (3, 3) is the first F over ``noise``; ``steps`` is the number of Gauss–Newton steps made before; ``near``
    says that an earlier descent ended at this start.
    """
    mask, schedule = cells.where, NEAR_DESCENT if near else FREE_DESCENT
    slope, scaled, more = _descend(information, cells, colours, slope, scaled, "geman-mcclure", schedule)
    steps += more
    for count in NEAR_ROUNDS if near else OUTLIER_ROUNDS:
        few = replace(FREE_DESCENT, most_steps=count)
        outlying = _outlying(colours.squares(slope, scaled), mask)
        counted = colours.weighted(np.where(outlying, NEXT_TO_NOTHING, 1.0))
        slope, scaled, more = _descend(information, cells, counted, slope, scaled, "geman-mcclure", few)
        steps += more
    covariance = _covariance(information, cells, counted, slope, scaled)
    out, misfit = np.full((*mask.shape, 3), np.nan), np.full(mask.shape, np.nan)
    out[mask], misfit[mask] = normals_of_slopes(slope, colours.ray), np.sqrt(colours.squares(slope, scaled))
    explained = mask.copy()
    explained[mask] = ~outlying
    loss = colours.loss(slope, scaled, "geman-mcclure")
    return Joint(out, scaled * noise, misfit, explained, steps, loss, noise, cells, colours, slope, scaled, covariance)


def _outlying(squares: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Pixels (P,) bool of the ``mask`` (H, W) with a mean of ``squares`` (P,) over 3 × 3 pixels too large for noise.

    ``squares`` are squared residuals in units of the noise's variance.
    """
    image = np.zeros(mask.shape)
    image[mask] = np.minimum(squares, DEPTH.largest_square)
    mean = ndimage.uniform_filter(image, 3)[mask] / ndimage.uniform_filter(mask.astype(float), 3)[mask]
    return mean > DEPTH.neighbourhood_cut * max(float(np.median(squares)), 1.0)  # type: ignore[no-any-return]


def _covariance(
    information: "Information", cells: DepthGrid, colours: Colours, slope: np.ndarray, F: np.ndarray
) -> np.ndarray:
    """Covariance (9, 9) of the entries of F, row by row, with the depths unknown too. ``F`` (3, 3) is over the noise.

    It is A⁻¹ + A⁻¹ B A⁻¹. A is the Schur complement of F in the normal equations of slopes and F: what is known of F
    when the slopes are unknown too, so that A⁻¹ is the covariance that noise alone causes. The score of a pixel is half
    the gradient of its loss by F (9,), with the sign of a step downhill, less the part that a change of the slopes
    takes up; at the minimum the scores have the sum 0. B is the sum over blocks of pixels of s sᵀ, s the sum of the
    scores of a block. The expectation of B is A where residuals are independent noise, and larger where they are
    spatially correlated (P. J. Huber, Proc. 5th Berkeley Symp. 1 (1967) 221–233). The two terms are added rather than
    the first left out, because B is uncertain where there are few blocks.
    """
    _, by_F, schur = information.moves(cells, FREE_DESCENT.first_damping)
    inverse = np.linalg.pinv(schur, rcond=1e-12, hermitian=True)
    n = normals_of_slopes(slope, colours.ray)
    e = np.einsum("pij,pj->pi", colours.precision, colours.rho - np.einsum("pij,pj->pi", F - colours.lost, n))
    weight = (1 + colours.squares(slope, F) / DEPTH.robust_width**2) ** -2
    score = (weight[:, None, None] * e[:, :, None] * n[:, None, :]).reshape(-1, 9)
    score -= np.einsum("pdk,pd->pk", by_F, information.g)
    row, column = np.nonzero(cells.where)
    side = DEPTH.score_block_px
    block = (row // side) * (cells.where.shape[1] // side + 1) + column // side
    sums = np.stack([np.bincount(block, one) for one in score.T], axis=-1)
    return inverse @ (schur + sums.T @ sums) @ inverse  # type: ignore[no-any-return]


def _descend(
    information: "Information",
    cells: DepthGrid,
    colours: Colours,
    slope: np.ndarray,
    F: np.ndarray,
    weights: Weights,
    schedule: Schedule,
) -> tuple[np.ndarray, np.ndarray, int]:
    """(slopes (P, 2), F (3, 3), number of steps) at the end of a descent from ``slope`` and ``F`` by the ``schedule``.

    Afterwards ``information`` holds the normal equations at that end.
    """

    def linearise(state: tuple[np.ndarray, np.ndarray]) -> Information:
        information.at(colours, *state, weights)
        return information

    def step(
        state: tuple[np.ndarray, np.ndarray], equations: Information, damping: float
    ) -> tuple[np.ndarray, np.ndarray]:
        return equations.step(cells, *state, damping, held=weights == "cauchy")

    outcome = descend(
        (slope, F),
        loss=lambda state: colours.loss(*state, weights),
        linearise=linearise,
        step=step,
        schedule=schedule,
    )
    linearise(outcome.state)
    return *outcome.state, outcome.steps


class Information:
    """Gauss–Newton normal equations of P slopes and F at one state; the arrays are overwritten at each new state."""

    def __init__(self, count: int) -> None:
        self.W, self.g = np.empty((count, 3)), np.empty((count, 2))  # matrix (xx xy yy) and right side of each slope
        self.cross = np.empty((count, 2, 9))  # block of the matrix between slopes and F, row by row
        self.H, self.h = np.empty((9, 9)), np.empty(9)  # matrix and right side of F

    def at(self, colours: Colours, slope: np.ndarray, F: np.ndarray, weights: Weights) -> float:
        """Write the equations at ``slope`` (P, 2) and ``F`` (3, 3) into the arrays; returns the loss."""
        c, bounded = colours, weights == "geman-mcclure"
        fields = self.W, self.g, self.cross, self.H, self.h
        return float(_linearise(c.rho, c.ray, slope, F, c.lost, c.precision, bounded, DEPTH.robust_width, *fields))

    def definite_weights(self) -> np.ndarray:
        """W (P, 3) plus a small multiple of the unit matrix, definite also where no pixel determines a slope."""
        least = NEXT_TO_NOTHING * float(self.W.max())
        return self.W + np.array([least, 0.0, least])

    def _factor(self, cells: DepthGrid, damping: float) -> BandedFactor:
        return cells.factor(*self.definite_weights().T, damping=damping)

    def moves(self, cells: DepthGrid, damping: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Step of the slopes with F held (P, 2), its derivative by F (P, 2, 9), Schur complement of F (9, 9)."""
        factors = self._factor(cells, damping)
        moves = cells.solve(factors, np.concatenate([self.g[..., None], self.cross], axis=-1))
        by_slope, by_F = moves[..., 0], moves[..., 1:]
        return by_slope, by_F, self.H - np.einsum("pdk,pdl->kl", self.cross, by_F)

    def step(
        self, cells: DepthGrid, slope: np.ndarray, F: np.ndarray, damping: float, *, held: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """(slopes (P, 2), F (3, 3)) after one Gauss–Newton step, of the slopes alone if F is ``held``."""
        if held:
            return slope + cells.solve(self._factor(cells, damping), self.g[..., None])[..., 0], F
        by_slope, by_F, schur = self.moves(cells, damping)
        right = self.h - np.einsum("pdk,pd->k", self.cross, by_slope)
        change = np.linalg.lstsq(schur + 1e-9 * np.trace(self.H) / 9 * np.eye(9), right, rcond=1e-12)[0]
        return slope + by_slope - by_F @ change, F + change.reshape(3, 3)


# More than seven parameters: compiled code takes the arrays of ``Colours`` one by one.
@numba.njit(cache=True, fastmath={"contract", "nsz"})  # type: ignore[untyped-decorator]
def _loss(
    rho: np.ndarray,
    ray: np.ndarray,
    slope: np.ndarray,
    F: np.ndarray,
    lost: np.ndarray,
    V: np.ndarray,
    bounded: bool,
    robust_width: float,
) -> float:
    """Sum over the pixels of the loss of Geman and McClure, if ``bounded``, or else of Cauchy; V is the precision."""
    total, width, r = 0.0, robust_width * robust_width, np.empty(3)
    for i in range(len(rho)):
        p, q = slope[i]
        s = 1 - ray[i, 0] * p - ray[i, 1] * q
        z = 1 / np.sqrt(s * s + p * p + q * q)
        square = 0.0
        for c in range(3):
            M0, M1, M2 = F[c, 0] - lost[i, c, 0], F[c, 1] - lost[i, c, 1], F[c, 2] - lost[i, c, 2]
            r[c] = rho[i, c] - (-M0 * p - M1 * q + M2 * s) * z
        for c in range(3):
            square += r[c] * (V[i, c, 0] * r[0] + V[i, c, 1] * r[1] + V[i, c, 2] * r[2])
        total += square / (1 + square / width) if bounded else width * np.log1p(square / width)
    return total


# More than seven parameters and more than sixty lines: compiled code takes the arrays of ``Colours`` and
# ``Information`` one by one, and its innermost loops are written out.
@numba.njit(cache=True, fastmath={"contract", "nsz"})  # type: ignore[untyped-decorator]
def _linearise(
    rho: np.ndarray,
    ray: np.ndarray,
    slope: np.ndarray,
    F: np.ndarray,
    lost: np.ndarray,
    V: np.ndarray,
    bounded: bool,
    robust_width: float,
    W: np.ndarray,
    g: np.ndarray,
    cross: np.ndarray,
    H: np.ndarray,
    h: np.ndarray,
) -> float:
    """The loss, as ``_loss`` returns it; writes the normal equations into ``W``, ``g``, ``cross``, ``H`` and ``h``.

    These are the arrays of ``Information``. V (P, 3, 3) is the inverse covariance of the colours, ``precision``. In the
    loop e is the residual of pixel i, ``by_p`` and ``by_q`` the derivatives of its predicted colour by its slopes, n
    its normal, and w its weight in the robust loss.
    """
    H[:], h[:] = 0.0, 0.0
    total, width = 0.0, robust_width * robust_width
    e, by_p, by_q, n = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for i in range(len(rho)):
        p, q = slope[i]
        x, y = ray[i]
        s = 1 - x * p - y * q
        z = 1 / np.sqrt(s * s + p * p + q * q)
        n[0], n[1], n[2] = -p * z, -q * z, s * z
        square = 0.0
        for c in range(3):
            M0, M1, M2 = F[c, 0] - lost[i, c, 0], F[c, 1] - lost[i, c, 1], F[c, 2] - lost[i, c, 2]
            shade = M0 * n[0] + M1 * n[1] + M2 * n[2]
            e[c] = rho[i, c] - shade
            by_p[c] = -(M0 + x * M2 + shade * (p - x * s) * z) * z
            by_q[c] = -(M1 + y * M2 + shade * (q - y * s) * z) * z
        for c in range(3):
            square += e[c] * (V[i, c, 0] * e[0] + V[i, c, 1] * e[1] + V[i, c, 2] * e[2])
        w = 1 / (1 + square / width)
        total += square * w if bounded else width * np.log1p(square / width)
        w = w * w if bounded else w
        W[i], g[i] = 0.0, 0.0
        for c in range(3):
            # Channel c of V ∂/∂p, V ∂/∂q and V e: each channel counts as far as its colour is certain.
            sure_p = V[i, c, 0] * by_p[0] + V[i, c, 1] * by_p[1] + V[i, c, 2] * by_p[2]
            sure_q = V[i, c, 0] * by_q[0] + V[i, c, 1] * by_q[1] + V[i, c, 2] * by_q[2]
            sure_e = V[i, c, 0] * e[0] + V[i, c, 1] * e[1] + V[i, c, 2] * e[2]
            W[i, 0] += w * by_p[c] * sure_p
            W[i, 1] += w * by_p[c] * sure_q
            W[i, 2] += w * by_q[c] * sure_q
            g[i, 0] += w * by_p[c] * sure_e
            g[i, 1] += w * by_q[c] * sure_e
            for j in range(3):
                row = 3 * c + j  # of the entry F[c, j]
                h[row] += w * n[j] * sure_e
                cross[i, 0, row], cross[i, 1, row] = w * n[j] * sure_p, w * n[j] * sure_q
                for d in range(3):
                    for k in range(3):
                        H[row, 3 * d + k] += w * n[j] * n[k] * V[i, c, d]
    return total
