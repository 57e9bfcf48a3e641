"""One depth a pixel explains three measurements: depth and F fitted together to the picture, by Gauss–Newton.

A single pixel knows one slope well and the other badly, and normals taken one by one keep that noise. A surface has one
depth where they have two slopes: what is known badly in one place follows from what is known well beside it, without
any smoothing. The residual of a pixel is e = ρ − F_S n(z_x, z_y), F_S the matrix of the lights that it sees; unknowns
are the depths at the corners of pixels and the nine of F. Each step is one banded factorisation and the Schur
complement of F. Only where what is left over is noise: an error of the model would be taken for shape.

Weights are Cauchy's at first, which find the depth from a poor start, F held: a pixel of a shadow that was not told
keeps some pull under them, and thousands turn F by degrees. Then they are those of Geman and McClure, whose pull falls
to nothing, and pixels whose neighbourhood is off do not count: noise is alone where it is large, shadows are not.

In perspective z is the relief of ``recover.geometry.rays``, and n ∝ (−p, −q, 1 − x p − y q) along the ray (x, y).
"""

from dataclasses import dataclass, replace
from typing import Literal

import numba
import numpy as np
from scipy import ndimage

from huesphere.recover.geometry.depth_grid import DepthGrid
from huesphere.recover.geometry.least_squares import Schedule, descend
from huesphere.recover.geometry.rays import of_relief
from huesphere.recover.geometry.slopes import normals_of_slopes
from huesphere.recover.lights.model import Lights, numbered, without
from huesphere.recover.pixels.uncertain_component import without_uncertain_part

Weights = Literal["cauchy", "geman-mcclure"]

STEEPEST_N3 = 0.08  # of the normals that it starts from
DOUBTFUL = 1e-2  # weight, in the start, of normals that are not of all-lit pixels
WIDTH = 4.25  # standard deviations, beyond which a residual counts ever less
HELD_F = Schedule(  # of the depths, F held
    first_damping=1e-7, most_steps=6, trials=4, relative_gain=1e-3, least_damping=1e-7, least_raised=3e-5
)
FREE_F = replace(HELD_F, most_steps=12, relative_gain=3e-4)
ROUNDS, IN_A_ROUND = 3, replace(FREE_F, most_steps=2)  # of looking for neighbourhoods that are off
LEAST = 1e-9  # of the strongest channel's information: what a slope is held by where nothing else does
NEAR, OFF = 3, 4.5  # pixels across a neighbourhood, and times the median square from which it is off
MOST = 50.0  # squared residual that one pixel can put into it
NOT_AT_ALL = 1e-9  # weight of pixels there
BLOCK = 16  # pixels across, whose residuals may go together


@dataclass(frozen=True)
class Colours:
    """What the pixels of a fit are explained by, over the standard deviation of the noise."""

    rho: np.ndarray  # (P, 3)
    lost: np.ndarray  # (P, 3, 3) of F, of the lights that a pixel misses
    sure: np.ndarray  # (P, 3, 3) inverse covariance
    ray: np.ndarray  # (P, 2), 0 where rays are parallel

    def weighted(self, weight: np.ndarray) -> "Colours":
        return Colours(self.rho, self.lost, self.sure * weight[:, None, None], self.ray)

    def squares(self, slope: np.ndarray, F: np.ndarray) -> np.ndarray:
        """eᵀ sure e (P,) of the slopes (P, 2)."""
        residual = self.rho - np.einsum("pij,pj->pi", F - self.lost, normals_of_slopes(slope, self.ray))
        return np.maximum(np.einsum("pi,pij,pj->p", residual, self.sure, residual), 0.0)  # type: ignore[no-any-return]

    def loss(self, slope: np.ndarray, F: np.ndarray, weights: Weights) -> float:
        return float(_loss(self.rho, self.ray, slope, F, self.lost, self.sure, weights == "geman-mcclure"))


@dataclass(frozen=True)
class Joint:
    """The surface that explains the picture, and the matrix that goes with it."""

    normals: np.ndarray  # (H, W, 3), NaN off the object
    F: np.ndarray  # (3, 3)
    misfit: np.ndarray  # (H, W) |e| over noise; NaN off the object
    alike: np.ndarray  # (H, W) pixels whose neighbourhood is explained
    steps: int
    loss: float  # of all pixels, by the weights of Geman and McClure
    noise: float  # standard deviation of a channel, picture units
    cells: DepthGrid
    colours: Colours
    slope: np.ndarray  # (P, 2) of the cells
    scaled: np.ndarray  # (3, 3) F over noise
    covariance: np.ndarray  # (9, 9) of that, row by row


def fit_jointly(
    rgb: np.ndarray,
    mask: np.ndarray,
    normals: np.ndarray,
    firm: np.ndarray,
    off: np.ndarray,
    F: np.ndarray,
    lights: Lights,
    taken: np.ndarray,
    noise: float,
    ray: np.ndarray | None = None,
) -> Joint:
    """Refine ``normals`` (H, W, 3) of the object ``mask`` (H, W), and ``F`` (3, 3), against the picture (H, W, 3).

    ``firm`` (H, W): normals that are known well, for the start. ``off`` (H, W): bits of the lights that a pixel misses,
    −1 where that is not known, which counts as none: its residual will be large and its weight small. ``taken``
    (H, W, 3): light of other pixels that was taken out of the picture, along which it is in doubt
    (``recover.pixels.uncertain_component``). ``noise``: standard deviation of a channel, picture units. ``ray`` (H, W,
    2): of a picture in perspective.

    Weights: D. Geman and G. Reynolds, IEEE TPAMI 14(3) (1992) 367–383, after Geman and McClure (1987).
    """
    cells = DepthGrid(np.where(mask[..., None], rgb, 0.0), mask, 1, ray)
    numbers = np.maximum(off[mask], 0)
    lost = np.zeros((len(cells), 3, 3))
    for number in np.unique(numbers[numbers > 0]):
        lost[numbers == number] = F - without(F, lights.found, numbered(int(number)))
    g = taken[mask] / noise
    sure = np.stack(
        [without_uncertain_part(np.broadcast_to(channel, g.shape), g, 1.0) for channel in np.eye(3)], axis=1
    )
    along = np.zeros((len(cells), 2)) if cells.ray is None else cells.ray
    colours, scaled = Colours(cells.mean / noise, lost / noise, sure, along), F / noise
    n = of_relief(normals[mask].astype(np.float64), cells.ray)
    n[:, 2] = np.maximum(n[:, 2], STEEPEST_N3)
    weight = np.where(firm[mask], 1.0, DOUBTFUL)
    start = -n[:, :2] / n[:, 2:] * weight[:, None]
    slope = cells.solve(cells.factor(weight, 0 * weight, weight), start[..., None])[..., 0]

    information = Information(len(cells))
    slope, scaled, steps = _descend(information, cells, colours, slope, scaled, "cauchy", HELD_F)
    return _settled(information, cells, colours, slope, scaled, noise, steps)


def fit_again(fit: Joint, slope: np.ndarray) -> Joint:
    """The fit begun at other slopes (P, 2) of its cells, as those that a prior has rid of most of their noise.

    Bounded weights have many valleys: from slopes that follow the noise, and from the first F, pixels that fit are
    taken for ones that do not, and F stays where the rest led it.
    """
    return _settled(Information(len(slope)), fit.cells, fit.colours, slope, fit.scaled, fit.noise, fit.steps)


def _settled(
    information: "Information",
    cells: DepthGrid,
    colours: Colours,
    slope: np.ndarray,
    scaled: np.ndarray,
    noise: float,
    steps: int,
) -> Joint:
    """The fit with bounded weights, F free, from a depth that is about right, after ``steps`` of them."""
    mask = cells.where
    slope, scaled, more = _descend(information, cells, colours, slope, scaled, "geman-mcclure", FREE_F)
    steps += more
    for _ in range(ROUNDS):
        strange = _strange(colours.squares(slope, scaled), mask)
        told = colours.weighted(np.where(strange, NOT_AT_ALL, 1.0))
        slope, scaled, more = _descend(information, cells, told, slope, scaled, "geman-mcclure", IN_A_ROUND)
        steps += more
    covariance = _covariance(information, cells, told, slope, scaled)
    out, misfit = np.full((*mask.shape, 3), np.nan), np.full(mask.shape, np.nan)
    out[mask], misfit[mask] = normals_of_slopes(slope, colours.ray), np.sqrt(colours.squares(slope, scaled))
    alike = mask.copy()
    alike[mask] = ~strange
    loss = colours.loss(slope, scaled, "geman-mcclure")
    return Joint(out, scaled * noise, misfit, alike, steps, loss, noise, cells, colours, slope, scaled, covariance)


def _strange(squares: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Pixels (P,) of the mask in neighbourhoods whose mean square is more than noise leaves."""
    image = np.zeros(mask.shape)
    image[mask] = np.minimum(squares, MOST)
    mean = ndimage.uniform_filter(image, NEAR)[mask] / ndimage.uniform_filter(mask.astype(float), NEAR)[mask]
    return mean > OFF * max(float(np.median(squares)), 1.0)  # type: ignore[no-any-return]


def _covariance(
    information: "Information", cells: DepthGrid, colours: Colours, slope: np.ndarray, F: np.ndarray
) -> np.ndarray:
    """Of F (9, 9), row by row, the depths being free: what noise gives, and more where residuals go together.

    Inverse of the Schur complement, A⁻¹, and A⁻¹ B A⁻¹ with B the sum of squared scores of blocks of pixels, which is A
    where residuals are noise: P. J. Huber, Proc. 5th Berkeley Symp. 1 (1967) 221–233. Their sum, as blocks are few.
    """
    _, by_F, schur = information.moves(cells, FREE_F.first_damping)
    inverse = np.linalg.pinv(schur, rcond=1e-12, hermitian=True)
    n = normals_of_slopes(slope, colours.ray)
    e = np.einsum("pij,pj->pi", colours.sure, colours.rho - np.einsum("pij,pj->pi", F - colours.lost, n))
    weight = (1 + colours.squares(slope, F) / WIDTH**2) ** -2
    score = (weight[:, None, None] * e[:, :, None] * n[:, None, :]).reshape(-1, 9)
    score -= np.einsum("pdk,pd->pk", by_F, information.g)
    row, column = np.nonzero(cells.where)
    block = (row // BLOCK) * (cells.where.shape[1] // BLOCK + 1) + column // BLOCK
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
    """(slopes (P, 2), F (3, 3), steps) where the schedule's Gauss–Newton steps end.

    ``information`` is then that of the last state.
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
    """Normal equations at one state, in place."""

    def __init__(self, count: int) -> None:
        self.W, self.g = np.empty((count, 3)), np.empty((count, 2))
        self.cross = np.empty((count, 2, 9))
        self.H, self.h = np.empty((9, 9)), np.empty(9)

    def at(self, colours: Colours, slope: np.ndarray, F: np.ndarray, weights: Weights) -> float:
        """The loss."""
        c, bounded = colours, weights == "geman-mcclure"
        fields = self.W, self.g, self.cross, self.H, self.h
        return float(_linearise(c.rho, c.ray, slope, F, c.lost, c.sure, bounded, *fields))

    def held_slopes(self) -> np.ndarray:
        """W (P, 3), and a little more, where a slope is held by nothing else."""
        least = LEAST * float(self.W.max())
        return self.W + np.array([least, 0.0, least])

    def _factor(self, cells: DepthGrid, damping: float) -> np.ndarray:
        return cells.factor(*self.held_slopes().T, damping=damping)

    def moves(self, cells: DepthGrid, damping: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Moves of the slopes (P, 2) with F held, what they follow of F (P, 2, 9), and the Schur complement (9, 9)."""
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
        turn = np.linalg.lstsq(schur + 1e-9 * np.trace(self.H) / 9 * np.eye(9), right, rcond=1e-12)[0]
        return slope + by_slope - by_F @ turn, F + turn.reshape(3, 3)


@numba.njit(cache=True, fastmath={"contract", "nsz"})  # type: ignore[untyped-decorator]
def _loss(
    rho: np.ndarray,
    ray: np.ndarray,
    slope: np.ndarray,
    F: np.ndarray,
    lost: np.ndarray,
    V: np.ndarray,
    bounded: bool,
) -> float:
    total, width, r = 0.0, WIDTH * WIDTH, np.empty(3)
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


@numba.njit(cache=True, fastmath={"contract", "nsz"})  # type: ignore[untyped-decorator]
def _linearise(
    rho: np.ndarray,
    ray: np.ndarray,
    slope: np.ndarray,
    F: np.ndarray,
    lost: np.ndarray,
    V: np.ndarray,
    bounded: bool,
    W: np.ndarray,
    g: np.ndarray,
    cross: np.ndarray,
    H: np.ndarray,
    h: np.ndarray,
) -> float:
    """Loss; and in place: W (P, 3) xx xy yy, g (P, 2) for the slopes, H, h for F (row by row), ``cross`` between.

    V (P, 3, 3) is the inverse covariance of the colours.
    """
    H[:], h[:] = 0.0, 0.0
    total, width = 0.0, WIDTH * WIDTH
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
            sure_p = V[i, c, 0] * by_p[0] + V[i, c, 1] * by_p[1] + V[i, c, 2] * by_p[2]
            sure_q = V[i, c, 0] * by_q[0] + V[i, c, 1] * by_q[1] + V[i, c, 2] * by_q[2]
            sure_e = V[i, c, 0] * e[0] + V[i, c, 1] * e[1] + V[i, c, 2] * e[2]
            W[i, 0] += w * by_p[c] * sure_p
            W[i, 1] += w * by_p[c] * sure_q
            W[i, 2] += w * by_q[c] * sure_q
            g[i, 0] += w * by_p[c] * sure_e
            g[i, 1] += w * by_q[c] * sure_e
            for x in range(3):
                k = 3 * c + x
                h[k] += w * n[x] * sure_e
                cross[i, 0, k], cross[i, 1, k] = w * n[x] * sure_p, w * n[x] * sure_q
                for d in range(3):
                    for y in range(3):
                        H[k, 3 * d + y] += w * n[x] * n[y] * V[i, c, d]
    return total
