"""Metrics of normal maps: angular errors, coverage, and the error of the best possible 3×3 matrix for comparison.

Every column of metrics.csv is a field of ``Row`` and is computed here. What was not scored is NaN, never 0: a pixel
for which a method gives no normal is left out of its errors and lowers its coverage. Docs: docs/evaluate.md.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import scipy.linalg

from huesphere.eval.align import TWIN, best_orthogonal
from huesphere.recover.reasons import Reason
from huesphere.recover.status import DOUBTS

NAN = float("nan")
FLOOR_PIXELS = 6000  # most pixels on which ``linear_floor`` searches its matrix
# Columns within_… of a Row and their limits in degrees
WITHIN_DEG = {"within_1": 1.0, "within_5": 5.0, "within_11_25": 11.25, "within_22_5": 22.5, "within_30": 30.0}


SHARES = {  # columns share_… of a Row, and the reasons whose pixels each counts
    "all_lit": [Reason.ALL_LIT],
    "misses_lights": [Reason.MISSES_LIGHTS],
    "irradiance_map": [Reason.IRRADIANCE_MAP],
    "interpolated": [
        Reason.INTERPOLATED,
        Reason.INTERPOLATED_SATURATED,
        Reason.INTERPOLATED_DARK,
        Reason.INTERPOLATED_NOT_FINITE,
    ],
}


@dataclass(frozen=True)
class Row:
    """One (config, transport, method): a line of metrics.csv. Errors in degrees, shares from 0 to 1, NaN: not known."""

    config: str
    transport: str
    method: str
    status: str  # "ok", a method's named failure, "missing" (no estimate on disk) or the item's own status ("failed")
    pixels: float = NAN  # object pixels: those of the truth's mask
    scored: float = NAN  # object pixels where the method gives a normal
    coverage: float = NAN  # scored / pixels
    mean_deg: float = NAN  # this and the next nine: over the scored pixels
    median_deg: float = NAN
    p90_deg: float = NAN
    p95_deg: float = NAN
    rms_deg: float = NAN
    within_1: float = NAN  # share of the scored pixels whose error is below 1 degree; likewise the next four
    within_5: float = NAN
    within_11_25: float = NAN
    within_22_5: float = NAN
    within_30: float = NAN
    median_deg_flip: float = NAN  # the smaller median of the estimate and its convex/concave twin
    median_deg_gauge: float = NAN  # median after the best orthogonal alignment to the truth
    oracle_linear_median_deg: float = NAN  # over all object pixels, of the best single matrix: see linear_floor
    cond_F: float = NAN  # condition number of the colour matrix: how much the picture's noise is magnified
    seconds: float = NAN  # the method's own time
    accepted: float = NAN  # scored pixels that the method accepts as inliers of its ellipsoid
    accepted_median_deg: float = NAN  # median error over the accepted pixels
    stated_median_deg: float = NAN  # median over the scored pixels of the error that the method itself states
    # Shares of the object's pixels by the reason that the method gives for their normal (recover.reasons):
    share_all_lit: float = NAN  # the pixel sees every light
    share_misses_lights: float = NAN  # the pixel misses some of the lights found, and the others explain its colour
    share_irradiance_map: float = NAN  # the normal is from a smooth map of colours by normals
    share_interpolated: float = NAN  # the normal is interpolated between the pixel's neighbours
    # Median error by what the light does at a pixel, each pixel of one kind (eval.regions):
    lit_median_deg: float = NAN  # it sees all of every light
    attached_shadow_median_deg: float = NAN  # it is turned away from a light
    cast_shadow_median_deg: float = NAN  # the surface hides a light from it
    interpolated_median_deg: float = NAN  # the method interpolated its normal, whatever the light does there
    within_stated: float = NAN  # share of the scored pixels whose error is at most the one that the method states
    verdict: str = ""  # "trust", "doubtful" or "failed", as the method says of its own result; "" without a result
    message: str = ""
    knows: str = ""  # what a reference method is given beyond one picture (eval.references); "" for all others

    @property
    def label(self) -> str:
        """The method's name as tables for people show it, with what it knows."""
        return f"{self.method} [{self.knows}]" if self.knows else self.method


COLUMNS = tuple(field.name for field in fields(Row))


def compared(row: Row) -> bool:
    """Whether a result counts where methods are compared: it is scored, and ok or doubted by the verdict alone."""
    return (row.status == "ok" or row.status in DOUBTS) and row.scored > 0


def angular_error_deg(estimate: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return the angle in degrees between vectors of any length, (..., 3) against (..., 3) -> (...), in float64.

    atan2(|a × b|, a · b) keeps its digits near 0 and 180 degrees, where arccos(a · b) loses half of them: in single
    precision arccos cannot tell 0.02 degrees from 0. A vector that is zero or not finite has no direction: NaN.
    """
    a0, a1, a2 = (np.asarray(estimate[..., i], dtype=np.float64) for i in range(3))
    b0, b1, b2 = (np.asarray(truth[..., i], dtype=np.float64) for i in range(3))
    # By components: NumPy's reductions over an axis of three take several times as long.
    with np.errstate(invalid="ignore", over="ignore"):
        cross = np.sqrt((a1 * b2 - a2 * b1) ** 2 + (a2 * b0 - a0 * b2) ** 2 + (a0 * b1 - a1 * b0) ** 2)
        dot = a0 * b0 + a1 * b1 + a2 * b2
        angle = np.degrees(np.arctan2(cross, dot))
    return np.where(np.isfinite(dot) & ((cross != 0) | (dot != 0)), angle, NAN)


def error_image(normals: np.ndarray, valid: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return the angular error in degrees, (H, W) float64, NaN off the object and where the method gives no normal.

    Args:
        normals, truth: (H, W, 3), camera frame.
        valid: (H, W) bool, where the method gives a normal.
        mask: (H, W) bool, the object.
    """
    error = np.full(mask.shape, NAN)
    given = np.flatnonzero(valid & mask)
    error.ravel()[given] = angular_error_deg(_at(normals, given), _at(truth, given))
    return error


def quantiles(values: np.ndarray, shares: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return the quantiles of finite (N,) ``values`` at ``shares`` from 0 to 1, linear between order statistics.

    ``np.quantile`` with its default method, by one sort: NumPy sorts several times as fast as it selects.
    """
    return np.interp(np.asarray(shares) * (values.size - 1), np.arange(values.size), np.sort(values))


def error_columns(error_deg: np.ndarray) -> dict[str, Any]:
    """Return mean, median, percentiles, root mean square and shares below thresholds of (N,) errors; {} where N = 0."""
    if error_deg.size == 0:
        return {}
    median, p90, p95 = quantiles(error_deg, [0.5, 0.9, 0.95])
    columns = {
        "mean_deg": error_deg.mean(),
        "median_deg": median,
        "p90_deg": p90,
        "p95_deg": p95,
        "rms_deg": np.sqrt(np.mean(error_deg**2)),
    }
    columns |= {name: np.mean(error_deg < limit) for name, limit in WITHIN_DEG.items()}
    return {name: float(value) for name, value in columns.items()}


def measure(
    row: Row,
    error_deg: np.ndarray,
    normals: np.ndarray,
    truth: np.ndarray,
    mask: np.ndarray,
    inlier: np.ndarray,
    stated_deg: np.ndarray,
) -> Row:
    """Return ``row`` with every column filled that compares one estimate with the truth.

    Args:
        row: names and status, and what the picture alone gives.
        error_deg: (H, W) of ``error_image``.
        normals, truth: (H, W, 3), camera frame.
        mask, inlier: (H, W) bool, the object; what the method holds to lie on its ellipsoid.
        stated_deg: (H, W), the error that the method itself expects.
    """
    scored = np.flatnonzero(np.isfinite(error_deg))
    pixels, given = int(mask.sum()), scored.size
    row = replace(row, pixels=pixels, scored=given, coverage=given / pixels if pixels else NAN)
    if not given:
        return row
    n, n_true, error = _at(normals, scored), _at(truth, scored), error_deg.ravel()[scored]
    accepted = error[inlier.ravel()[scored]]
    columns = error_columns(error)
    twin, aligned = n @ TWIN, n @ best_orthogonal(n, n_true).T
    return replace(
        row,
        **columns,
        median_deg_flip=min(columns["median_deg"], median(angular_error_deg(twin, n_true))),
        median_deg_gauge=median(angular_error_deg(aligned, n_true)),
        accepted=accepted.size,
        accepted_median_deg=median(accepted),
        stated_median_deg=median(stated_deg.ravel()[scored]),
        within_stated=_share_within(error, stated_deg.ravel()[scored]),
    )


def _share_within(error_deg: np.ndarray, stated_deg: np.ndarray) -> float:
    """Share of the pixels with a stated error whose error is at most that; NaN if none has one."""
    told = np.isfinite(stated_deg)
    return float(np.mean(error_deg[told] <= stated_deg[told])) if told.any() else NAN


def reason_shares(row: Row, reason: np.ndarray | None, mask: np.ndarray) -> Row:
    """Return ``row`` with its columns share_…, from the ``reason`` (H, W) of each pixel's normal.

    ``reason`` has the codes of ``recover.reasons``; with None the columns stay NaN. ``mask`` (H, W) is the object.
    """
    if reason is None or not mask.any():
        return row
    own = reason[mask]
    columns: dict[str, Any] = {f"share_{name}": float(np.isin(own, codes).mean()) for name, codes in SHARES.items()}
    return replace(row, **columns)


def linear_floor(colours: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the best single matrix G (3, 3) from colours to directions of normals, and its median error in degrees.

    No method that maps each colour by one matrix, n = Gρ / |Gρ|, can have a smaller error. The search is deterministic:

    1. ordinary least squares, min Σ |Gρ − n|²;
    2. 15 rounds of reweighting toward the least *mean* angle: weight 1 / angle;
    3. 15 rounds of concentration toward the least *median* angle: only the better half of the pixels counts.

    Each round of 2 and 3 maximises the weighted mean of cos²∠(Gρ, n) in closed form (``_best_direction_map``). Of all
    rounds the G of least median error is returned. The problem has local minima, so the result is an upper bound of
    the least possible error, in practice a close one. The search uses at most ``FLOOR_PIXELS`` evenly spaced pixels;
    the returned error is over all.

    Args:
        colours: (N, 3) of all object pixels; a black pixel has no direction and counts as 180 degrees wrong.
        normals: (N, 3) unit, the truth at those pixels.
    """
    step = -(-len(colours) // FLOOR_PIXELS)
    rho, n = colours[::step].astype(np.float64), normals[::step].astype(np.float64)
    Gt, *_ = np.linalg.lstsq(rho, n, rcond=None)
    G = best_G = Gt.T
    best = np.inf
    rho, n = rho.T.copy(), n.T.copy()  # (3, N) from here on: sums over pixels run along memory
    pairs = _outer(n), _outer(rho)
    for round_ in range(31):
        angle = _angle_to_unit(G @ rho, n)
        middle = median(angle)
        if middle < best:
            best_G, best = G, middle
        weight = 1.0 / np.maximum(angle, 1e-5) if round_ < 15 else (angle <= middle).astype(np.float64)
        G = _best_direction_map(rho, n, pairs, weight, G)
    every = angular_error_deg(colours @ best_G.T, normals)
    return best_G, median(np.nan_to_num(every, nan=180.0))


def colour_condition(F: np.ndarray) -> float:
    """Return the condition number of F (3, 3) in ρ = F n, by which noise of the colours is magnified in the normals.

    Infinite for a rank below 3.
    """
    return float(np.linalg.cond(np.asarray(F, dtype=np.float64)))


def fit_colour_matrix(colours: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return F (3, 3) in ρ = F n, fitted to colours (N, 3) and true normals (N, 3) by least trimmed squares.

    The first fit uses all pixels; each of 20 more uses the half with the smallest residuals before, so that pixels
    that miss a light drop out. For pictures whose truth has no F.
    """
    rho, n = colours.astype(np.float64), normals.astype(np.float64)
    keep = np.ones(len(rho), dtype=bool)
    for _ in range(20):
        Ft, *_ = np.linalg.lstsq(n[keep], rho[keep], rcond=None)
        residual = np.linalg.norm(rho - n @ Ft, axis=1)
        keep = residual <= np.median(residual)
    return Ft.T


def median(values: np.ndarray) -> float:
    """Return the median of the finite ones of ``values`` (N,); NaN if there are none."""
    finite = np.sort(values[np.isfinite(values)])
    below, above = (finite.size - 1) // 2, finite.size // 2
    return float(finite[below] + finite[above]) / 2 if finite.size else NAN


def _at(image: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Return the vectors (N, 3) of an (H, W, 3) image at flat indices (N,)."""
    return image.reshape(-1, 3).take(index, axis=0)


def _outer(v: np.ndarray) -> np.ndarray:
    """Return v vᵀ of each column of (3, N), flat: (9, N)."""
    return (v[:, None] * v[None, :]).reshape(9, -1)


def _best_direction_map(
    rho: np.ndarray, n: np.ndarray, pairs: tuple[np.ndarray, np.ndarray], weight: np.ndarray, G: np.ndarray
) -> np.ndarray:
    """Return the matrix G' (3, 3) that maximises Σ w (n · G'ρ)² / Σ w |G'ρ|², with w = weight / |Gρ|².

    At G' = G this ratio is the weighted mean of cos² of the angle between Gρ and n, so G' brings the directions Gρ
    closer to the normals. Numerator and denominator are quadratic forms in the nine entries of G', and their ratio is
    largest at an eigenvector of a generalised 9×9 eigenproblem.

    Args:
        rho, n: (3, N) colours and unit normals.
        pairs: n nᵀ and ρ ρᵀ of each pixel, (9, N) each, which the caller computes once for all rounds.
        weight: (N,) weights of the pixels.
        G: (3, 3) the matrix of the last round.
    """
    length = _dot(G @ rho, G @ rho)
    w = weight / np.maximum(length, 1e-12 * length.max())
    nn, rr = pairs
    # Entry (i, a) of G', flattened, is row or column 3 i + a of both forms.
    numerator = ((w * nn) @ rr.T).reshape(3, 3, 3, 3)  # [i, j, a, b] = Σ w n_i n_j ρ_a ρ_b
    numerator = numerator.transpose(0, 2, 1, 3).reshape(9, 9)  # [3 i + a, 3 j + b]
    denominator = np.einsum("ij,ab->iajb", np.eye(3), (rr @ w).reshape(3, 3)).reshape(9, 9)
    denominator += 1e-14 * np.trace(denominator) * np.eye(9)  # with colours of rank below 3 it would be singular
    _, vectors = scipy.linalg.eigh(numerator, denominator, subset_by_index=[8, 8])
    G_new = vectors[:, 0].reshape(3, 3)
    return G_new if median(_dot(G_new @ rho, n)) >= 0 else -G_new


def _angle_to_unit(vectors: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """Return the angle (N,) in radians between vectors (3, N) and unit vectors (3, N), from the chord between them.

    π for the zero vector.
    """
    length = np.sqrt(_dot(vectors, vectors))
    difference = vectors / np.where(length > 0, length, 1.0) - unit
    chord = np.sqrt(_dot(difference, difference))
    return np.where(length > 0, 2.0 * np.arcsin(np.minimum(chord / 2.0, 1.0)), np.pi)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return a · b of each column of (3, N)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
