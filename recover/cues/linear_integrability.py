"""Integrability of an ellipsoid's normals in a form that is linear in the unknown rotation; no depth is computed.

With n = O N and rows r1, r2, r3 of the orthogonal O, integrability p_y = q_x, multiplied by n3², is

    r1·(N × N_x) + r2·(N × N_y) = 0,

without any division, and linear in (r1, r2): one 6×6 matrix of sums over the pixels holds the error of every O. Along
the rays (x, y) of a picture in perspective (``recover.geometry.rays``) the condition is

    (r1 + x r3)·(N × N_x) + (r2 + y r3)·(N × N_y) = 0.

Two conditions exclude rotations O under which a wrong ellipsoid has a small error. All normals must face the camera.
And some must face it squarely, n = (0, 0, 1): since every light stands in front of the object, a pixel that faces the
camera squarely sees all lights, so it is an inlier of the right ellipsoid. A blend of two ellipsoids violates one or
the other. "Curl" below is the error of this condition over the size of its terms. Source: this project
(docs/recover/few-lit-pixels.md).
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from huesphere.recover.cues.parameters import CUES
from huesphere.recover.geometry.root import symmetric_root
from huesphere.recover.geometry.sphere import across, fibonacci
from huesphere.recover.pixels.parameters import PIXELS
from huesphere.recover.robust_scale import mad_scale

# Side of the square about a pixel that must lie within the inliers for its derivatives to be used (pixels).
INTERIOR_WINDOW_PX = 7

DIRECTIONS = 1000  # directions of r3 over the sphere, 6° apart: a quadrature grid
SAMPLED_PIXELS = 1000  # pixels of the sums, about: size of the work
REWEIGHTINGS = 3  # rounds of iteratively reweighted least squares
TURNS, NEWTON_STEPS = 48, 4  # about r3, in perspective: starts, and steps from the best to rounding
FALLBACK_WINDOW, FEWEST_INTERIOR = 5, 30  # pixels: side of the square and least count on small regions
NO_JUDGEMENT_ERROR = 9.0  # normalised curl put down where pixels are too few, as bad as of a wrong ellipsoid


@dataclass(frozen=True)
class Integrability:
    """How integrable the normals of an ellipsoid are under the rotation that suits them best."""

    curl: float  # root mean square of the error over that of its terms: 0 integrable, 1 as bad as chance
    normalised_curl: float  # median |error| over its standard deviation by noise: about 0.7 if the ellipsoid is right
    frontal: bool  # some rotation makes nearly all normals face the camera, and some of them squarely
    off_axis_deg: float  # angle of the nearest normal to (0, 0, 1) under the best rotation without that condition


def judge_integrability(
    rgb: np.ndarray, inlier: np.ndarray, C: np.ndarray, *, noise: float, ray: np.ndarray | None = None
) -> Integrability:
    """Integrability of the ellipsoid C (3, 3) from the pixels ``inlier`` (H, W) of the picture ``rgb`` (H, W, 3).

    ``noise``: standard deviation of a channel, picture units. ``ray`` (H, W, 2): of a picture in perspective.
    """
    h = symmetric_root(C)
    AB = _terms(rgb, inlier, h, ray)
    n = _unit_normals(rgb, inlier, h)
    faced, frontal = _directions(n)
    if not len(AB) or not len(frontal):
        return Integrability(1.0, NO_JUDGEMENT_ERROR, False, 90.0)
    derivative_noise = _derivative_noise(noise, C)
    variance = _error_variance(AB, derivative_noise)
    rows, error = _robustly_best(AB, variance, frontal)
    terms = _size(AB, rows)
    curl = float(np.sqrt((error**2).sum() / terms.sum()))
    # The bound of ``_error_variance`` for noise, with another share of the terms.
    expected = np.sqrt(2 * derivative_noise**2 + CUES.normalised_curl_error**2 * terms)
    normalised = float(np.median(np.abs(error) / expected))
    rows, _ = _robustly_best(AB, variance, faced)
    return Integrability(curl, normalised, True, off_axis_deg(np.abs(n @ np.cross(rows[:3], rows[3:6]))))


def curl_under_rotation(
    rotation: np.ndarray, rgb: np.ndarray, inlier: np.ndarray, C: np.ndarray, *, ray: np.ndarray | None = None
) -> float:
    """The ``curl`` of ``Integrability`` under a ``rotation`` R (3, 3), n = R C^{1/2} ρ; 1 where pixels are too few."""
    AB = _terms(rgb, inlier, symmetric_root(C), ray)
    if not len(AB):
        return 1.0
    rows = rotation.ravel()[: AB.shape[1]]
    return float(np.sqrt(((AB @ rows) ** 2).sum() / _size(AB, rows).sum()))


def _derivative_noise(noise: float, C: np.ndarray) -> float:
    """Root mean square error of the normals' derivative N_x, or N_y, by noise, in its part orthogonal to N; per pixel.

    ``noise``: standard deviation of a channel, picture units. ``C`` (3, 3): of the ellipsoid ρᵀCρ = 1. White noise in a
    picture that is smoothed by a Gaussian of σ pixels gives its derivatives the standard deviation
    d = noise / (√(8π) σ²). As N = C^{1/2} ρ is a unit vector, the error of N_x has the covariance d² C, and the part of
    that error orthogonal to N has the mean square d² (tr C − NᵀCN), which is (2/3) d² tr C in the mean over all
    directions of N.
    """
    sigma = CUES.derivative_sigma_px
    return noise / (np.sqrt(8 * np.pi) * sigma**2) * np.sqrt(np.trace(C) * 2 / 3)  # type: ignore[no-any-return]


def _error_variance(AB: np.ndarray, derivative_noise: float) -> np.ndarray:
    """Variance (P,) of the error AB · (r1, r2) of each pixel: by noise, and by derivatives over several pixels.

    The part of noise is an upper bound for every rotation: the errors δN of N_x and N_y are independent, and each of
    the two terms r · (N × δN) counts with the mean square of the whole vector N × δN. For C = c 𝟙 noise gives
    (1 + n3²) c d², with d as in ``_derivative_noise``: a quarter to a half of the bound, which is 4 c d².
    """
    size = np.einsum("pi,pi->p", AB[:, :6], AB[:, :6])
    return 2 * derivative_noise**2 + CUES.derivative_error**2 * size  # type: ignore[no-any-return]


def _size(AB: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Sum of squares (P,) of the four terms that make up the error AB · rows."""
    (r1, r2), A, B = rows[:6].reshape(2, 3), AB[:, :3], AB[:, 3:6]
    return (A @ r1) ** 2 + (B @ r2) ** 2 + (A @ r2) ** 2 + (B @ r1) ** 2  # type: ignore[no-any-return]


def off_axis_deg(cosine: np.ndarray, *, fewest: int = 3) -> float:
    """Off-axis angle of the normals that are nearest to the camera's direction, degrees.

    ``cosine`` (P,): of the angles between normals and the direction toward the camera. At least ``fewest`` normals, and
    ``frontal_share`` of all, are as near as the angle returned.
    """
    count = max(fewest, int(CUES.frontal_share * len(cosine)))
    return float(np.degrees(np.arccos(np.clip(np.sort(cosine)[-count], -1, 1))))


def likely_rotations(
    rgb: np.ndarray,
    inlier: np.ndarray,
    C: np.ndarray,
    *,
    noise: float,
    count: int,
    ray: np.ndarray | None = None,
) -> list[np.ndarray]:
    """Up to ``count`` rotations and as many reflections R (3, 3), n = R C^{1/2} ρ, of least curl, the best first.

    Those of one chirality are ``start_separation_deg`` apart. Arguments as for ``judge_integrability``. Where no
    rotation makes some normals face the camera squarely, that condition is dropped.
    """
    h = symmetric_root(C)
    AB = _terms(rgb, inlier, h, ray)
    faced, frontal = _directions(_unit_normals(rgb, inlier, h))
    if not len(AB) or not len(faced):
        return []
    variance = _error_variance(AB, _derivative_noise(noise, C))
    return _best_apart(AB, variance, frontal if len(frontal) else faced, count)


def _best_apart(AB: np.ndarray, variance: np.ndarray, r3: np.ndarray, count: int) -> list[np.ndarray]:
    """Up to ``count`` rotations, then as many reflections, of the least errors over all r3 (K, 3), apart in r3."""
    nearest = np.cos(np.radians(CUES.start_separation_deg))
    w = _robust_weights(AB @ _best(AB, 1 / variance, r3), variance)
    kept: list[np.ndarray] = []
    for chirality, rows, value in _best_about_each(AB, w, r3):
        own: list[np.ndarray] = []
        for k in np.argsort(value, kind="stable"):
            r1, r2 = rows[k, :6].reshape(2, 3)
            rotation = np.stack([r1, r2, chirality * np.cross(r1, r2)])
            if all(abs(rotation[2] @ other[2]) < nearest for other in own):
                own.append(rotation)
                if len(own) == count:
                    break
        kept += own
    return kept


def _robustly_best(AB: np.ndarray, variance: np.ndarray, r3: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(r1, r2) (6,) of the least error over all third rows r3 (K, 3), and its errors AB · (r1, r2) (P,).

    ``AB`` (P, 6): terms of ``integrability_terms``; ``variance`` (P,) of their errors. Least is the sum of the squared
    errors, with robust weights, over that of their terms. In perspective ``AB`` is (P, 9), and (r1, r2, r3) (9,) is
    returned.
    """
    w = 1 / variance
    for _ in range(REWEIGHTINGS):
        rows = _best(AB, w, r3)
        error = AB @ rows
        w = _robust_weights(error, variance)
    return rows, error


def _robust_weights(error: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Weights (P,) of Geman and McClure's redescending loss, for errors (P,) of that variance or more."""
    scale = max(1.0, mad_scale(error / np.sqrt(variance)))
    return 1 / variance / (1 + error**2 / variance / (CUES.robust_width * scale) ** 2) ** 2  # type: ignore[no-any-return]


def _unit_normals(rgb: np.ndarray, inlier: np.ndarray, h: np.ndarray) -> np.ndarray:
    """Unit vectors (P, 3) of h ρ at some of the pixels of ``inlier`` (H, W)."""
    some = rgb[inlier][:: max(1, int(inlier.sum() // SAMPLED_PIXELS))] @ h
    return some / np.linalg.norm(some, axis=1, keepdims=True)  # type: ignore[no-any-return]


def integrability_terms(
    rgb: np.ndarray, inlier: np.ndarray, h: np.ndarray, ray: np.ndarray | None, *, most: int = SAMPLED_PIXELS
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(terms (P, 6), row (P,), column (P,)) of about ``most`` pixels well within ``inlier``; P is 0 if too few are.

    The terms are (N × N_x, N × N_y) of N = h ρ, h (3, 3). In perspective (P, 9): the last three are the factors of r3.
    """
    sigma = CUES.derivative_sigma_px
    inside = ndimage.uniform_filter(inlier.astype(float), INTERIOR_WINDOW_PX) > 0.999
    if inside.sum() < PIXELS.fewest_pixels:
        inside = ndimage.binary_erosion(inlier, np.ones((FALLBACK_WINDOW, FALLBACK_WINDOW)))
    if inside.sum() < FEWEST_INTERIOR:
        return np.empty((0, 6)), np.empty(0, int), np.empty(0, int)
    chosen = np.flatnonzero(inside)[:: max(1, int(inside.sum() // most))]
    weight = np.maximum(ndimage.gaussian_filter(inlier.astype(float), sigma), 1e-6)[..., None]
    smooth = ndimage.gaussian_filter(np.where(inlier[..., None], rgb, 0.0), (sigma, sigma, 0)) / weight
    N_y, N_x = (g.reshape(-1, 3)[chosen] @ h.T for g in np.gradient(smooth, axis=(0, 1)))
    N = smooth.reshape(-1, 3)[chosen] @ h.T
    A, B = np.cross(N, N_x), -np.cross(N, N_y)  # rows run down, y up
    row, column = np.divmod(chosen, inlier.shape[1])
    if ray is None:
        return np.concatenate([A, B], axis=1), row, column
    x, y = ray.reshape(-1, 2)[chosen].T[:, :, None]
    return np.concatenate([A, B, x * A + y * B], axis=1), row, column


def _terms(rgb: np.ndarray, inlier: np.ndarray, h: np.ndarray, ray: np.ndarray | None) -> np.ndarray:
    """The terms (P, 6 or 9) of ``integrability_terms``, for a symmetric ``h``."""
    return integrability_terms(rgb, inlier, h, ray)[0]


def _directions(n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(r3 (K, 3) that nearly all normals face, those of these r3 (J, 3) that also some normals face squarely).

    ``n`` (P, 3): the vectors N of sampled pixels, scaled to unit length and not rotated yet. A row r3 is the camera's
    direction in their frame: after the rotation n3 = r3·N. The r3 tried are a fixed grid of unit vectors.
    """
    r3 = fibonacci(DIRECTIONS)
    cosine = n @ r3.T
    faced = (cosine > 0).mean(axis=0) >= CUES.camera_facing_share
    squarely = (cosine > np.cos(np.radians(CUES.frontal_deg))).sum(axis=0)
    near = squarely >= max(3, CUES.frontal_share * len(n))
    return r3[faced], r3[faced & near]


def _best(AB: np.ndarray, w: np.ndarray, r3: np.ndarray) -> np.ndarray:
    """(r1, r2) (6,), of either chirality, with the least weighted error over that of its terms, over all r3 (K, 3).

    In perspective (r1, r2, r3) (9,).
    """
    _, rows, value = min(_best_about_each(AB, w, r3), key=lambda entry: float(entry[2].min()))
    return rows[np.argmin(value)]  # type: ignore[no-any-return]


def _best_about_each(AB: np.ndarray, w: np.ndarray, r3: np.ndarray) -> list[tuple[float, np.ndarray, np.ndarray]]:
    """For either chirality, ±1: the best (r1, r2) (K, 6) about each r3 (K, 3) and its error over its terms (K,).

    In perspective (r1, r2, r3) (K, 9).
    """
    gram = (AB * w[:, None]).T @ AB
    terms = gram[:3, :3] + gram[3:6, 3:6]
    a, b = across(r3)
    scale = np.einsum("ki,ij,kj->k", a, terms, a) + np.einsum("ki,ij,kj->k", b, terms, b)
    found = []
    for chirality in (1.0, -1.0):
        # r1 = cos t a + sin t b, r2 = chirality (−sin t a + cos t b): the error is a quadratic form of (cos t, sin t).
        u, v = np.concatenate([a, chirality * b], axis=1), np.concatenate([b, -chirality * a], axis=1)
        if AB.shape[1] > 6:
            found.append((chirality, *_turned(gram, u, v, r3, scale)))
            continue
        uu, vv, uv = (np.einsum("ki,ki->k", s @ gram, t) for s, t in ((u, u), (v, v), (u, v)))
        least = (uu + vv) / 2 - np.hypot((uu - vv) / 2, uv)
        t = (0.5 * np.arctan2(-2 * uv, vv - uu))[:, None]  # where cos² uu + sin² vv + 2 sin cos uv is least
        found.append((chirality, np.cos(t) * u + np.sin(t) * v, least / scale))
    return found


def _turned(
    gram: np.ndarray, u: np.ndarray, v: np.ndarray, r3: np.ndarray, scale: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(cos t u + sin t v, r3) (K, 9) of least error, and that over ``scale`` (K,): a trigonometric polynomial in t."""
    still = np.concatenate([np.zeros_like(u), r3], axis=1)
    u, v = (np.concatenate([s, np.zeros_like(r3)], axis=1) for s in (u, v))
    uu, vv, uv, ud, vd, dd = (
        np.einsum("ki,ki->k", s @ gram, t)[:, None]
        for s, t in ((u, u), (v, v), (u, v), (u, still), (v, still), (still, still))
    )

    def error(t: np.ndarray) -> np.ndarray:
        c, s = np.cos(t), np.sin(t)
        return c * c * uu + s * s * vv + 2 * c * s * uv + 2 * c * ud + 2 * s * vd + dd  # type: ignore[no-any-return]

    around = np.arange(TURNS) * (2 * np.pi / TURNS)
    t = around[np.argmin(error(around), axis=1)][:, None]
    for _ in range(NEWTON_STEPS):
        c, s = np.cos(t), np.sin(t)
        slope = 2 * c * s * (vv - uu) + 2 * (c * c - s * s) * uv - 2 * s * ud + 2 * c * vd
        bend = 2 * (c * c - s * s) * (vv - uu) - 8 * c * s * uv - 2 * c * ud - 2 * s * vd
        step = np.where(bend > 0, -slope / np.where(bend > 0, bend, 1.0), 0.0)
        t = t + np.clip(step, -np.pi / TURNS, np.pi / TURNS)
    return np.cos(t) * u + np.sin(t) * v + still, np.maximum(error(t)[:, 0], 0.0) / scale
