"""One depth a pixel explains three measurements: depth and F fitted together to the picture, by Gauss–Newton.

A single pixel knows one slope well and the other badly, and normals taken one by one keep that noise. A surface has one
depth where they have two slopes: what is known badly in one place follows from what is known well beside it, without
any smoothing. The residual of a pixel is e = ρ − F_S n(z_x, z_y), F_S the matrix of the lights that it sees, with
Cauchy weights; unknowns are the depths at the corners of pixels and the nine of F. Each step is one banded
factorisation and the Schur complement of F. Only where what is left over is noise: an error of the model would be
taken for shape.
"""

from dataclasses import dataclass

import numba
import numpy as np

from recover.along import likelier
from recover.cells import Cells
from recover.lights import Lights, numbered, without

STEEPEST_N3 = 0.08  # of the normals that it starts from
DOUBTFUL = 1e-2  # weight, in the start, of normals that are not of all-lit pixels
CAUCHY = 4.25  # standard deviations, beyond which a residual counts ever less
STEPS, TRIES = 14, 5
DAMPING, MORE = 1e-7, 30.0  # of the depths; more of it where a step fails
JOINTLY = 1.0  # of the geometric mean of the two principal variances of a slope: what is left of it
SETTLED = 1e-4  # of the loss
LEAST = 1e-9  # of the strongest channel's information: what a slope is held by where nothing else does


@dataclass(frozen=True)
class Joint:
    """The surface that explains the picture, and the matrix that goes with it."""

    normals: np.ndarray  # (H, W, 3), NaN off the object
    F: np.ndarray  # (3, 3)
    misfit: np.ndarray  # (H, W) |e| over noise; NaN off the object
    uncertainty_deg: np.ndarray  # (H, W) expected angular error
    steps: int


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
) -> Joint:
    """Refine ``normals`` (H, W, 3) of the object ``mask`` (H, W), and ``F`` (3, 3), against the picture (H, W, 3).

    ``firm`` (H, W): normals that are known well, for the start. ``off`` (H, W): bits of the lights that a pixel misses,
    −1 where that is not known, which counts as none: its residual will be large and its weight small. ``taken``
    (H, W, 3): light of other pixels that was taken out of the picture, along which it is in doubt (``recover.along``).
    ``noise``: standard deviation of a channel, picture units.
    """
    cells = Cells(np.where(mask[..., None], rgb, 0.0), mask, 1)
    numbers = np.maximum(off[mask], 0)
    lost = np.zeros((len(cells), 3, 3))
    for number in np.unique(numbers[numbers > 0]):
        lost[numbers == number] = F - without(F, lights.found, numbered(int(number)))
    rho, lost, scaled = cells.N / noise, lost / noise, F / noise
    g = taken[mask] / noise
    V = np.stack([likelier(np.broadcast_to(channel, g.shape), g, 1.0) for channel in np.eye(3)], axis=1)
    n = normals[mask].astype(np.float64)
    n[:, 2] = np.maximum(n[:, 2], STEEPEST_N3)
    weight = np.where(firm[mask], 1.0, DOUBTFUL)
    start = -n[:, :2] / n[:, 2:] * weight[:, None]
    slope = cells.solve(cells.factor(weight, 0 * weight, weight), start[..., None])[..., 0]

    information, damping = _Information(len(cells)), DAMPING
    loss = information.at(rho, slope, scaled, lost, V)
    steps = 0
    while steps < STEPS:
        steps += 1
        for _ in range(TRIES):
            moved, matrix = information.step(cells, slope, scaled, damping)
            trial = float(_loss(rho, moved, matrix, lost, V))
            if trial < loss:
                break
            damping = max(damping, 1e-6) * MORE
        else:
            break
        settled = loss - trial < SETTLED * loss
        slope, scaled, damping = moved, matrix, max(damping / 5, DAMPING)
        loss = information.at(rho, slope, scaled, lost, V)
        if settled:
            break
    n = np.stack([-slope[:, 0], -slope[:, 1], np.ones(len(slope))], axis=-1)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    residual = rho - np.einsum("pij,pj->pi", scaled - lost, n)
    out, misfit, doubt = np.full((*mask.shape, 3), np.nan), np.full(mask.shape, np.nan), np.full(mask.shape, np.nan)
    out[mask], misfit[mask] = n, np.sqrt(np.einsum("pi,pij,pj->p", residual, V, residual))
    doubt[mask] = _uncertainty_deg(information, cells, slope)
    return Joint(out, scaled * noise, misfit, doubt, steps)


def _uncertainty_deg(information: "_Information", cells: Cells, slope: np.ndarray) -> np.ndarray:
    """Expected angular error (P,): of F, carried to each slope exactly, and of noise.

    The noise of slopes that must fit together is between what the two principal ones have alone: about their
    geometric mean, for waves run in all directions.
    """
    _, by_F, schur = information.moves(cells, DAMPING)
    covariance = np.linalg.pinv(schur, rcond=1e-12, hermitian=True)
    of_F = np.einsum("pik,kl,pjl->pij", by_F, covariance, by_F)
    W = information.W
    mean = JOINTLY / np.sqrt(np.maximum(W[:, 0] * W[:, 2] - W[:, 1] ** 2, 1e-12 * (W[:, 0] + W[:, 2]) ** 2))
    total = of_F + mean[:, None, None] * np.eye(2)
    square = 1 + (slope**2).sum(axis=1)
    along = np.einsum("pi,pij,pj->p", slope, total, slope) / square
    variance = (np.trace(total, axis1=1, axis2=2) - along) / square
    return np.degrees(np.sqrt(np.pi / 4 * np.maximum(variance, 0.0)))  # type: ignore[no-any-return]


class _Information:
    """Normal equations at one state, in place."""

    def __init__(self, count: int) -> None:
        self.W, self.g = np.empty((count, 3)), np.empty((count, 2))
        self.cross = np.empty((count, 2, 9))
        self.H, self.h = np.empty((9, 9)), np.empty(9)

    def at(self, rho: np.ndarray, slope: np.ndarray, F: np.ndarray, lost: np.ndarray, V: np.ndarray) -> float:
        return float(_linearise(rho, slope, F, lost, V, self.W, self.g, self.cross, self.H, self.h))

    def moves(self, cells: Cells, damping: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Moves of the slopes (P, 2) with F held, what they follow of F (P, 2, 9), and the Schur complement (9, 9)."""
        least = LEAST * float(self.W.max())
        factors = cells.factor(self.W[:, 0] + least, self.W[:, 1], self.W[:, 2] + least, damping=damping)
        moves = cells.solve(factors, np.concatenate([self.g[..., None], self.cross], axis=-1))
        by_slope, by_F = moves[..., 0], moves[..., 1:]
        return by_slope, by_F, self.H - np.einsum("pdk,pdl->kl", self.cross, by_F)

    def step(self, cells: Cells, slope: np.ndarray, F: np.ndarray, damping: float) -> tuple[np.ndarray, np.ndarray]:
        """(slopes (P, 2), F (3, 3)) after one Gauss–Newton step."""
        by_slope, by_F, schur = self.moves(cells, damping)
        right = self.h - np.einsum("pdk,pd->k", self.cross, by_slope)
        turn = np.linalg.lstsq(schur + 1e-9 * np.trace(self.H) / 9 * np.eye(9), right, rcond=1e-12)[0]
        return slope + by_slope - by_F @ turn, F + turn.reshape(3, 3)


@numba.njit(cache=True, fastmath={"contract", "nsz"})  # type: ignore[untyped-decorator]
def _loss(rho: np.ndarray, slope: np.ndarray, F: np.ndarray, lost: np.ndarray, V: np.ndarray) -> float:
    total, width, r = 0.0, CAUCHY * CAUCHY, np.empty(3)
    for i in range(len(rho)):
        p, q = slope[i]
        z = 1 / np.sqrt(1 + p * p + q * q)
        square = 0.0
        for c in range(3):
            M0, M1, M2 = F[c, 0] - lost[i, c, 0], F[c, 1] - lost[i, c, 1], F[c, 2] - lost[i, c, 2]
            r[c] = rho[i, c] - (-M0 * p - M1 * q + M2) * z
        for c in range(3):
            square += r[c] * (V[i, c, 0] * r[0] + V[i, c, 1] * r[1] + V[i, c, 2] * r[2])
        total += width * np.log1p(square / width)
    return total


@numba.njit(cache=True, fastmath={"contract", "nsz"})  # type: ignore[untyped-decorator]
def _linearise(
    rho: np.ndarray,
    slope: np.ndarray,
    F: np.ndarray,
    lost: np.ndarray,
    V: np.ndarray,
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
    total, width = 0.0, CAUCHY * CAUCHY
    e, by_p, by_q, n = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for i in range(len(rho)):
        p, q = slope[i]
        z = 1 / np.sqrt(1 + p * p + q * q)
        n[0], n[1], n[2] = -p * z, -q * z, z
        cube, square = z * z * z, 0.0
        for c in range(3):
            M0, M1, M2 = F[c, 0] - lost[i, c, 0], F[c, 1] - lost[i, c, 1], F[c, 2] - lost[i, c, 2]
            e[c] = rho[i, c] - (M0 * n[0] + M1 * n[1] + M2 * n[2])
            by_p[c] = M0 * (p * p * cube - z) + M1 * p * q * cube - M2 * p * cube
            by_q[c] = M0 * p * q * cube + M1 * (q * q * cube - z) - M2 * q * cube
        for c in range(3):
            square += e[c] * (V[i, c, 0] * e[0] + V[i, c, 1] * e[1] + V[i, c, 2] * e[2])
        total += width * np.log1p(square / width)
        w = 1 / (1 + square / width)
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
