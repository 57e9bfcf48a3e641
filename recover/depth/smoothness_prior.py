"""A prior on the surface whose strength the picture tells: how much the slope turns from each pixel to the next.

The energy Σ |e|² + Σ |∇z − ∇z'|²/s² over neighbouring pixels holds a smooth cheek still and leaves rough hair alone, if
s is local. So s² is the mean, over a few neighbours, of what the picture leaves to be believed of |∇z − ∇z'|²: the
square of the estimate and its posterior variance, the EM algorithm for the variance of a Gaussian prior. That variance
is measured on a few samples of the posterior, which cost a solution each with the factor of the step. Across an edge
the window is full of the edge, s is large and nothing is held; without noise s² is far above what the data leave open,
and nothing moves. F is held: a prior pulls slopes to be alike, and F would follow.

Each pair is taken for itself, as if the others did not hold the same depths (a pseudo-likelihood). Counted exactly, s²
is twice that; on every scene tried that was a little worse.

Sources: A. P. Dempster, N. M. Laird and D. B. Rubin, J. R. Stat. Soc. B 39 (1977) 1–38 (EM); G. Papandreou and
A. L. Yuille, NIPS 23 (2010) 1858–1866 (samples of a Gaussian by perturbing what it is fitted to).
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from huesphere.recover.depth.joint_fit import Information, Joint
from huesphere.recover.geometry.depth_grid import DepthGrid
from huesphere.recover.geometry.slopes import normals_of_slopes

STEPS, TRIES = 4, 5
SAMPLES = 4  # of the posterior
WINDOW = 1.5  # standard deviation of the neighbourhood of a scale, pixels
LEAST_OF_NOISE = 1e-3  # times what noise alone gives a difference: the least square that a scale begins with
OUTLIER = 4.0  # |e| over noise beyond which a pixel says nothing about the scale
NEXT_TO_NOTHING = 1e-6  # weight of such ones, that every pair has a scale
UNSURE = 1.3  # times the spread of the samples: the scale is an estimate too, and pairs are not independent; measured
SEED = 0


@dataclass(frozen=True)
class Quiet:
    """The surface under the prior."""

    normals: np.ndarray  # (H, W, 3), NaN off the object
    misfit: np.ndarray  # (H, W) |e| over noise; NaN off the object
    uncertainty_deg: np.ndarray  # (H, W) expected angular error
    scale: np.ndarray  # (A + B,) s of the pairs of cells: rms change of the slope
    slope: np.ndarray  # (P, 2) of the cells


def quieted(fit: Joint) -> Quiet:
    """The surface of the joint fit under a prior that it tells itself; F is that of the fit."""
    cells, colours, F, slope = fit.cells, fit.colours, fit.scaled, fit.slope
    rng = np.random.default_rng(SEED)
    pairs = _Pairs(cells)
    calm = np.sqrt(colours.squares(slope, F)) < OUTLIER
    telling = np.where(pairs.both(calm), 1.0, NEXT_TO_NOTHING)
    information = Information(len(cells))
    information.at(colours, slope, F, "cauchy")
    W = information.held_slopes()
    of_noise = pairs.squares(cells.solve(cells.factor(*W.T), _perturbed(W, rng))).mean(axis=-1)
    of_noise = pairs.pooled(of_noise, telling)
    square = np.maximum(pairs.pooled(pairs.squares(slope), telling) - of_noise, LEAST_OF_NOISE * of_noise)
    for _ in range(STEPS):
        bond = 1 / square
        energy = _energy(fit, pairs, bond, slope)
        pull = information.g - pairs.back(bond[:, None] * pairs.change(slope))
        factors = cells.factor(*W.T, bonds=bond)
        noise = _perturbed(W, rng) + pairs.back(np.sqrt(bond)[:, None, None] * _normal(rng, len(bond)))
        moves = cells.solve(factors, np.concatenate([pull[..., None], noise], axis=-1))
        slope = _nearer(fit, pairs, bond, slope, moves[..., 0], energy)
        sample = moves[..., 1:]
        square = pairs.pooled(pairs.squares(slope) + pairs.squares(sample).mean(axis=-1), telling)
        information.at(colours, slope, F, "cauchy")
        W = information.held_slopes()
    by_F = cells.solve(factors, information.cross)
    covariance = np.einsum("pik,kl,pjl->pij", by_F, fit.covariance, by_F)
    spread = np.einsum("pik,pjk->pij", sample, sample).reshape(-1, 4) / SAMPLES
    covariance += UNSURE**2 * cells.smoothed(spread, WINDOW).reshape(-1, 2, 2)
    shape = fit.misfit.shape
    normals, misfit, doubt = np.full((*shape, 3), np.nan), np.full(shape, np.nan), np.full(shape, np.nan)
    where = np.isfinite(fit.misfit)
    normals[where], misfit[where] = normals_of_slopes(slope, colours.ray), np.sqrt(colours.squares(slope, F))
    doubt[where] = _expected_deg(slope, colours.ray, covariance)
    return Quiet(normals, misfit, doubt, np.sqrt(square), slope)


def _normal(rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.standard_normal((count, 2, SAMPLES))


def _perturbed(W: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Pulls (P, 2, SAMPLES) on the slopes whose covariance is W: what noise of the picture does."""
    a = np.sqrt(W[:, 0])
    b = W[:, 1] / a
    c = np.sqrt(np.maximum(W[:, 2] - b**2, 0.0))
    noise = _normal(rng, len(W))
    return np.stack([a[:, None] * noise[:, 0], b[:, None] * noise[:, 0] + c[:, None] * noise[:, 1]], axis=1)


def _energy(fit: Joint, pairs: "_Pairs", bond: np.ndarray, slope: np.ndarray) -> float:
    return fit.colours.loss(slope, fit.scaled, "cauchy") + float(bond @ pairs.squares(slope))


def _nearer(
    fit: Joint, pairs: "_Pairs", bond: np.ndarray, slope: np.ndarray, move: np.ndarray, energy: float
) -> np.ndarray:
    """The slopes moved by as much of ``move`` as makes the energy less."""
    for trial in range(TRIES):
        moved = slope + move / 3**trial
        if _energy(fit, pairs, bond, moved) < energy:
            return moved
    return slope


def _expected_deg(slope: np.ndarray, ray: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Expected angular error (P,) of normals whose slopes (P, 2) along rays (P, 2) have that covariance (P, 2, 2).

    A change d of the slope changes (−p, −q, s) by (−d, −ray·d), of which what is along it turns nothing.
    """
    s = 1 - (ray * slope).sum(axis=1)
    square = s**2 + (slope**2).sum(axis=1)
    length = slope - s[:, None] * ray
    along = np.einsum("pi,pij,pj->p", length, covariance, length) / square
    in_depth = np.einsum("pi,pij,pj->p", ray, covariance, ray)
    variance = (np.trace(covariance, axis1=1, axis2=2) + in_depth - along) / square
    return np.degrees(np.sqrt(np.pi / 4 * np.maximum(variance, 0.0)))  # type: ignore[no-any-return]


class _Pairs:
    """Neighbouring cells: beside each other first, then one below the other."""

    def __init__(self, cells: DepthGrid) -> None:
        self.cells, self.beside = cells, len(cells.pairs[0])
        self.one, self.other = np.concatenate(cells.pairs).T

    def change(self, slope: np.ndarray) -> np.ndarray:
        """Of slopes (P, 2, …) from one cell to the other (A + B, 2, …)."""
        return slope[self.other] - slope[self.one]  # type: ignore[no-any-return]

    def squares(self, slope: np.ndarray) -> np.ndarray:
        """(A + B, …) of the changes of slopes (P, 2, …)."""
        return (self.change(slope) ** 2).sum(axis=1)  # type: ignore[no-any-return]

    def both(self, good: np.ndarray) -> np.ndarray:
        """Pairs (A + B,) of which both cells are ``good`` (P,)."""
        return good[self.one] & good[self.other]  # type: ignore[no-any-return]

    def back(self, pull: np.ndarray) -> np.ndarray:
        """Pulls (P, 2, …) on slopes of pulls (A + B, 2, …) on their changes: the adjoint of ``change``."""
        flat, count = pull.reshape(len(pull), -1), len(self.cells)
        columns = [np.bincount(self.other, c, count) - np.bincount(self.one, c, count) for c in flat.T]
        return np.stack(columns, axis=-1).reshape(count, *pull.shape[1:])

    def pooled(self, values: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """``values`` (A + B,) averaged over neighbours of the same direction, by ``weight`` (A + B,)."""
        out = np.empty(len(values))
        for part in (slice(self.beside), slice(self.beside, None)):
            place = tuple(index[self.one[part]] for index in np.nonzero(self.cells.where))
            images = np.zeros((2, *self.cells.where.shape))
            images[0][place], images[1][place] = (values * weight)[part], weight[part]
            total, of = ndimage.gaussian_filter(images, (0, WINDOW, WINDOW), truncate=3, mode="constant")
            out[part] = total[place] / of[place]
        return out
