"""The picture without interreflection: the light that the object's parts send each other follows from its surface.

A matte surface looks equally bright from everywhere, so that the picture L is itself the radiosity (up to one factor,
which cancels). If K gathers light over the hemisphere of each pixel (``render.relief``), a share α K L of it came by
way of other pixels, α being the effective albedo of the channel, and D = L − α K L is the direct light alone: all
bounces are removed at once, whatever their number. So: estimate the surface from L, build K, fit α together with the
ellipsoid of D, estimate the surface from D, and so on until nothing moves. One α a channel is exact where the
reflectance is the same at all wavelengths of the channel; elsewhere α stands for the mean of the reflectance.

Limits: light from surfaces that the camera does not see is not in K, and gaps between the pixels of the estimate are
interpolated by a smooth surface.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage

from huesphere.recover.depth.integration import depth_from_normals
from huesphere.recover.ellipsoid.distance import residual_scales, signed_distance
from huesphere.recover.geometry.rays import height_of, of_relief, of_surface, rays
from huesphere.recover.interreflection.albedo import Albedo, fit_albedo
from huesphere.recover.interreflection.parameters import INTERREFLECTION
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.solution import Solution
from huesphere.render.dataset import Observation
from huesphere.render.relief import gather_without_kernel
from huesphere.scenes.surfaces import depth_normals

# The first round from a completed surface is taken before an earlier one up to this multiple of the latter's scatter.
COMPLETION_HEAD_START = 1.5

# A later round is taken before an earlier one up to this multiple of its scatter: it is nearer to convergence, and
# which of two such rounds has the less scatter is decided by noise.
AS_GOOD = 1.05

# From the round ``rounds_for_sure`` on another one follows only where the scatter fell below this (times that before).
SCATTER_MUST_FALL_TO = 0.9

# The first rounds gather light from so few azimuths: their surface has far larger errors than that causes. It takes so
# many pixels on the object for the error of the gathered light to average out.
ROUGH_AZIMUTHS, MANY_PIXELS = 12, 16_000

STEEPEST_N3 = 0.08  # Least n3 of the normals that gather light; steeper ones count as if they had it.

TWIN_PIXELS = 4000  # Twins are compared on the picture at half its size if it has at least so many object pixels.

# A last round from a completed surface is not taken where its rotation has a standard error larger by the first factor,
# or an albedo differs from that of the rounds before by the second; albedos count as LEAST_ALBEDO at least.
LESS_SURE_ROTATION, OTHER_ALBEDO, LEAST_ALBEDO = 1.5, 1.3, 0.05

SETTLED_DEG = 0.01  # Median turn of the normals at which the rounds have converged (degrees).

ROUNDS_WITHOUT_GAIN = 3  # Rounds without a better one after which they end.

ROUNDING = 2e-7  # A smaller misfit counts as this: single precision holds no more (share of the brightest channel).

LEAST_SHARE = 1e-5  # Share of the picture's light below which indirect light counts as none, and decides nothing.

EVIDENCE = "interreflection"  # as the evidence for convex or concave

Recoverer = Callable[[Observation], Estimate]
Completer = Callable[[Estimate, Observation, np.ndarray], Estimate]
Restart = Callable[[Observation, np.ndarray], Estimate]  # of a picture, from an ellipsoid C (3, 3) near the right one


class IndirectLight(NamedTuple):
    """What a surface predicts of the light that its parts send each other."""

    gathered: np.ndarray  # (H, W, 3) K L, picture units
    fit: Albedo


@dataclass(frozen=True)
class Removal:
    """How much indirect light was subtracted, and how much better the ellipsoid fits without it."""

    albedo: np.ndarray  # (3,) effective, of each channel
    stderr: np.ndarray  # (3,) of it, from the scatter about the ellipsoid
    share: float  # of the picture's light that was subtracted
    misfit_before: float  # robust scale of the distance to the ellipsoid, picture units, with nothing subtracted
    misfit_after: float  # the same with the indirect light subtracted
    rounds: int  # number of the round that was taken, from 1
    turn_deg: float  # median turn of the normals in the last round
    twin_ratio: float  # misfit (after rounds: scatter) of the other solution over that of the one taken; 1: no evidence

    @property
    def gain(self) -> float:
        """How many times less misfit there is with the indirect light subtracted."""
        return self.misfit_before / self.misfit_after

    def record(self) -> dict[str, Any]:
        """As JSON, for the diagnostics; a standard error is null where a surface sends itself no light."""
        record = {name: np.asarray(value).tolist() for name, value in asdict(self).items()}
        return record | {"stderr": [error if np.isfinite(error) else None for error in self.stderr.tolist()]}

    def noted(self, estimate: Estimate) -> Estimate:
        """The estimate of the direct light, with this removal in its diagnostics."""
        return replace(estimate, diagnostics=estimate.diagnostics | {"interreflection": self.record()})


class DirectLight(NamedTuple):
    """The picture without its indirect light, and the estimate of it."""

    estimate: Estimate
    observation: Observation  # the picture itself where nothing was subtracted
    removal: Removal | None  # None: nothing was subtracted


def remove_interreflection(
    observation: Observation,
    recover: Recoverer,
    complete: Completer | None = None,
    *,
    first: Estimate | None = None,
    least_gain: float = 0.0,
    restart: Restart | None = None,
) -> DirectLight:
    """The estimate from the direct light alone.

    ``recover`` is a method for pictures without interreflection, ``first`` its estimate of this picture, if known.
    ``complete``, if given, fills the gaps of an estimate (estimate, picture that it was made from, light that was
    subtracted) after the first ``rough_rounds``, so that K is that of a surface without gaps. ``restart``, if given,
    takes the place of ``recover`` in the rounds: it begins with the ellipsoid fitted together with the albedos, where a
    new search may find that of other pixels. Nothing is subtracted where no round is ``ok``, or where the first surface
    lessens the misfit by a factor below ``least_gain``.
    """
    first = recover(observation) if first is None else first
    restart = restart if restart is not None else lambda direct, C: recover(direct)
    unchanged = DirectLight(first, observation, None)
    if not has_surface(first):
        return unchanged
    rgb = observation.rgb.astype(np.float64)
    if first.status == "ok" and _only_noise(first, rgb):
        return unchanged
    twin = other_solution(first, 0.0, EVIDENCE)
    own, other = (_indirect_light(one, observation, rgb, _rough_azimuths(observation)) for one in (first, twin))
    least_gain = least_gain if first.status == "ok" else max(least_gain, INTERREFLECTION.rescue_gain)
    if min(own.fit.after, other.fit.after) * least_gain > own.fit.before:
        return unchanged
    if max(_share(one, rgb, observation.mask) for one in (own, other)) < LEAST_SHARE:
        return unchanged
    floor = max(ROUNDING, _shortening(first)) * float(rgb[observation.mask].max())
    if own.fit.before < floor:
        return unchanged
    # Misfit by the twin over that by the first estimate: beyond ``clear``, or below its inverse, it decides.
    ratio, clear = max(other.fit.after, floor) / max(own.fit.after, floor), INTERREFLECTION.twin_gain
    starts: list[tuple[Estimate, IndirectLight]] = [(first, own), (twin, other)]
    ends: list[DirectLight | None] | None = None
    if 1 / clear < ratio < clear and other.fit.after < INTERREFLECTION.twin_worth_rounds * own.fit.before:
        # The first round of a poor surface decides little: a groove is far from what its colours show first.
        small = _halved(observation)
        coarse = starts if small is observation else _starts_on(small, first, recover)
        reached = [_rounds(small, restart, complete, *start) for start in coarse]
        scatter = [_scatter(start[0] if end is None else end.estimate) for start, end in zip(coarse, reached)]
        ratio = max(scatter[1], floor) / max(scatter[0], floor) if scatter else 1.0
        clear = INTERREFLECTION.twin_gain_after_rounds
        ends = reached if small is observation else None
    turned = ratio * clear < 1
    ratio = 1 / max(ratio, 1e-300) if turned else ratio
    best = ends[turned] if ends else _rounds(observation, restart, complete, *starts[turned])
    if best is None or best.removal is None or not _may_replace(first, best.estimate):
        return unchanged
    if best.removal.share < LEAST_SHARE:
        return unchanged
    estimate = best.estimate
    if turned:
        estimate = _with_margin(estimate, 1 - 1 / ratio)
    return DirectLight(estimate, best.observation, replace(best.removal, twin_ratio=ratio))


def remove_once_more(
    observation: Observation, restart: Restart, found: Estimate, completed: Sequence[Estimate], removal: Removal
) -> DirectLight | None:
    """One more round, from a ``completed`` surface of the estimate ``found``, if that predicts the light better.

    Of several surfaces the one is taken that leaves the least misfit. Noise of the surface is noise of K, and a surface
    that was fitted to all pixels together has less of it. None where the misfit of the inliers hardly falls, or the
    round is not ``ok``, its rotation is less certain or its albedos are others: errors of shadowed pixels are errors of
    K too.
    """
    rgb = observation.rgb.astype(np.float64)
    indirect = min((_indirect_light(one, observation, rgb) for one in completed), key=lambda one: one.fit.after)
    if indirect.fit.after > INTERREFLECTION.once_more_below * removal.misfit_after:
        return None
    ratio = np.maximum(indirect.fit.alpha, LEAST_ALBEDO) / np.maximum(removal.albedo, LEAST_ALBEDO)
    if np.abs(np.log(ratio)).max() > np.log(OTHER_ALBEDO):
        return None
    again = _round(observation, restart, found, indirect, removal.rounds + 1, removal.twin_ratio)
    if again is None or again.estimate.status != "ok":
        return None
    sure = again.estimate.rotation_stderr_deg <= LESS_SURE_ROTATION * found.rotation_stderr_deg
    return again if sure else None


def _shortening(estimate: Estimate) -> float:
    """By how much the mean of the normals within a pixel is shorter than 1: the median of Σ |∂n|² / 24.

    ∂n is the change from pixel to pixel along an axis, and a coordinate within a pixel has the variance 1 / 12. A pixel
    has the colour of the mean normal, so misfits of this size (share of the brightest channel) tell nothing of indirect
    light.
    """
    square = np.zeros(estimate.valid.shape)
    for axis in (0, 1):
        square += (np.gradient(np.nan_to_num(estimate.normals.astype(np.float64)), axis=axis) ** 2).sum(axis=-1)
    inner = ndimage.binary_erosion(estimate.valid & estimate.inlier)
    return float(np.median(square[inner])) / 24 if inner.any() else 0.0


def _share(indirect: IndirectLight, rgb: np.ndarray, mask: np.ndarray) -> float:
    """Share of the light of the picture ``rgb`` (H, W, 3) that is ``indirect``, over the object ``mask``."""
    return float((indirect.fit.alpha * indirect.gathered[mask]).sum() / max(rgb[mask].sum(), 1e-300))


def _median_turn_deg(one: Estimate, other: Estimate) -> float:
    """Median angle between the normals of two estimates, degrees; NaN where they have no pixel in common."""
    both = one.valid & other.valid
    if not both.any():
        return float("nan")
    cosine = np.sum(one.normals[both] * other.normals[both], axis=-1)
    return float(np.degrees(np.median(np.arccos(np.clip(cosine, -1, 1)))))


def _starts_on(observation: Observation, first: Estimate, recover: Recoverer) -> list[tuple[Estimate, IndirectLight]]:
    """The estimate of the ``observation`` and its twin, each with the indirect light that its surface predicts.

    The picture is a smaller one than that of ``first``; the one of the two that is nearer to ``first`` comes before the
    other. An empty list where there is no surface.
    """
    found = recover(observation)
    if not has_surface(found):
        return []
    step = first.valid.shape[0] // observation.mask.shape[0]
    rows, columns = observation.mask.shape
    sampled = slice(0, rows * step, step), slice(0, columns * step, step)
    found = _alike(found, replace(first, normals=first.normals[sampled], valid=first.valid[sampled]))
    rgb = observation.rgb.astype(np.float64)
    twins = found, other_solution(found, 0.0, EVIDENCE)
    return [(one, _indirect_light(one, observation, rgb, _rough_azimuths(observation))) for one in twins]


def _rough_azimuths(observation: Observation) -> int:
    """Number of azimuths around each pixel in which light is gathered in rounds whose surface a later one replaces."""
    return ROUGH_AZIMUTHS if observation.mask.sum() >= MANY_PIXELS else INTERREFLECTION.azimuths


def _halved(observation: Observation) -> Observation:
    """The picture at half its size, by means of two by two pixels; as it is if under TWIN_PIXELS pixels would remain.

    A mean is on the object where all of its four pixels are. An odd last row or column is dropped, and so are the known
    lights of the observation.
    """
    if observation.mask.sum() < 4 * TWIN_PIXELS:
        return observation
    height, width = (side // 2 for side in observation.mask.shape)
    rgb = observation.rgb[: 2 * height, : 2 * width].reshape(height, 2, width, 2, 3)
    mask = observation.mask[: 2 * height, : 2 * width].reshape(height, 2, width, 2)
    camera = observation.camera
    means = rgb.mean(axis=(1, 3))
    if camera.saturation is not None:  # a clipped pixel makes its mean too small
        means = np.where((rgb >= camera.saturation).any(axis=(1, 3)), camera.saturation, means)
    return Observation(
        means,
        np.asarray(mask.all(axis=(1, 3))),
        camera.of_means(2),
    )


def _rounds(
    observation: Observation,
    restart: Restart,
    complete: Completer | None,
    found: Estimate,
    indirect: IndirectLight,
) -> DirectLight | None:
    """The round of least scatter, from the estimate ``found`` and the light it predicts; None if the first fails."""
    best: DirectLight | None = None
    rgb = observation.rgb.astype(np.float64)
    direct, scatter, best_round = observation, np.inf, 0
    for number in range(INTERREFLECTION.most_rounds):
        rough = complete is None or number < INTERREFLECTION.rough_rounds
        if number:
            surface = found if complete is None or rough else complete(found, direct, rgb - direct.rgb)
            azimuths = _rough_azimuths(observation) if number < INTERREFLECTION.rough_rounds else None
            indirect = _indirect_light(surface, observation, rgb, azimuths)
        again = _round(observation, restart, found, indirect, number + 1, 1.0)
        if again is None or again.removal is None:
            break
        found, direct, turn_deg = again.estimate, again.observation, again.removal.turn_deg
        first_completed = complete is not None and number == INTERREFLECTION.rough_rounds
        worth = COMPLETION_HEAD_START if first_completed else 1.0  # a surface without gaps predicts the light better
        if best is None or _badness(found, worth * AS_GOOD) <= _badness(best.estimate):
            best, best_round = again, number + 1
        falls = _scatter(found) < SCATTER_MUST_FALL_TO * scatter
        scatter = _scatter(found)
        since = number + 1 - best_round
        if turn_deg < SETTLED_DEG or since >= ROUNDS_WITHOUT_GAIN:
            break
        if number + 1 >= INTERREFLECTION.rounds_for_sure and not falls:
            break
    return best


def _round(
    observation: Observation,
    restart: Restart,
    before: Estimate,
    indirect: IndirectLight,
    number: int,
    twin_ratio: float,
) -> DirectLight | None:
    """The estimate of the picture less the ``indirect`` light; None where it has no surface.

    ``before``: the estimate of the last round, whose choice between the twins is kept.
    """
    fit = indirect.fit
    rgb = observation.rgb.astype(np.float64)
    subtracted = fit.alpha * indirect.gathered
    direct = replace(observation, rgb=(rgb - subtracted).astype(np.float32))
    again = restart(direct, fit.C)
    if not has_surface(again):
        return None
    again = _alike(again, before)
    share = float(subtracted[observation.mask].sum() / rgb[observation.mask].sum())
    turn = _median_turn_deg(again, before)
    return DirectLight(
        again, direct, Removal(fit.alpha, fit.stderr, share, fit.before, fit.after, number, turn, twin_ratio)
    )


def residual_parts(estimate: Estimate, rgb: np.ndarray) -> tuple[float, float]:
    """(white, spatially correlated) parts of the distance of the inliers' colours to the ellipsoid, picture units.

    ``rgb`` (H, W, 3) is the picture that the estimate was made from. See ``recover.ellipsoid.distance``.
    """
    inlier = estimate.inlier
    return residual_scales(signed_distance(rgb[inlier].astype(np.float64), _solution(estimate).C), inlier)


def _only_noise(estimate: Estimate, rgb: np.ndarray) -> bool:
    """Whether the residual is white: that of interreflection is spatially correlated.

    The test is needed for noisy pictures of hills. The twin, a hollow, predicts indirect light that is nearly the same
    everywhere; to subtract it lessens all distances to the ellipsoid, though there is no such light.
    """
    white, correlated = residual_parts(estimate, rgb)
    return correlated < INTERREFLECTION.correlated_is_noise * white


def has_surface(estimate: Estimate) -> bool:
    """Whether there are normals to build K on: interreflection may be just what the method fails for."""
    return bool(estimate.valid.any()) and estimate.solution is not None


def _solution(estimate: Estimate) -> Solution:
    """The estimate's solution. Raises ValueError where it has none; ask ``has_surface`` first."""
    if estimate.solution is None:
        raise ValueError(f"an estimate with a solution is needed, got status {estimate.status}")
    return estimate.solution


def _may_replace(first: Estimate, found: Estimate) -> bool:
    """Whether ``found`` may replace ``first``; where that failed, only with a rotation that is certain."""
    certain = first.status == "ok" or found.rotation_stderr_deg < INTERREFLECTION.rescue_rotation_deg
    return found.status == "ok" and certain


def _badness(estimate: Estimate, worth: float = 1.0) -> tuple[bool, float]:
    """What rounds are ranked by, the least being best: whether the method failed, then scatter over ``worth``."""
    return estimate.status != "ok", _scatter(estimate) / worth


def _scatter(estimate: Estimate) -> float:
    """Robust scale of the distance of the inliers to the ellipsoid, picture units."""
    return _solution(estimate).fit_noise


def other_solution(estimate: Estimate, margin: float, evidence: str) -> Estimate:
    """The convex/concave twin of an estimate, taken by that ``evidence`` with that ``margin``."""
    solution = _solution(estimate)
    turn = solution.convexity.turn
    return replace(
        estimate,
        normals=(estimate.normals @ turn.T).astype(np.float32),
        solution=solution.other(margin, evidence),
    )


def _with_margin(estimate: Estimate, margin: float) -> Estimate:
    solution = _solution(estimate)
    return replace(estimate, solution=replace(solution, convexity=replace(solution.convexity, margin=margin)))


def _alike(estimate: Estimate, before: Estimate) -> Estimate:
    """The estimate or its twin, whichever is nearer to ``before``, with the margin and the evidence of ``before``."""
    both = estimate.valid & before.valid
    agreement = np.sum(estimate.normals[both][:, :2] * before.normals[both][:, :2])
    chosen = _solution(before).convexity
    if agreement < 0:
        return other_solution(estimate, chosen.margin, chosen.evidence)
    solution = _solution(estimate)
    convexity = replace(solution.convexity, margin=chosen.margin, evidence=chosen.evidence)
    return replace(estimate, solution=replace(solution, convexity=convexity))


def _indirect_light(
    estimate: Estimate, observation: Observation, rgb: np.ndarray, azimuths: int | None = None
) -> IndirectLight:
    """The light that the estimate's surface predicts, with albedos fitted to the inliers.

    ``rgb`` (H, W, 3): the picture with all its light. ``azimuths`` as of ``gathered_light``.
    """
    gathered = gathered_light(estimate.normals, estimate.valid, observation, rgb, azimuths)
    inlier = estimate.inlier & observation.mask
    return IndirectLight(gathered, fit_albedo(rgb[inlier], gathered[inlier]))


def gathered_light(
    normals: np.ndarray,
    valid: np.ndarray,
    observation: Observation,
    rgb: np.ndarray,
    azimuths: int | None = None,
) -> np.ndarray:
    """K applied to the picture ``rgb`` (H, W, 3), on the surface of ``normals`` (H, W, 3), known where ``valid``.

    Zero off the mask of the ``observation``, which gives the camera. ``azimuths``: directions about each pixel;
    None: as many as the parameters say.
    """
    mask, ray = observation.mask, rays(observation.camera, observation.mask.shape)
    focal_px = None if ray is None else observation.camera.focal_px
    own = of_relief(normals.astype(np.float64), ray)
    relief = depth_from_normals(own, valid, mask)
    between = depth_normals(np.where(mask, relief, 0.0), mask)
    normals = np.where(valid[..., None], own, between)
    normals = np.where(mask[..., None] & np.isfinite(normals), normals, [0.0, 0.0, 1.0])
    normals[..., 2] = np.maximum(normals[..., 2], STEEPEST_N3)
    normals = of_surface(normals, ray)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    height = np.where(mask, height_of(relief, focal_px), 0.0)
    out = np.zeros_like(rgb)
    azimuths = INTERREFLECTION.azimuths if azimuths is None else azimuths
    out[mask] = gather_without_kernel(height, mask, normals, rgb[mask], azimuths=azimuths, focal_px=focal_px)
    return out
