"""An estimate of a reduced picture taken back to the full size: every pixel from its own colour.

What is global is known: F, the lights, and which of them each block of pixels misses. A pixel is explained by the set
of missed lights, of those in the blocks about its own, whose ellipsoid its colour is nearest to (ρ = F_S n, report
Eq. 6), and its normal is that of the nearest point. Where the colour explains nothing, the normal of the reduced
picture is kept, interpolated.

A single pixel is noisier than the mean over its block. So of the difference d between a pixel's own normal and the
interpolated one, that share is kept which is not noise: N. Wiener's gain 1 − v/⟨|d|²⟩. The mean is taken over a window,
and v is the variance of the own normal: σ² tr((TᵀAT)⁻¹) = σ² (tr A − nᵀAn) / (nᵀ adj(A) n), with A = F_SᵀF_S, T a basis
of the tangent plane at n and σ the noise of a channel.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from huesphere.recover.geometry.reduction import Reduction, filled
from huesphere.recover.geometry.sphere import on_sphere
from huesphere.recover.geometry.tangent_uncertainty import DEG
from huesphere.recover.geometry.threads import in_threads
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.lights.model import numbered, tolerance, without
from huesphere.recover.pixels.noise import picture_noise
from huesphere.recover.pixels.usable import DARK
from huesphere.recover.reasons import Reason, interpolated
from huesphere.recover.solution import Solution
from huesphere.render.dataset import Observation

ROWS = 256  # of the picture, at least, that a thread works on at once: bounds the memory …
MOST_AT_ONCE = 4  # … with this number of threads
NOISE_PIXELS = 1_000_000  # of the picture, at most, from which its noise is measured
USUAL_QUANTILE = 0.98  # of the residuals of a set's blocks, up to which a pixel is explained by it
FLAT = 0.05  # smallest over largest singular value of a matrix: of flatter ellipsoids colour does not give the side
FARTHEST = 0.5  # |n − n'| between a pixel's own normal and the interpolated one, from which it costs as much as …
COST = 9.0  # … a residual of three tolerances


@dataclass(frozen=True)
class _Ellipsoid:
    """The colours of the pixels that miss the same lights."""

    missed: int  # bit j: light j is missed
    matrix: np.ndarray  # (3, 3) F_S
    within: float  # residual up to which a pixel is explained, picture units
    across: np.ndarray | None  # (3,) the direction of normals along which a flat ellipsoid has two sides
    blocks: np.ndarray  # (h, w) bool, blocks in or next to which pixels may miss these lights


@dataclass(frozen=True)
class _Coarse:
    """Images of the reduced picture without gaps: blocks off the object have the values of the nearest on it."""

    normals: np.ndarray  # (h, w, 3)
    valid: np.ndarray  # (h, w)
    reason: np.ndarray
    uncertainty: np.ndarray
    offset: np.ndarray  # (h, w, 3) light that is no part of F n: removed and ambient
    free_brightness: bool  # a pixel's colour is along F n, of any length


def at_full_size(small: Estimate, picture: Observation, observation: Observation, by: Reduction) -> Estimate:
    """The estimate of the ``observation`` from the estimate ``small`` of the ``picture`` that is it, reduced ``by``.

    Both pictures are in linear light. Verdict, doubts, steps and all that is no image stay as they are.
    """
    shape, small_mask = observation.mask.shape, picture.mask
    whole = replace(
        small,
        normals=np.full((*shape, 3), np.nan, np.float32),
        valid=np.zeros(shape, bool),
        inlier=np.zeros(shape, bool),
        uncertainty_deg=np.full(shape, np.nan, np.float32),
        depth=None,
        reason=np.zeros(shape, np.uint8),
        missed=None if small.missed is None else np.full(shape, -1, np.int32),
        albedo=None if small.albedo is None else np.full(shape, np.nan, np.float32),
        removed=None,
        steps=(*small.steps, _told(by)),
        diagnostics=small.diagnostics | {"reduction": {"factor": by.factor, "pixels": int(small_mask.sum())}},
    )
    assert whole.reason is not None
    if small.solution is None or not small.valid.any():
        reason = np.zeros(by.blocks, np.uint8) if small.reason is None else small.reason
        whole.reason[:] = by.nearest(filled(reason, small_mask), slice(None))
        whole.reason[~observation.mask] = Reason.BACKGROUND
        whole.reason[observation.mask & (whole.reason == Reason.BACKGROUND)] = Reason.NO_SOLUTION
        solution = small.solution and replace(small.solution, inlier=whole.inlier)
        return replace(whole, solution=solution)
    noise = _noise(observation, small.solution, by)
    coarse = _gapless(small, small_mask)
    ellipsoids = _ellipsoids(small, picture, coarse, noise)
    brightest = _brightest(observation)
    margin = 2 * by.factor + 1
    step = max(ROWS, 4 * margin)

    def fill(first: int) -> None:
        rows = slice(first, min(first + step, shape[0]))
        wide = slice(max(first - margin, 0), min(rows.stop + margin, shape[0]))
        inner = slice(rows.start - wide.start, rows.stop - wide.start)
        _fill(whole, rows, inner, _rows(observation, wide, by, coarse, ellipsoids, DARK * brightest, noise))

    in_threads(fill, range(0, shape[0], step), most=MOST_AT_ONCE)
    return replace(whole, solution=replace(small.solution, inlier=whole.inlier, noise=noise))


def _told(by: Reduction) -> str:
    return (
        f"size: lights, ellipsoid and rotation from means over {by.factor}×{by.factor} pixels; then every pixel from "
        "its own colour"
    )


def _noise(observation: Observation, solution: Solution, by: Reduction) -> float:
    """Standard deviation of a channel of the picture itself, measured about the middle of the object."""
    row, column = (int(np.median(index)) for index in np.nonzero(observation.mask))
    half = int(np.sqrt(NOISE_PIXELS)) // 2
    part = (slice(max(row - half, 0), row + half), slice(max(column - half, 0), column + half))
    rgb, mask = observation.rgb[part].astype(np.float64), observation.mask[part]
    usable = mask & np.isfinite(rgb).all(axis=-1)
    found = picture_noise(np.where(usable[..., None], rgb, 0.0), usable)
    return found if np.isfinite(found) else solution.noise * by.factor


def _brightest(observation: Observation) -> float:
    """The brightest percent of the object's pixels is brighter than this."""
    some = observation.rgb.max(axis=-1)[observation.mask]
    some = some[:: max(1, len(some) // NOISE_PIXELS)]
    return float(np.quantile(some[np.isfinite(some)], 0.99)) if np.isfinite(some).any() else 0.0


def _gapless(small: Estimate, mask: np.ndarray) -> _Coarse:
    assert small.solution is not None
    valid = small.valid & mask
    reason = np.where(valid, int(Reason.ALL_LIT), int(Reason.OUTLIER)) if small.reason is None else small.reason
    offset = np.zeros((*mask.shape, 3), np.float32) if small.removed is None else small.removed.astype(np.float32)
    return _Coarse(
        normals=filled(small.normals, valid),
        valid=filled(valid, mask),
        reason=filled(reason.astype(np.uint8), mask),
        uncertainty=filled(small.uncertainty_deg, valid)[..., None],
        offset=filled(offset, mask) + small.solution.ambient.astype(np.float32),
        free_brightness=small.albedo is not None,
    )


def _ellipsoids(small: Estimate, picture: Observation, coarse: _Coarse, noise: float) -> list[_Ellipsoid]:
    """Of the sets of missed lights that occur in the reduced ``picture``; the pixels that see every light first."""
    assert small.solution is not None
    F, lights = small.solution.F, () if small.lights is None else small.lights.found
    label = np.full(picture.mask.shape, -1)
    if small.missed is not None:
        shadowed = coarse.reason == Reason.MISSES_LIGHTS
        label[shadowed] = small.missed[shadowed]
    label[coarse.reason == Reason.ALL_LIT] = 0
    label[~(small.valid & picture.mask)] = -1
    least = tolerance(float(np.nanmax(picture.rgb[picture.mask])), noise)
    found = []
    for missed in sorted(int(one) for one in np.unique(label[label >= 0])):
        own, M = label == missed, without(F, lights, numbered(missed))
        values, axes = np.linalg.svd(M)[1:]
        brightness = 1.0 if small.albedo is None else small.albedo[own][:, None]
        residual = on_sphere((picture.rgb - coarse.offset)[own] / brightness, M)[1]
        found.append(
            _Ellipsoid(
                missed,
                M,
                max(least, float(np.quantile(residual, USUAL_QUANTILE))),
                axes[2] if values[2] < FLAT * values[0] else None,
                ndimage.binary_dilation(own, np.ones((3, 3))),
            )
        )
    return found


@dataclass(frozen=True)
class _Rows:
    """Some rows of the whole picture: what an ``Estimate`` says of them."""

    normals: np.ndarray
    valid: np.ndarray
    reason: np.ndarray
    missed: np.ndarray
    uncertainty: np.ndarray
    albedo: np.ndarray


def _rows(
    observation: Observation,
    rows: slice,
    by: Reduction,
    coarse: _Coarse,
    ellipsoids: list[_Ellipsoid],
    darkest: float,
    noise: float,
) -> _Rows:
    """Normals and reasons of some ``rows`` of the picture; colours of ``darkest`` or less have no direction."""
    rgb, mask = observation.rgb[rows], observation.mask[rows]
    lost = _lost(rgb, mask, observation.camera.saturation, darkest)
    usable = mask & (lost == 0)
    rho = np.where(usable[..., None], rgb - by.linear(coarse.offset, rows), 0.0).astype(np.float64)
    smooth = by.linear(coarse.normals.astype(np.float64), rows)
    smooth /= np.maximum(np.linalg.norm(smooth, axis=-1, keepdims=True), 1e-12)
    albedo = np.ones(usable.shape)
    if coarse.free_brightness:
        albedo[usable] = np.maximum(np.linalg.norm(rho[usable] @ np.linalg.inv(ellipsoids[0].matrix).T, axis=-1), 1e-12)
        rho /= albedo[..., None]
    own, missed, variance = _explained(rho, usable, smooth, ellipsoids, by, rows)
    explained, variance = missed >= 0, (noise / albedo) ** 2 * variance
    gain = _kept_share(np.where(explained[..., None], own - smooth, 0.0), variance, explained, by.factor)
    n = smooth + np.where(explained, gain, 0.0)[..., None] * (own - smooth)
    n /= np.maximum(np.linalg.norm(n, axis=-1, keepdims=True), 1e-12)
    stated = by.linear(coarse.uncertainty.astype(np.float64), rows)[..., 0]
    stated = np.hypot(stated, np.where(explained, DEG * np.sqrt(gain * variance), 0.0))

    valid, why = by.nearest(coarse.valid, rows) & mask, by.nearest(coarse.reason, rows)
    completes = bool((coarse.reason == Reason.INTERPOLATED).any())
    by_label = valid & ((why == Reason.ALL_LIT) | (why == Reason.MISSES_LIGHTS))
    reason = np.where(mask, why, int(Reason.BACKGROUND))
    reason[explained] = np.where(missed[explained] == 0, int(Reason.ALL_LIT), int(Reason.MISSES_LIGHTS))
    misfit = by_label & ~explained
    reason[misfit] = np.where(lost[misfit] > 0, lost[misfit], int(Reason.OUTLIER))
    if completes or (coarse.reason == Reason.IRRADIANCE_MAP).any():
        reason[misfit] = interpolated(reason[misfit])
    valid = (valid & ~misfit) | explained | (misfit & (reason >= Reason.INTERPOLATED) & (reason < Reason.OUTLIER))
    reason[mask & ~valid & (reason < Reason.OUTLIER)] = Reason.OUTLIER
    return _Rows(n, valid, reason, missed, stated, np.where(usable, albedo, np.nan))


def _lost(rgb: np.ndarray, mask: np.ndarray, saturation: float | None, darkest: float) -> np.ndarray:
    """Codes (R, W) of why a pixel of the object has no use; else 0."""
    lost = np.zeros(mask.shape, np.uint8)
    finite = np.isfinite(rgb).all(axis=-1)
    with np.errstate(invalid="ignore"):
        lost[finite & (rgb.max(axis=-1) <= darkest)] = Reason.DARK
        if saturation is not None:
            lost[finite & (rgb >= saturation).any(axis=-1)] = Reason.SATURATED
    lost[~finite] = Reason.NOT_FINITE
    lost[~mask] = 0
    return lost


def _explained(
    rho: np.ndarray, usable: np.ndarray, smooth: np.ndarray, ellipsoids: list[_Ellipsoid], by: Reduction, rows: slice
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(own normals (R, W, 3), missed lights (R, W), −1 where nothing explains the colour, variance of the normals).

    The variance is that of noise of deviation 1, picture units.
    """
    own, cost = smooth.copy(), np.full(usable.shape, np.inf)
    missed, variance = np.full(usable.shape, -1, np.int32), np.zeros(usable.shape)
    for one in ellipsoids:
        there = usable & by.nearest(one.blocks, rows)
        if not there.any():
            continue
        n, distance = on_sphere(rho[there], one.matrix)
        about = smooth[there]
        if one.across is not None:
            turned = n - 2 * (n @ one.across)[:, None] * one.across
            nearer = ((turned - about) ** 2).sum(axis=1) < ((n - about) ** 2).sum(axis=1)
            n[nearer] = turned[nearer]
        away = ((n - about) ** 2).sum(axis=1) / FARTHEST**2
        its_cost = np.where(distance < one.within, (distance / one.within) ** 2 * COST + away * COST, np.inf)
        better = its_cost < cost[there]
        taken = there.copy()
        taken[there] = better
        own[taken], cost[taken], missed[taken] = n[better], its_cost[better], one.missed
        variance[taken] = _variance(n[better], one.matrix)
    return own, missed, variance


def _variance(n: np.ndarray, F: np.ndarray) -> np.ndarray:
    """Variance (P,) of normals ``n`` (P, 3), nearest on the sphere, where each channel has noise of deviation 1."""
    A = F.T @ F
    adjugate = 0.5 * (np.trace(A) ** 2 - np.trace(A @ A)) * np.eye(3) - np.trace(A) * A + A @ A
    across = np.einsum("pi,ij,pj->p", n, adjugate, n)
    return (np.trace(A) - np.einsum("pi,ij,pj->p", n, A, n)) / np.maximum(across, 1e-300)  # type: ignore[no-any-return]


def _kept_share(detail: np.ndarray, variance: np.ndarray, explained: np.ndarray, factor: int) -> np.ndarray:
    """Wiener's gain (R, W) of the ``detail`` (R, W, 3) of normals over their ``variance``; 0 if not ``explained``."""
    size = 2 * factor + 1
    share = np.maximum(ndimage.uniform_filter(explained.astype(np.float64), size), 1e-9)
    power = ndimage.uniform_filter((detail**2).sum(axis=-1), size) / share
    return np.clip(1 - variance / np.maximum(power, 1e-30), 0.0, 1.0)  # type: ignore[no-any-return]


def _fill(whole: Estimate, rows: slice, inner: slice, found: _Rows) -> None:
    """Write the ``inner`` rows of what was found to ``rows`` of the images of the ``whole`` estimate."""
    valid = found.valid[inner]
    assert whole.reason is not None
    whole.valid[rows] = valid
    whole.normals[rows][valid] = found.normals[inner][valid]
    whole.uncertainty_deg[rows][valid] = found.uncertainty[inner][valid]
    whole.reason[rows] = found.reason[inner]
    whole.inlier[rows] = found.reason[inner] == Reason.ALL_LIT
    if whole.albedo is not None:
        whole.albedo[rows] = np.where(valid, found.albedo[inner], np.nan)
    if whole.missed is not None:
        whole.missed[rows] = np.where(valid, found.missed[inner], -1)
