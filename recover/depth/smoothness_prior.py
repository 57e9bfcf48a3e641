"""A smoothness prior on the surface whose local strength is estimated from the picture itself.

The energy is Σ |e|² + Σ |∇z − ∇z'|²/s², the second sum over pairs of neighbouring pixels, with a scale s of its own for
each pair: small on smooth parts of the surface, large on rough ones. s² is the mean, over a small window, of the
posterior expectation of |∇z − ∇z'|²: the square of the estimate plus its posterior variance, which is the EM algorithm
for the variance of a Gaussian prior. The posterior variance is measured on a few samples of the posterior; each costs
one more solution with a factorisation that the step needs in any case. Near a crease the window contains the crease, s
is large, and nothing is smoothed. Without noise s² is far larger than the variance that the data leave, and the surface
does not change. F is held fixed: the prior makes slopes more alike, and a free F would compensate for that.

Each pair is treated as if it were the only one (a pseudo-likelihood). The exact likelihood, in which the differences
around a pixel depend on each other, gives twice this s²; on every scene tried the result was a little worse.

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

PRIOR_STEPS = 4  # Steps of the surface and of the scale of its prior, together.

TRIALS = 5  # number of lengths that are tried for a step, each a third of the one before
LEAST_SHARE = 1e-3  # lower limit of the first s², as a share of the expected square of a difference of pure noise
NEXT_TO_NOTHING = 1e-6  # weight of pairs with an outlier in the mean for s²; positive, so that every pair has an s
SEED = 0
SAMPLES = 4  # number of samples of the posterior, each of which costs one solution; more make its variance less noisy


@dataclass(frozen=True)
class Denoised:
    """The most probable surface under the prior."""

    normals: np.ndarray  # (H, W, 3), NaN off the object
    misfit: np.ndarray  # (H, W) |e| in standard deviations of the noise; NaN off the object
    uncertainty_deg: np.ndarray  # (H, W) expected angular error
    scale: np.ndarray  # (A + B,) s of the pairs of cells: expected rms difference of their slopes
    slope: np.ndarray  # (P, 2) of the cells


def denoised(fit: Joint) -> Denoised:
    """The most probable surface given the picture of a joint ``fit``, its F, and the prior, whose scale is estimated.

    Raises LinAlgError where the equations are singular.
    """
    cells, colours, F, slope = fit.cells, fit.colours, fit.scaled, fit.slope
    rng = np.random.default_rng(SEED)
    pairs = _Pairs(cells)
    inlier = np.sqrt(colours.squares(slope, F)) < DEPTH.prior_outlier
    informative = np.where(pairs.both(inlier), 1.0, NEXT_TO_NOTHING)
    information = Information(len(cells))
    information.at(colours, slope, F, "cauchy")
    W = information.definite_weights()
    # First estimate of s²: the mean square of the differences less the mean square that noise alone causes
    of_noise = pairs.squares(cells.solve(cells.factor(*W.T), _random_right_sides(W, rng))).mean(axis=-1)
    of_noise = pairs.local_mean(of_noise, informative)
    square = np.maximum(pairs.local_mean(pairs.squares(slope), informative) - of_noise, LEAST_SHARE * of_noise)
    for _ in range(PRIOR_STEPS):
        bond = 1 / square
        energy = _energy(fit, pairs, bond, slope)
        downhill = information.g - pairs.adjoint(bond[:, None] * pairs.difference(slope))
        factors = cells.factor(*W.T, bonds=bond)
        noise = _random_right_sides(W, rng)
        noise += pairs.adjoint(np.sqrt(bond)[:, None, None] * _standard_normal(rng, len(bond)))
        # One factorisation gives the step and, from the random right sides, samples of the posterior about its mean.
        moves = cells.solve(factors, np.concatenate([downhill[..., None], noise], axis=-1))
        slope = _line_search(fit, pairs, bond, slope, moves[..., 0], energy)
        sample = moves[..., 1:]
        square = pairs.local_mean(pairs.squares(slope) + pairs.squares(sample).mean(axis=-1), informative)
        information.at(colours, slope, F, "cauchy")
        W = information.definite_weights()
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


def _standard_normal(rng: np.random.Generator, count: int) -> np.ndarray:
    """Independent standard normal numbers (count, 2, SAMPLES)."""
    return rng.standard_normal((count, 2, SAMPLES))


def _random_right_sides(W: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Gaussian right sides (P, 2, SAMPLES) of the slopes' normal equations, as the picture's noise makes them.

    Their covariance at each cell is the cell's weight W (P, 3), in the order xx xy yy.
    """
    a = np.sqrt(W[:, 0])
    b = W[:, 1] / a
    c = np.sqrt(np.maximum(W[:, 2] - b**2, 0.0))
    noise = _standard_normal(rng, len(W))
    return np.stack([a[:, None] * noise[:, 0], b[:, None] * noise[:, 0] + c[:, None] * noise[:, 1]], axis=1)


def _energy(fit: Joint, pairs: "_Pairs", bond: np.ndarray, slope: np.ndarray) -> float:
    """The energy of the module's header for slopes (P, 2), with Cauchy's loss of |e| and ``bond`` (A + B,) = 1/s²."""
    return fit.colours.loss(slope, fit.scaled, "cauchy") + float(bond @ pairs.squares(slope))


def _line_search(
    fit: Joint, pairs: "_Pairs", bond: np.ndarray, slope: np.ndarray, move: np.ndarray, energy: float
) -> np.ndarray:
    """``slope`` (P, 2) plus 3⁻ᵏ ``move`` for the least k < TRIALS that makes the energy less than ``energy``.

    ``slope`` itself if there is none.
    """
    for trial in range(TRIALS):
        moved = slope + move / 3**trial
        if _energy(fit, pairs, bond, moved) < energy:
            return moved
    return slope


def _expected_deg(slope: np.ndarray, ray: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Expected angular error (P,), degrees, of normals whose slopes (P, 2) have the ``covariance`` (P, 2, 2).

    The normal is m/|m| with m = (−p, −q, s) and s = 1 − ray·(p, q), ``ray`` (P, 2). A change d of the slope changes m
    by (−d, −ray·d). The component of that change along m does not rotate the normal, so its variance is subtracted.
    """
    s = 1 - (ray * slope).sum(axis=1)
    square = s**2 + (slope**2).sum(axis=1)  # |m|²
    length_by_slope = slope - s[:, None] * ray  # |m| times the gradient of |m|
    along_m = np.einsum("pi,pij,pj->p", length_by_slope, covariance, length_by_slope) / square
    in_depth = np.einsum("pi,pij,pj->p", ray, covariance, ray)
    variance = (np.trace(covariance, axis1=1, axis2=2) + in_depth - along_m) / square
    return np.degrees(np.sqrt(np.pi / 4 * np.maximum(variance, 0.0)))  # type: ignore[no-any-return]


class _Pairs:
    """Pairs of neighbouring cells: first the A pairs (left, right), then the B pairs (upper, lower)."""

    def __init__(self, cells: DepthGrid) -> None:
        self.cells = cells
        self.horizontal = len(cells.pairs[0])  # A
        self.one, self.other = np.concatenate(cells.pairs).T  # (A + B,) each, numbers of a pair's two cells

    def difference(self, slope: np.ndarray) -> np.ndarray:
        """Differences (A + B, 2, …) of slopes (P, 2, …) between the two cells of each pair."""
        return slope[self.other] - slope[self.one]  # type: ignore[no-any-return]

    def squares(self, slope: np.ndarray) -> np.ndarray:
        """Squared lengths (A + B, …) of the differences of slopes (P, 2, …)."""
        return (self.difference(slope) ** 2).sum(axis=1)  # type: ignore[no-any-return]

    def both(self, good: np.ndarray) -> np.ndarray:
        """Pairs (A + B,) of which both cells are ``good`` (P,)."""
        return good[self.one] & good[self.other]  # type: ignore[no-any-return]

    def adjoint(self, values: np.ndarray) -> np.ndarray:
        """The adjoint of ``difference``: from ``values`` (A + B, 2, …) of the pairs to (P, 2, …) of the cells."""
        flat, count = values.reshape(len(values), -1), len(self.cells)
        columns = [np.bincount(self.other, c, count) - np.bincount(self.one, c, count) for c in flat.T]
        return np.stack(columns, axis=-1).reshape(count, *values.shape[1:])

    def local_mean(self, values: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """Weighted means (A + B,) of the pairs' ``values`` (A + B,) over pairs nearby, with ``weight`` (A + B,).

        The window is a Gaussian with the standard deviation ``DEPTH.prior_window_px``. Horizontal pairs are averaged
        with horizontal pairs only, and vertical pairs with vertical ones.
        """
        out, window = np.empty(len(values)), DEPTH.prior_window_px
        for direction in (slice(self.horizontal), slice(self.horizontal, None)):
            # Each pair is a pixel of two images, at the place of its first cell.
            place = tuple(index[self.one[direction]] for index in np.nonzero(self.cells.where))
            images = np.zeros((2, *self.cells.where.shape))
            images[0][place], images[1][place] = (values * weight)[direction], weight[direction]
            weighted, weights = ndimage.gaussian_filter(images, (0, window, window), truncate=3, mode="constant")
            out[direction] = weighted[place] / weights[place]
        return out
