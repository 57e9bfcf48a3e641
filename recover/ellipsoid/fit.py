"""The colour ellipsoid ρᵀCρ = 1 (report 2.1–2.2): least squares, Least Median of Squares, scale, cut, confidence.

P. J. Rousseeuw & A. M. Leroy, "Robust Regression and Outlier Detection" (1987), is the report's [17]. The search is
over colours whitened by their second moments, so that exposure, units and order of the channels change the result by
rounding only. Colours ρ are in linear picture units throughout, and r = ρᵀCρ − 1 is the residual.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri, stdtrit

from huesphere.recover.ellipsoid.noise_bias import without_noise
from huesphere.recover.ellipsoid.normal_equations import normal_equations, residuals
from huesphere.recover.ellipsoid.parameters import ELLIPSOID
from huesphere.recover.geometry.quadratic import FACTOR, design, elements_of, matrix_of
from huesphere.recover.status import RecoveryFailure

UNKNOWNS = 6
COEFFICIENTS = ("c11", "c22", "c33", "c12", "c13", "c23")  # Eq. (10): the order of z
F_CONSISTENCY = 1.0 / ndtri(0.75)  # ≃ 1.4826, report 2.2: standard deviation of a Gaussian over its median |value|
ROUNDING_RESIDUAL = 1e-5  # of r: rounding of pictures in single precision, and less than the noise of any camera
CONFIDENCE = 0.95  # probability with which a coefficient lies within its limits, report 2.2
LEAST_GAIN = 1e-3  # relative decrease of the median of r² below which C-steps over all pixels end: C no longer changes
RANKED_PIXELS = 100_000  # of a larger picture every k-th pixel is taken before they are ranked: size of the work


@dataclass(frozen=True)
class Fit:
    """An ellipsoid, the colours that lie on it, and its accuracy. N colours in the order in which they were given."""

    C: np.ndarray  # (3, 3) symmetric positive definite, inverse squared picture units
    s0: float  # robust dispersion of r over all N, dimensionless
    r2: float  # robust coefficient of determination over all N, 1 − (med |r|)²
    residual: np.ndarray  # (N,) r = ρᵀCρ − 1 to the final C
    accepted: np.ndarray  # (N,) bool, on the ellipsoid
    coefficients: tuple[dict[str, float | str], ...]  # name, value, stderr, low, high, t of each element of z
    covariance: np.ndarray  # (6, 6) of z, in the units of z


def kappa(rgb: np.ndarray, C: np.ndarray) -> np.ndarray:
    """κ = ρᵀCρ (N,) of colours (N, 3): squared size of the ellipsoid through ρ relative to the model's (report 4.2)."""
    return residuals(rgb, C) + 1.0


def least_squares(rgb: np.ndarray) -> np.ndarray:
    """C (3, 3) minimising Σ (ρᵀCρ − 1)² over all colours (N, 3). Eq. (10)

    Raises RecoveryFailure: rank-deficient-colours, no-ellipsoid.
    """
    T = whitening(rgb)
    return _require_ellipsoid(_least_squares(rgb, T, np.ones(len(rgb), bool)))


def least_median_of_squares(rgb: np.ndarray, *, seed: int = 0) -> np.ndarray:
    """C (3, 3), inverse squared picture units, of least median of r² over colours (N, 3); report 2.1, [17].

    Random sets of six colours are fitted exactly, and those fits that are ellipsoids are ranked on a few hundred
    pixels. The best are refitted to the half of the pixels with the least r² ("C-steps" of Rousseeuw & Van Driessen
    2006), on thousands of pixels and then on all. Deterministic in ``seed``; pixels are sampled by their rank in size,
    so that their order does not matter.

    Raises RecoveryFailure: rank-deficient-colours, no-ellipsoid.
    """
    T = whitening(rgb)
    rng = np.random.default_rng(seed)
    stages = ELLIPSOID.concentration_stages
    M = design(rng.permutation(_sample(rgb, T, stages[-1][0]) @ T.T))
    candidates = _elemental_ellipsoids(M, rng)
    for pixels, kept, steps in stages:
        candidates = _concentrate(M[:pixels], candidates, kept, steps)
    best = _concentrate(M, candidates, 1, 0)[0]
    return _require_ellipsoid(_concentrate_all(rgb, T.T @ matrix_of(best) @ T, T))


def whitening(rgb: np.ndarray, keep: np.ndarray | None = None) -> np.ndarray:
    """T (3, 3), symmetric, for which the colours Tρ have second moments 𝟙 (about black, not about their mean).

    ``rgb`` (N, 3) in picture units; ``keep`` (N,) bool: pixels to use, None: all. Raises RecoveryFailure
    (rank-deficient-colours) where the colours lie in a plane through black, to rounding.
    """
    keep = np.ones(len(rgb), bool) if keep is None else keep
    _, products = normal_equations(rgb, np.eye(3), keep)
    moment = matrix_of(products / FACTOR) / max(1, keep.sum())
    eigenvalues, eigenvectors = np.linalg.eigh(moment)
    if not eigenvalues[0] > 1e-13 * eigenvalues[2]:
        raise RecoveryFailure("rank-deficient-colours", "the colours lie in a plane through black")
    return (eigenvectors / np.sqrt(eigenvalues)) @ eigenvectors.T


def dispersion(residual: np.ndarray) -> float:
    """s0 = f (1 + 5 / (N − 6)) √(med r²), the robust scale of residuals r (N,) (report 2.2, from [17])."""
    return _spread(residual)[0]


def determination(residual: np.ndarray) -> float:
    """Robust coefficient of determination R² = 1 − (med |r|)² of residuals r (N,) (report 4.2)."""
    return _spread(residual)[1]


def reweighted(rgb: np.ndarray, C: np.ndarray, *, cut: float | None = None, confidence: float = CONFIDENCE) -> Fit:
    """Least squares over the colours (N, 3) within the ``cut`` of C (3, 3), with confidence limits (report 2.2).

    ``cut`` is in units of s0; by default ``acceptance_cut`` of the parameters, the report's 2.5. The limits take the
    accepted pixels as given and their noise as noise of r alone. The choice of pixels by the cut and the noise in M
    are neglected, so the limits are too narrow at noise above about half a percent.
    """
    cut = ELLIPSOID.acceptance_cut if cut is None else cut
    r = residuals(rgb, C)
    s0, r2 = _spread(r)
    # Without the lower bound, rounding would decide which pixels are accepted where s0 is at the level of rounding.
    return _fit(rgb, np.abs(r) <= max(cut * s0, ROUNDING_RESIDUAL), 0.0, confidence, (s0, r2))


def fit_accepted(rgb: np.ndarray, accepted: np.ndarray, *, noise: float = 0.0) -> Fit:
    """Least squares over the ``accepted`` (N,) bool of the colours (N, 3), with limits of each coefficient. Eq. (10)

    ``noise``, where given, is the standard deviation of each channel, in picture units: its bias is then subtracted
    (``recover.ellipsoid.noise_bias``). Raises RecoveryFailure: rank-deficient-colours, no-ellipsoid.
    """
    return _fit(rgb, accepted, noise, CONFIDENCE, None)


def _fit(
    rgb: np.ndarray, accepted: np.ndarray, noise: float, confidence: float, spread: tuple[float, float] | None
) -> Fit:
    """``fit_accepted``; ``spread``: (s0, R²) of an earlier fit's residuals, to be reported in place of this fit's own.

    The regression M z ≃ 1 of Eq. (10) is solved in whitened colours Tρ. ``observed`` is its MᵀM with noise, ``gram``
    the same without the bias by noise. The covariance of z is then that of a solution whose right side has the
    covariance variance · ``observed``, mapped by ``bread`` to the elements of C in picture units.
    """
    T = whitening(rgb, accepted)
    count = int(accepted.sum())
    observed, right = normal_equations(rgb, T, accepted)
    gram = observed
    if noise > 0:
        gram, right = without_noise(observed, right, count, noise**2 * (T @ T.T))
    C = _require_ellipsoid(T.T @ matrix_of(np.linalg.lstsq(gram, right)[0]) @ T)
    r = residuals(rgb, C)
    freedom = max(count - UNKNOWNS, 1)
    near = r[accepted]
    variance = float(near @ near) / freedom
    L = _element_map(T)
    bread = L @ np.linalg.pinv(gram, hermitian=True)
    covariance = variance * bread @ observed @ bread.T  # variance (MᵀM)⁻¹ where no bias was subtracted; never negative
    s0, r2 = spread or _spread(r)
    return Fit(
        C=C,
        s0=s0,
        r2=r2,
        residual=r,
        accepted=accepted,
        coefficients=_coefficients(elements_of(C), np.sqrt(np.diag(covariance)), freedom, confidence),
        covariance=covariance,
    )


def definiteness(rgb: np.ndarray, accepted: np.ndarray, noise: float) -> float:
    """Signal-to-noise ratio of the direction of z that the ``accepted`` (N,) of the colours (N, 3) determine worst.

    ``noise`` is the standard deviation of a channel, picture units. The ratio is about 1 where only noise keeps MᵀM
    from being singular: then more than one quadric passes through the true colours, as for a cone, all of whose normals
    lie on one circle.
    """
    T = whitening(rgb, accepted)
    gram, right = normal_equations(rgb, T, accepted)
    clean, _ = without_noise(gram, right, int(accepted.sum()), noise**2 * (T @ T.T))
    worst = np.linalg.eigh(gram)[1][:, 0]
    return float(np.sqrt(worst @ gram @ worst / max(abs(worst @ (gram - clean) @ worst), 1e-300)))


def _least_squares(rgb: np.ndarray, T: np.ndarray, keep: np.ndarray) -> np.ndarray:
    """C (3, 3) in picture units, from the normal equations of Eq. (10) in the whitened colours."""
    gram, right = normal_equations(rgb, T, keep)
    return T.T @ matrix_of(np.linalg.lstsq(gram, right)[0]) @ T


def _coefficients(
    z: np.ndarray, stderr: np.ndarray, freedom: int, confidence: float
) -> tuple[dict[str, float | str], ...]:
    """Name, value, standard error, confidence limits and t = value / standard error of each element of z. Report 2.2

    z (6,) are the elements of C in the order of COEFFICIENTS, ``stderr`` (6,) their standard errors in the same units,
    ``freedom`` the degrees of freedom of Student's t, and ``confidence`` the probability of the limits, such as 0.95.
    """
    half_width = float(stdtrit(freedom, 0.5 + confidence / 2)) * stderr
    with np.errstate(divide="ignore", invalid="ignore"):
        t = z / stderr
    low, high = z - half_width, z + half_width
    rows = zip(COEFFICIENTS, z.tolist(), stderr.tolist(), low.tolist(), high.tolist(), t.tolist())
    return tuple(dict(zip(("name", "value", "stderr", "low", "high", "t"), row)) for row in rows)


def _element_map(T: np.ndarray) -> np.ndarray:
    """The (6, 6) matrix that takes the elements of W to those of TᵀWT."""
    return np.stack([elements_of(T.T @ matrix_of(unit) @ T) for unit in np.eye(UNKNOWNS)], axis=-1)


def _require_ellipsoid(C: np.ndarray) -> np.ndarray:
    if not (np.isfinite(C).all() and np.linalg.eigvalsh(C)[0] > 0):
        raise RecoveryFailure("no-ellipsoid", "the best quadric is not an ellipsoid about black")
    return C


def _spread(residual: np.ndarray) -> tuple[float, float]:
    """(s0, R²) of ``dispersion`` and ``determination``."""
    typical = float(middle(np.abs(residual)))
    return float(F_CONSISTENCY) * (1 + 5 / (len(residual) - UNKNOWNS)) * typical, 1 - typical**2


def middle(sizes: np.ndarray, unknowns: int = UNKNOWNS) -> np.ndarray:
    """The h-th least along the last axis of ``sizes`` (…, N), |r| or r²; h as of ``half``."""
    h = half(sizes.shape[-1], unknowns)
    return np.partition(sizes, h - 1, axis=-1)[..., h - 1]


def half(count: int, unknowns: int = UNKNOWNS) -> int:
    """h = ⌊N/2⌋ + ⌊(p + 1)/2⌋ of N = ``count`` residuals for p ``unknowns``, as in [17]; at most N."""
    return min(count, count // 2 + (unknowns + 1) // 2)


def _sample(rgb: np.ndarray, T: np.ndarray, size: int) -> np.ndarray:
    """At most ``size`` of the colours, evenly spaced in their rank by |Tρ|: independent of units and pixel order."""
    pool = rgb[:: max(1, len(rgb) // RANKED_PIXELS)].astype(np.float64)
    rank = np.argsort(np.einsum("ni,ni->n", pool @ (T @ T), pool))
    chosen = np.linspace(0, len(rank) - 1, min(size, len(rank))).round().astype(int)
    return pool[rank[chosen]]


def _elemental_ellipsoids(M: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The exact fits z (K, 6) through random sets of six rows of M that are ellipsoids, after least squares on all."""
    sixes = M[rng.integers(0, len(M), (ELLIPSOID.elemental_trials, UNKNOWNS))]
    # A set that holds a pixel twice is singular. The small multiple of the identity makes nearly all of these solvable,
    # with fits that rank low; those that remain singular are dropped.
    sixes += 1e-13 * np.eye(UNKNOWNS)
    sixes = sixes[np.linalg.slogdet(sixes).sign != 0]
    z = np.linalg.solve(sixes, np.ones((len(sixes), UNKNOWNS, 1)))[..., 0]
    z = z[np.isfinite(z).all(axis=1)]
    z = z[np.linalg.eigvalsh(matrix_of(z))[:, 0] > 0]
    over_all_rows = np.linalg.lstsq(M, np.ones(len(M)))[0][None]
    return np.concatenate([over_all_rows, z])


def _concentrate(M: np.ndarray, candidates: np.ndarray, kept: int, steps: int) -> np.ndarray:
    """The ``kept`` candidates (K, 6) with the least median r² on M (n, 6), each after ``steps`` C-steps there."""
    h = half(len(M))
    candidates = candidates[np.argsort(middle(np.abs(candidates @ M.T - 1)), kind="stable")[:kept]]
    for _ in range(steps):
        nearest = np.argpartition(np.abs(candidates @ M.T - 1), h - 1, axis=-1)[:, :h]
        half_M = M[nearest]
        gram = half_M.transpose(0, 2, 1) @ half_M + 1e-14 * np.eye(UNKNOWNS)
        # A half of few distinct colours, as in flat patches of 8-bit pictures, may still be singular.
        gram[np.linalg.slogdet(gram).sign <= 0] += 1e-9 * np.eye(UNKNOWNS)
        moved = np.linalg.solve(gram, half_M.sum(axis=1)[..., None])[..., 0]
        if np.allclose(moved, candidates, rtol=1e-12, atol=0):
            break
        candidates = moved
    return candidates


def _concentrate_all(rgb: np.ndarray, C: np.ndarray, T: np.ndarray) -> np.ndarray:
    """C (3, 3), picture units, after C-steps over all pixels from ``C``."""
    size = np.abs(residuals(rgb, C))
    typical = float(middle(size))
    for _ in range(ELLIPSOID.concentration_stages[-1][2]):
        moved = _least_squares(rgb, T, size <= typical)
        size = np.abs(residuals(rgb, moved))
        moved_typical = float(middle(size))
        if not moved_typical < typical:
            break
        gain = 1 - (moved_typical / typical) ** 2
        C, typical = moved, moved_typical
        if gain < LEAST_GAIN:
            break
    return C
