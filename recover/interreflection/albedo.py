"""The effective albedos α of the three channels, from how interreflection moves colours off the ellipsoid.

Without interreflection colours would lie on an ellipsoid (report Eq. 8): ρᵀCρ = 1 for the direct light ρ = L − α K L,
where L is the picture and K L the light that each pixel gathers from the others. C and α are fitted together, because
another C can compensate for much of an error of α: where K L is nearly the same everywhere, as in a bowl, an error of α
shifts all colours alike, and another ellipsoid about black fits the shifted colours nearly as well. The misfit has
several local minima in α, so the fit starts from several α.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import optimize

from huesphere.recover.ellipsoid.distance import signed_distance
from huesphere.recover.ellipsoid.fit import whitening
from huesphere.recover.geometry.quadratic import FACTOR, MONOMIALS, design, elements_of, matrix_of
from huesphere.recover.robust_scale import mad_scale

# Effective albedos, equal in the three channels, that the fit starts from, each in turn.
FIRST_ALBEDOS = (0.0, 0.3, 0.6, 0.9)

# Most pixels that are fitted: a few to choose among the local minima, then many to refine the one chosen.
FEW_PIXELS, MANY_PIXELS = 3000, 20_000
CAUCHY_WIDTH = 2.385  # robust scales: the width of Cauchy's loss with 95 % efficiency for Gaussian residuals
ALGEBRAIC_STEPS = 6  # reweightings in the algebraic fit of an ellipsoid, from which the fit of C and α starts
ROUNDS, EVALUATIONS = 3, 60  # times that the scale of the residuals is estimated anew; most evaluations between two
SMALLEST_SCALE = 1e-12  # picture units: guards the division by a scale of 0
FROM_BOUNDS = 1e-6  # how far from the bounds 0 and 1 a start of α keeps: on a bound the solver could not move it
ROW, COLUMN = zip(*MONOMIALS)


@dataclass(frozen=True)
class Albedo:
    """The effective albedos of the channels, and how much better colours fit an ellipsoid with them."""

    alpha: np.ndarray  # (3,) share of the gathered light that each channel sends on, 0 … 1
    stderr: np.ndarray  # (3,) standard errors, from the scatter about the ellipsoid; infinite if no light is gathered
    before: float  # robust scale of the distances to the best ellipsoid at α = 0, picture units
    after: float  # the same at ``alpha``


def fit_albedo(rgb: np.ndarray, gathered: np.ndarray, starts: Sequence[float] = FIRST_ALBEDOS) -> Albedo:
    """α in [0, 1] with ρᵀCρ = 1 for ρ = L − α K L: least Sampson distances under Cauchy's loss, over C and α.

    ``rgb`` and ``gathered`` (P, 3) are L and K L, picture units, of pixels that should lie on one ellipsoid. Among the
    local minima that are reached from the albedos ``starts``, that with the least robust scale is taken. White noise
    makes ρᵀCρ larger everywhere by its variance times tr C, which only scales C. Raises RecoveryFailure
    (rank-deficient-colours) where the colours lie in a plane through black.
    """
    few, many = (slice(None, None, -(-len(rgb) // count)) for count in (FEW_PIXELS, MANY_PIXELS))
    before = mad_scale(signed_distance(rgb[many], _ellipsoid(rgb[many])))
    if not gathered.any():
        return Albedo(np.zeros(3), np.full(3, np.inf), before, before)
    minima = [_fit(rgb[few], gathered[few], _ellipsoid(rgb[few] - a * gathered[few]), a) for a in starts]
    C, alpha, *_ = min(minima, key=lambda minimum: minimum[3])
    _, alpha, stderr, after = _fit(rgb[many], gathered[many], C, alpha)
    return Albedo(alpha, stderr, before, after)


def _ellipsoid(rho: np.ndarray) -> np.ndarray:
    """C (3, 3) of colours (P, 3), by algebraic least squares reweighted to approximate Sampson distances. Eq. (8)"""
    T = whitening(rho)
    M, weight = design(rho @ T), np.ones(len(rho))
    for _ in range(ALGEBRAIC_STEPS):
        C = T @ matrix_of(np.linalg.lstsq(M * weight[:, None], weight, rcond=None)[0]) @ T
        distance = signed_distance(rho, C)
        slope = 2 * np.linalg.norm(rho @ C, axis=1)
        weight = 1 / (slope * np.hypot(1.0, distance / max(CAUCHY_WIDTH * mad_scale(distance), SMALLEST_SCALE)))
    return C


def _fit(
    rgb: np.ndarray, gathered: np.ndarray, C: np.ndarray, alpha: np.ndarray | float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """(C (3, 3), α (3,), standard errors of α (3,), robust scale) at the local minimum reached from C and ``alpha``.

    The unknowns x (9,) are the six elements of C, each in a unit of about its own size, and α. Residuals are Sampson's
    distances d = (ρᵀCρ − 1) / (2|Cρ|), picture units.
    """
    z = elements_of(C)
    unit = np.abs(z) + 1e-3 * np.abs(z).max()
    x = np.concatenate([z / unit, np.clip(np.broadcast_to(alpha, 3), FROM_BOUNDS, 1 - FROM_BOUNDS)])

    def distance(x: np.ndarray) -> np.ndarray:
        return signed_distance(rgb - x[6:] * gathered, matrix_of(x[:6] * unit))

    def jacobian(x: np.ndarray) -> np.ndarray:
        # d = r / (2 |Cρ|) with r = ρᵀCρ − 1, so ∂d = (∂r − (r / |Cρ|) ∂|Cρ|) / (2 |Cρ|); by α through ρ = L − α K L.
        C = matrix_of(x[:6] * unit)
        rho = rgb - x[6:] * gathered
        by_C = rho @ C
        length = np.linalg.norm(by_C, axis=1, keepdims=True)
        r = (rho * by_C).sum(axis=1, keepdims=True) - 1
        toward = by_C / length
        of_length = (toward[:, ROW] * rho[:, COLUMN] + toward[:, COLUMN] * rho[:, ROW]) * FACTOR / 2  # ∂|Cρ|/∂z
        by_z = (design(rho) - r / length * of_length) * unit
        by_alpha = gathered * (r / length * (toward @ C) - 2 * by_C)
        return np.concatenate([by_z, by_alpha], axis=1) / (2 * length)  # type: ignore[no-any-return]

    bounds = np.repeat([-np.inf, 0.0], [6, 3]), np.repeat([np.inf, 1.0], [6, 3])
    for _ in range(ROUNDS):
        scale = max(CAUCHY_WIDTH * mad_scale(distance(x)), SMALLEST_SCALE)
        found = optimize.least_squares(
            distance, x, jacobian, bounds, x_scale="jac", loss="cauchy", f_scale=scale, max_nfev=EVALUATIONS
        )
        x = found.x
    scale = mad_scale(distance(x))
    covariance = np.linalg.pinv(found.jac.T @ found.jac)
    stderr = scale * np.sqrt(np.abs(np.diag(covariance))[6:])
    return matrix_of(x[:6] * unit), x[6:], stderr, scale
