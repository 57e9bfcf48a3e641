"""The effective albedos of the three channels, from what light between the parts of a surface does to its ellipsoid.

Without it colours would lie on one: ρᵀCρ = 1 for ρ = L − α K L. C and α are fitted together, for what α is wrong by, C
takes up: where K L is nearly the same everywhere, as in a bowl, only the ellipsoid's middle tells them apart. So the
misfit has several valleys, and the fit starts from several α.
"""

from dataclasses import dataclass

import numpy as np
from scipy import optimize

from huesphere.recover.ellipsoid.distance import signed_distance
from huesphere.recover.ellipsoid.fit import whitening
from huesphere.recover.geometry.quadratic import FACTOR, MONOMIALS, design, elements_of, matrix_of
from huesphere.recover.robust_scale import mad_scale

STARTS = (0.0, 0.3, 0.6, 0.9)
FEW, MANY = 3000, 20_000  # pixels that choose the valley, and that are fitted in it
BREAKDOWN = 2.385  # of the robust scale: Cauchy's, at which the fit keeps 95 % efficiency
ALGEBRAIC_STEPS, ROUNDS, EVALUATIONS = 6, 3, 60
SMALLEST = 1e-12  # scale, picture units
EDGE = 1e-6  # how far from 0 and 1 a start keeps
ROW, COLUMN = zip(*MONOMIALS)


@dataclass(frozen=True)
class Albedo:
    """What `fit_albedo` finds."""

    alpha: np.ndarray  # (3,)
    stderr: np.ndarray  # (3,) from the scatter about the ellipsoid
    before: float  # robust scale of the distance to the ellipsoid at α = 0, picture units …
    after: float  # … and at α


def fit_albedo(rgb: np.ndarray, gathered: np.ndarray) -> Albedo:
    """α with ρᵀCρ = 1 for ρ = L − α K L, least Sampson distances under Cauchy's loss over C and α in [0, 1].

    ``rgb`` and ``gathered`` (P, 3) are L and K L of pixels that should be of one ellipsoid. The valley is chosen by the
    robust scale. White noise makes ρᵀCρ larger everywhere by its variance times tr C, which only scales C.
    """
    few, many = (slice(None, None, -(-len(rgb) // count)) for count in (FEW, MANY))
    before = mad_scale(signed_distance(rgb[many], _ellipsoid(rgb[many])))
    if not gathered.any():
        return Albedo(np.zeros(3), np.full(3, np.inf), before, before)
    valleys = [_fit(rgb[few], gathered[few], _ellipsoid(rgb[few] - a * gathered[few]), a) for a in STARTS]
    C, alpha, *_ = min(valleys, key=lambda valley: valley[3])
    _, alpha, stderr, after = _fit(rgb[many], gathered[many], C, alpha)
    return Albedo(alpha, stderr, before, after)


def _ellipsoid(rho: np.ndarray) -> np.ndarray:
    """C (3, 3) of colours (P, 3), by least squares with weights that shrink to those near it."""
    T = whitening(rho)
    M, weight = design(rho @ T), np.ones(len(rho))
    for _ in range(ALGEBRAIC_STEPS):
        C = T @ matrix_of(np.linalg.lstsq(M * weight[:, None], weight, rcond=None)[0]) @ T
        distance = signed_distance(rho, C)
        slope = 2 * np.linalg.norm(rho @ C, axis=1)
        weight = 1 / (slope * np.hypot(1.0, distance / max(BREAKDOWN * mad_scale(distance), SMALLEST)))
    return C


def _fit(
    rgb: np.ndarray, gathered: np.ndarray, C: np.ndarray, alpha: np.ndarray | float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """(C, α, its standard error, robust scale) of the valley that holds C (3, 3) and ``alpha``."""
    z = elements_of(C)
    unit = np.abs(z) + 1e-3 * np.abs(z).max()
    x = np.concatenate([z / unit, np.clip(np.broadcast_to(alpha, 3), EDGE, 1 - EDGE)])

    def distance(x: np.ndarray) -> np.ndarray:
        return signed_distance(rgb - x[6:] * gathered, matrix_of(x[:6] * unit))

    def jacobian(x: np.ndarray) -> np.ndarray:
        C = matrix_of(x[:6] * unit)
        rho = rgb - x[6:] * gathered
        by_C = rho @ C
        length = np.linalg.norm(by_C, axis=1, keepdims=True)
        r = (rho * by_C).sum(axis=1, keepdims=True) - 1
        toward = by_C / length
        of_length = (toward[:, ROW] * rho[:, COLUMN] + toward[:, COLUMN] * rho[:, ROW]) * FACTOR / 2
        by_z = (design(rho) - r / length * of_length) * unit
        by_alpha = gathered * (r / length * (toward @ C) - 2 * by_C)
        return np.concatenate([by_z, by_alpha], axis=1) / (2 * length)  # type: ignore[no-any-return]

    bounds = np.repeat([-np.inf, 0.0], [6, 3]), np.repeat([np.inf, 1.0], [6, 3])
    for _ in range(ROUNDS):
        scale = max(BREAKDOWN * mad_scale(distance(x)), SMALLEST)
        found = optimize.least_squares(
            distance, x, jacobian, bounds, x_scale="jac", loss="cauchy", f_scale=scale, max_nfev=EVALUATIONS
        )
        x = found.x
    scale = mad_scale(distance(x))
    covariance = np.linalg.pinv(found.jac.T @ found.jac)
    stderr = scale * np.sqrt(np.abs(np.diag(covariance))[6:])
    return matrix_of(x[:6] * unit), x[6:], stderr, scale
