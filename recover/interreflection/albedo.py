"""The effective albedos α of the three channels, from how interreflection moves colours off the ellipsoid.

Without interreflection colours would lie on an ellipsoid (report Eq. 8): ρᵀCρ = 1 for the direct light ρ = L − α K L,
where L is the picture and K L the light that each pixel gathers from the others. C and α are fitted together, because
another C can compensate for much of an error of α: where K L is nearly the same everywhere, as in a bowl, an error of α
shifts all colours alike, and another ellipsoid about black fits the shifted colours nearly as well. The misfit has
several local minima in α, so the fit starts from several α.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np

from huesphere.recover.ellipsoid.distance import signed_distance
from huesphere.recover.ellipsoid.fit import whitening
from huesphere.recover.geometry.least_squares import Schedule, descend
from huesphere.recover.geometry.quadratic import design, elements_of, matrix_of
from huesphere.recover.robust_scale import mad_scale

# Effective albedos, equal in the three channels, that the fit starts from, each in turn.
FIRST_ALBEDOS = (0.0, 0.3, 0.6, 0.9)

# Most pixels that are fitted: a few to choose among the local minima, then many to refine the one chosen.
FEW_PIXELS, MANY_PIXELS = 3000, 20_000
CAUCHY_WIDTH = 2.385  # robust scales: the width of Cauchy's loss with 95 % efficiency for Gaussian residuals
ALGEBRAIC_STEPS = 6  # reweightings in the algebraic fit of an ellipsoid, from which the fit of C and α starts
ROUNDS = 3  # times that the scale of the residuals is estimated anew
SCHEDULE = Schedule(first_damping=1e-3, most_steps=60, trials=10, relative_gain=1e-9)  # between two of these times
LEAST_CURVATURE = 1e-12  # of the loss at an outlier, where Cauchy's loss curves the other way; that of an inlier is 1
SMALLEST_SCALE = 1e-12  # picture units: guards the division by a scale of 0


@dataclass(frozen=True)
class Albedo:
    """The effective albedos of the channels, the ellipsoid without that light, and how much better colours fit it."""

    alpha: np.ndarray  # (3,) share of the gathered light that each channel sends on, 0 … 1
    stderr: np.ndarray  # (3,) standard errors, from the scatter about the ellipsoid; infinite if no light is gathered
    before: float  # robust scale of the distances to the best ellipsoid at α = 0, picture units
    after: float  # the same at ``alpha``
    C: np.ndarray  # (3, 3) the ellipsoid of the direct light, inverse squared picture units


def fit_albedo(rgb: np.ndarray, gathered: np.ndarray, starts: Sequence[float] = FIRST_ALBEDOS) -> Albedo:
    """α in [0, 1] with ρᵀCρ = 1 for ρ = L − α K L: least Sampson distances under Cauchy's loss, over C and α.

    ``rgb`` and ``gathered`` (P, 3) are L and K L, picture units, of pixels that should lie on one ellipsoid. Among the
    local minima that are reached from the albedos ``starts``, that with the least robust scale is taken. White noise
    makes ρᵀCρ larger everywhere by its variance times tr C, which only scales C. Raises RecoveryFailure
    (rank-deficient-colours) where the colours lie in a plane through black.
    """
    few, many = (slice(None, None, -(-len(rgb) // count)) for count in (FEW_PIXELS, MANY_PIXELS))
    C = _ellipsoid(rgb[many])
    before = mad_scale(signed_distance(rgb[many], C))
    if not gathered.any():
        return Albedo(np.zeros(3), np.full(3, np.inf), before, before, C)
    minima = [_fit(rgb[few], gathered[few], _ellipsoid(rgb[few] - a * gathered[few]), a) for a in starts]
    C, alpha, *_ = min(minima, key=lambda minimum: minimum[3])
    C, alpha, stderr, after = _fit(rgb[many], gathered[many], C, alpha)
    return Albedo(alpha, stderr, before, after, C)


def _ellipsoid(rho: np.ndarray) -> np.ndarray:
    """C (3, 3) of colours (P, 3), by algebraic least squares reweighted to approximate Sampson distances. Eq. (8)"""
    T = whitening(rho)
    M, weight = design(rho @ T), np.ones(len(rho))
    for _ in range(ALGEBRAIC_STEPS):
        C = T @ matrix_of(np.linalg.lstsq((M.T * weight**2) @ M, M.T @ weight**2, rcond=None)[0]) @ T
        distance = signed_distance(rho, C)
        slope = 2 * np.linalg.norm(rho @ C, axis=1)
        weight = 1 / (slope * np.hypot(1.0, distance / max(CAUCHY_WIDTH * mad_scale(distance), SMALLEST_SCALE)))
    return C


def _fit(
    rgb: np.ndarray, gathered: np.ndarray, C: np.ndarray, alpha: np.ndarray | float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """(C (3, 3), α (3,), standard errors of α (3,), robust scale) at the local minimum reached from C and ``alpha``.

    The unknowns x (9,) are the six elements of C, each in a unit of about its own size, and α, which stays within 0 and
    1. Residuals are Sampson's distances d = (ρᵀCρ − 1) / (2|Cρ|), picture units.
    """
    rgb, gathered = (np.ascontiguousarray(a, dtype=np.float64) for a in (rgb, gathered))
    z = elements_of(C)
    unit = np.abs(z) + 1e-3 * np.abs(z).max()
    x = np.concatenate([z / unit, np.broadcast_to(alpha, 3)])

    def distance(x: np.ndarray) -> np.ndarray:
        return signed_distance(rgb - x[6:] * gathered, matrix_of(x[:6] * unit))

    def trial(x: np.ndarray, equations: tuple[np.ndarray, np.ndarray], damping: float) -> np.ndarray | None:
        curvature, slope = equations
        a, rise = x[6:], slope[6:]
        held = np.r_[np.zeros(6, bool), ((a <= 0) & (rise > 0)) | ((a >= 1) & (rise < 0))]
        free = np.flatnonzero(~held & (np.diag(curvature) > 0))
        part = curvature[np.ix_(free, free)]
        there = x.copy()
        there[free] -= np.linalg.solve(part + damping * np.diag(np.diag(part)), slope[free])
        there[6:] = np.clip(there[6:], 0, 1)
        return there

    def refined(x: np.ndarray, width: float) -> np.ndarray:
        return descend(
            x,
            loss=lambda x: _loss(rgb, gathered, matrix_of(x[:6] * unit), x[6:], width),
            linearise=lambda x: _normal_equations(rgb, gathered, matrix_of(x[:6] * unit), x[6:], unit, width),
            step=trial,
            schedule=SCHEDULE,
        ).state

    for _ in range(ROUNDS):
        width = max(CAUCHY_WIDTH * mad_scale(distance(x)), SMALLEST_SCALE)
        x = refined(x, width)
    C, alpha = matrix_of(x[:6] * unit), x[6:]
    scale = mad_scale(distance(x))
    curvature, _ = _normal_equations(rgb, gathered, C, alpha, unit, width)
    stderr = scale * np.sqrt(np.abs(np.diag(np.linalg.pinv(curvature)))[6:])
    return C, alpha, stderr, scale


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})  # type: ignore[untyped-decorator]
def _loss(rgb: np.ndarray, gathered: np.ndarray, C: np.ndarray, alpha: np.ndarray, width: float) -> float:
    """Sum of Cauchy's loss ½ log(1 + (d / width)²) over Sampson's distances d of the pixels."""
    total = 0.0
    for i in range(len(rgb)):
        r, square = -1.0, 0.0
        for k in range(3):
            by_C = 0.0
            for m in range(3):
                by_C += C[k, m] * (rgb[i, m] - alpha[m] * gathered[i, m])
            r += (rgb[i, k] - alpha[k] * gathered[i, k]) * by_C
            square += by_C * by_C
        total += np.log1p(r * r / (4 * square * width * width))
    return total / 2


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})  # type: ignore[untyped-decorator]
def _normal_equations(
    rgb: np.ndarray, gathered: np.ndarray, C: np.ndarray, alpha: np.ndarray, unit: np.ndarray, width: float
) -> tuple[np.ndarray, np.ndarray]:
    """(curvature (9, 9), slope (9,)) of the loss times width² by the unknowns x of ``_fit``.

    d = r / (2|Cρ|) with r = ρᵀCρ − 1, so ∂d = (∂r − (r / |Cρ|) ∂|Cρ|) / (2|Cρ|); by α through ρ = L − α K L. The
    curvature is that of Gauss and Newton with the second derivative of the loss: B. Triggs et al., "Bundle adjustment –
    a modern synthesis", Vision Algorithms (1999), Eq. (10).
    """
    curvature, slope = np.zeros((9, 9)), np.zeros(9)
    rho, by_C, toward, turned, J = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(9)
    for i in range(len(rgb)):
        for k in range(3):
            rho[k] = rgb[i, k] - alpha[k] * gathered[i, k]
        r, square = -1.0, 0.0
        for k in range(3):
            by_C[k] = C[k, 0] * rho[0] + C[k, 1] * rho[1] + C[k, 2] * rho[2]
            r += rho[k] * by_C[k]
            square += by_C[k] * by_C[k]
        length = np.sqrt(square)
        ratio, d = r / length, r / (2 * length)
        for k in range(3):
            toward[k] = by_C[k] / length
        for k in range(3):
            turned[k] = C[k, 0] * toward[0] + C[k, 1] * toward[1] + C[k, 2] * toward[2]
            J[k] = (rho[k] - ratio * toward[k]) * rho[k] * unit[k] / (2 * length)
            J[6 + k] = gathered[i, k] * (ratio * turned[k] - 2 * by_C[k]) / (2 * length)
        for k, (row, column) in enumerate(((0, 1), (0, 2), (1, 2))):
            mixed = 2 * rho[row] * rho[column] - ratio * (toward[row] * rho[column] + toward[column] * rho[row])
            J[3 + k] = mixed * unit[3 + k] / (2 * length)
        share = d * d / (width * width)
        weight = 1 / (1 + share)
        second = max((1 - share) * weight * weight, LEAST_CURVATURE)
        for k in range(9):
            slope[k] += weight * d * J[k]
            for m in range(k + 1):
                curvature[k, m] += second * J[k] * J[m]
    for k in range(9):
        for m in range(k):
            curvature[m, k] = curvature[k, m]
    return curvature, slope
