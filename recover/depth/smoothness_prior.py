"""A smoothness prior on the surface whose local strength is estimated from the picture itself.

The energy is Σ |e|² + Σ |∇z − ∇z'|²/s², the second sum over pairs of neighbouring pixels, with a scale s of its own for
each pair: small on smooth parts of the surface, large on rough ones. s² is the mean, over a small window, of the
posterior expectation of |∇z − ∇z'|²: the square of the estimate plus its posterior variance, which is the EM algorithm
for the variance of a Gaussian prior. That variance is measured on a few samples of the posterior; each costs one
solution with the factor that the step needs anyhow. Near a crease the window contains the crease, s is large, and
nothing is smoothed; without noise s² is far above what the data leave open, and the surface does not change. F is held
fixed: the prior makes slopes more alike, and F would follow.

Each pair is treated as if it were the only one (a pseudo-likelihood). Counted exactly, s² is twice that; on every scene
tried that was a little worse.

Sources: A. P. Dempster, N. M. Laird and D. B. Rubin, J. R. Stat. Soc. B 39 (1977) 1–38 (EM); G. Papandreou and
A. L. Yuille, NIPS 23 (2010) 1858–1866 (samples of a Gaussian by perturbing what it is fitted to).
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from huesphere.recover.depth.joint_fit import Information, Joint
from huesphere.recover.depth.parameters import DEPTH
from huesphere.recover.geometry.depth_grid import DepthGrid
from huesphere.recover.geometry.slopes import normals_of_slopes

TRIALS = 5  # of a step, each a third of the one before
LEAST_SHARE = 1e-3  # of the square that noise alone gives a difference: the least that a scale begins with
NEXT_TO_NOTHING = 1e-6  # weight of a pair that tells nothing of the scale, so that every pair has one
SEED = 0
SAMPLES = 4  # of the posterior, each of which costs one solution: more make its variance less noisy


@dataclass(frozen=True)
class Denoised:
    """The surface under the prior."""

    normals: np.ndarray  # (H, W, 3), NaN off the object
    misfit: np.ndarray  # (H, W) |e| over noise; NaN off the object
    uncertainty_deg: np.ndarray  # (H, W) expected angular error
    scale: np.ndarray  # (A + B,) s of the pairs of cells: expected rms difference of their slopes
    slope: np.ndarray  # (P, 2) of the cells


def denoised(fit: Joint) -> Denoised:
    """The surface of a joint fit under the prior, whose scale is estimated from it; F is that of the fit."""
    cells, colours, F, slope = fit.cells, fit.colours, fit.scaled, fit.slope
    rng = np.random.default_rng(SEED)
    pairs = _Pairs(cells)
    inlier = np.sqrt(colours.squares(slope, F)) < DEPTH.prior_outlier
    informative = np.where(pairs.both(inlier), 1.0, NEXT_TO_NOTHING)
    information = Information(len(cells))
    information.at(colours, slope, F, "cauchy")
    W = information.held_slopes()
    of_noise = pairs.squares(cells.solve(cells.factor(*W.T), _perturbed(W, rng))).mean(axis=-1)
    of_noise = pairs.pooled(of_noise, informative)
    square = np.maximum(pairs.pooled(pairs.squares(slope), informative) - of_noise, LEAST_SHARE * of_noise)
    for _ in range(DEPTH.prior_steps):
        bond = 1 / square
        energy = _energy(fit, pairs, bond, slope)
        pull = information.g - pairs.back(bond[:, None] * pairs.change(slope))
        factors = cells.factor(*W.T, bonds=bond)
        noise = _perturbed(W, rng) + pairs.back(np.sqrt(bond)[:, None, None] * _normal(rng, len(bond)))
        moves = cells.solve(factors, np.concatenate([pull[..., None], noise], axis=-1))
        slope = _nearer(fit, pairs, bond, slope, moves[..., 0], energy)
        sample = moves[..., 1:]
        square = pairs.pooled(pairs.squares(slope) + pairs.squares(sample).mean(axis=-1), informative)
        information.at(colours, slope, F, "cauchy")
        W = information.held_slopes()
    by_F = cells.solve(factors, information.cross)
    covariance = np.einsum("pik,kl,pjl->pij", by_F, fit.covariance, by_F)
    spread = np.einsum("pik,pjk->pij", sample, sample).reshape(-1, 4) / SAMPLES
    covariance += DEPTH.posterior_inflation**2 * cells.smoothed(spread, DEPTH.prior_window_px).reshape(-1, 2, 2)
    shape = fit.misfit.shape
    normals, misfit, uncertainty = np.full((*shape, 3), np.nan), np.full(shape, np.nan), np.full(shape, np.nan)
    where = np.isfinite(fit.misfit)
    normals[where], misfit[where] = normals_of_slopes(slope, colours.ray), np.sqrt(colours.squares(slope, F))
    uncertainty[where] = _expected_deg(slope, colours.ray, covariance)
    return Denoised(normals, misfit, uncertainty, np.sqrt(square), slope)


def _normal(rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.standard_normal((count, 2, SAMPLES))


def _perturbed(W: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Random right sides (P, 2, samples) of covariance W (P, 3): the effect of the picture's noise on the slopes."""
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
    """The slopes (P, 2) after the largest share 3⁻ᵏ of ``move`` that lowers the energy, or as they are."""
    for trial in range(TRIALS):
        moved = slope + move / 3**trial
        if _energy(fit, pairs, bond, moved) < energy:
            return moved
    return slope


def _expected_deg(slope: np.ndarray, ray: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Expected angular error (P,) of normals whose slopes (P, 2) along rays (P, 2) have that covariance (P, 2, 2).

    A change d of the slope changes (−p, −q, s) by (−d, −ray·d), of which the component along it does not rotate it.
    """
    s = 1 - (ray * slope).sum(axis=1)
    square = s**2 + (slope**2).sum(axis=1)
    length = slope - s[:, None] * ray
    along = np.einsum("pi,pij,pj->p", length, covariance, length) / square
    in_depth = np.einsum("pi,pij,pj->p", ray, covariance, ray)
    variance = (np.trace(covariance, axis1=1, axis2=2) + in_depth - along) / square
    return np.degrees(np.sqrt(np.pi / 4 * np.maximum(variance, 0.0)))  # type: ignore[no-any-return]


class _Pairs:
    """Pairs of neighbouring cells: first the A left and right, then the B upper and lower."""

    def __init__(self, cells: DepthGrid) -> None:
        self.cells, self.beside = cells, len(cells.pairs[0])
        self.one, self.other = np.concatenate(cells.pairs).T

    def change(self, slope: np.ndarray) -> np.ndarray:
        """Differences (A + B, 2, …) of slopes (P, 2, …) between the two cells of each pair."""
        return slope[self.other] - slope[self.one]  # type: ignore[no-any-return]

    def squares(self, slope: np.ndarray) -> np.ndarray:
        """Squared lengths (A + B, …) of the differences of slopes (P, 2, …)."""
        return (self.change(slope) ** 2).sum(axis=1)  # type: ignore[no-any-return]

    def both(self, good: np.ndarray) -> np.ndarray:
        """Pairs (A + B,) of which both cells are ``good`` (P,)."""
        return good[self.one] & good[self.other]  # type: ignore[no-any-return]

    def back(self, pull: np.ndarray) -> np.ndarray:
        """The adjoint of ``change``: from (A + B, 2, …) to (P, 2, …)."""
        flat, count = pull.reshape(len(pull), -1), len(self.cells)
        columns = [np.bincount(self.other, c, count) - np.bincount(self.one, c, count) for c in flat.T]
        return np.stack(columns, axis=-1).reshape(count, *pull.shape[1:])

    def pooled(self, values: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """``values`` (A + B,) averaged over neighbours of the same direction, by ``weight`` (A + B,)."""
        out, window = np.empty(len(values)), DEPTH.prior_window_px
        for part in (slice(self.beside), slice(self.beside, None)):
            place = tuple(index[self.one[part]] for index in np.nonzero(self.cells.where))
            images = np.zeros((2, *self.cells.where.shape))
            images[0][place], images[1][place] = (values * weight)[part], weight[part]
            total, of = ndimage.gaussian_filter(images, (0, window, window), truncate=3, mode="constant")
            out[part] = total[place] / of[place]
        return out
