"""Interreflection taken out of a picture: the surface that it shows tells how much light its parts sent each other.

The picture L is itself the radiosity (up to one factor, which cancels): if K gathers light over the hemisphere of each
pixel (``render.relief``), a share α K L of it came by way of other pixels, α being the effective albedo of the channel,
and D = L − α K L is the direct light alone: all bounces are gone at once, whatever their number. So estimate the
surface from L, build K, fit α together with the ellipsoid of D, estimate the surface from D, and so on until nothing
moves. One α a channel is exact where a reflectance is the same at all wavelengths of the channel, and stands for its
mean elsewhere.

Light from surfaces that the camera does not see is not in K, and what lies between the pixels of the estimate is
bridged by a smooth surface: these are the limits.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from huesphere.recover.depth.integration import depth_from_normals
from huesphere.recover.ellipsoid.distance import residual_scales, signed_distance
from huesphere.recover.geometry.rays import height_of, of_relief, of_surface, rays
from huesphere.recover.geometry.rotations import TWIN
from huesphere.recover.interreflection.albedo import Albedo, fit_albedo
from huesphere.recover.io.estimate import Estimate
from huesphere.render.dataset import Observation
from huesphere.render.relief import gather_direct
from huesphere.scenes.surfaces import depth_normals

AZIMUTHS = 24
STEEPEST = 0.08  # least n_z of the normals that gather light
ROUNDS, PATIENCE = 16, 3  # at most so many, and so many without a better one
SOME_ROUNDS, STILL_FALLS = 6, 0.9  # from so many on only while the scatter falls to this much of that before
ROUGH_ROUNDS = 2  # with gaps bridged by a smooth surface, then with every pixel's own normal
HEAD_START = 1.5  # times the scatter of the rounds before that the first round of those may have
SETTLED_DEG = 0.01  # median turn of the normals from round to round
CLOSER = 0.98  # times the misfit: another surface explains the light between the parts better
CLEARER = 1.3  # times the other's misfit: the twin is taken (a shallow dent and its bump: 4.8 and 80)
TEMPTING = 0.95  # of the misfit: a twin that leaves less of it is worth rounds of its own
RESCUING, SURE_DEG = 1.05, 10.0  # times less misfit that a failed estimate's surface leaves at least, and its rotation
SHARED = (
    0.2  # of the noise: less that neighbours share is none (hills at noise 3e-3 0 to 0.12, light between parts 0.7 on)
)
ENOUGH = 4000  # pixels that tell the twins apart
TOLD = 1.15  # times less scatter after all rounds: that twin is taken
BY_LIGHT = "interreflection"


class Explained(NamedTuple):
    """What a surface says of the light that its parts send each other."""

    gathered: np.ndarray  # (H, W, 3) K L
    fit: Albedo


@dataclass(frozen=True)
class Reflected:
    """What was taken out, and which twin it came from."""

    albedo: np.ndarray  # (3,) effective, of each channel
    stderr: np.ndarray  # (3,) of it, from the scatter about the ellipsoid
    share: float  # of the picture's light that was taken out
    misfit_before: float  # robust scale of the distance to the ellipsoid, picture units: without the term …
    misfit_after: float  # … and with it
    rounds: int
    turn_deg: float  # median turn of the normals in the last round
    twin_ratio: (
        float  # misfit, or scatter in the end, of the surface turned inside out over the one taken; 1: no evidence
    )

    def told(self) -> dict[str, Any]:
        """For the diagnostics' ``interreflection``; a standard error is null where a surface sends itself no light."""
        told = {name: np.asarray(value).tolist() for name, value in asdict(self).items()}
        return told | {"stderr": [error if np.isfinite(error) else None for error in self.stderr.tolist()]}

    def noted(self, estimate: Estimate) -> Estimate:
        """The estimate of what is left, with this in its diagnostics."""
        return replace(estimate, diagnostics=estimate.diagnostics | {"interreflection": self.told()})


def unbounce(
    observation: Observation,
    estimate: Callable[[Observation], Estimate],
    whole: Callable[[Estimate, Observation, np.ndarray], Estimate] | None = None,
    *,
    first: Estimate | None = None,
    least_gain: float = 0.0,
) -> tuple[Estimate, Observation, Reflected | None]:
    """The estimate from the direct light alone, the picture of it, and what was taken out.

    ``estimate`` is a method for pictures without interreflection, ``first`` what it says of this picture, if that is
    known. ``whole``, if given, makes normals of every pixel of an estimate and the picture that it is of, from the
    third round on: a surface without gaps, for K. The rounds do not quite stand still, for each selects its pixels
    anew: that with the least scatter of its pixels about the ellipsoid is given. None where no round is ``ok``, or
    the first surface lessens the misfit by a factor below ``least_gain``: then the first estimate is returned.
    """
    first = estimate(observation) if first is None else first
    if not has_surface(first):
        return first, observation, None
    rgb = observation.rgb.astype(np.float64)
    if first.status == "ok" and _only_noise(first, rgb):
        return first, observation, None
    twin = flipped(first, 0.0, BY_LIGHT)
    own, other = (_explained(one, observation, rgb) for one in (first, twin))
    least_gain = least_gain if first.status == "ok" else max(least_gain, RESCUING)
    if min(own.fit.after, other.fit.after) * least_gain > own.fit.before:
        return first, observation, None
    ratio, clear = other.fit.after / max(own.fit.after, 1e-300), CLEARER
    starts, ends = [(first, own), (twin, other)], None
    if 1 / CLEARER < ratio < CLEARER and other.fit.after < TEMPTING * own.fit.before:
        # From a poor surface the first round tells little: a groove is far from what its colours say first. Both go on.
        small = _halved(observation)
        coarse = starts if small is observation else _starts_like(first, small, estimate)
        reached = [_rounds(small, estimate, whole, *start) for start in coarse]
        scatter = [_noise(start[0] if end is None else end[0]) for start, end in zip(coarse, reached)]
        ratio, clear = (scatter[1] / max(scatter[0], 1e-300) if scatter else 1.0), TOLD
        ends = reached if small is observation else None
    turned = ratio * clear < 1
    ratio = 1 / max(ratio, 1e-300) if turned else ratio
    best = ends[turned] if ends else _rounds(observation, estimate, whole, *starts[turned])
    if best is None or not _better_than(first, best[0]):
        return first, observation, None
    found, direct, reflected = best
    if turned:
        told = found.diagnostics["twin"] | {"margin": 1 - 1 / ratio}
        found = replace(found, diagnostics=found.diagnostics | {"twin": told})
    return found, direct, replace(reflected, twin_ratio=ratio)


def once_more(
    observation: Observation,
    estimate: Callable[[Observation], Estimate],
    found: Estimate,
    finished: Estimate,
    reflected: Reflected,
) -> tuple[Estimate, Observation, Reflected] | None:
    """A further round from the ``finished`` surface of what `unbounce` ``found``, if that explains the light better.

    Noise spoils the surfaces of the rounds, and so K; one that was fitted to all pixels together has less of it. None
    where the misfit of the accepted pixels hardly falls, or the round is not ``ok``.
    """
    explained = _explained(finished, observation, observation.rgb.astype(np.float64))
    if explained.fit.after > CLOSER * reflected.misfit_after:
        return None
    again = _round(observation, estimate, found, explained, reflected.rounds + 1, reflected.twin_ratio)
    return again if again is not None and again[0].status == "ok" else None


def _turn_deg(one: Estimate, other: Estimate) -> float:
    """Median angle between the normals of two estimates."""
    both = one.valid & other.valid
    cosine = np.sum(one.normals[both] * other.normals[both], axis=-1)
    return float(np.degrees(np.median(np.arccos(np.clip(cosine, -1, 1)))))


def _starts_like(
    first: Estimate, observation: Observation, estimate: Callable[[Observation], Estimate]
) -> list[tuple[Estimate, Explained]]:
    """The estimate of a picture of fewer pixels than ``first`` has, and its twin, in the order of ``first``.

    Each with what its surface explains; none where there is no surface to begin with.
    """
    found = estimate(observation)
    if not has_surface(found):
        return []
    step = first.valid.shape[0] // observation.mask.shape[0]
    rows, columns = observation.mask.shape
    sampled = slice(0, rows * step, step), slice(0, columns * step, step)
    found = _as_before(found, replace(first, normals=first.normals[sampled], valid=first.valid[sampled]))
    rgb = observation.rgb.astype(np.float64)
    return [(one, _explained(one, observation, rgb)) for one in (found, flipped(found, 0.0, BY_LIGHT))]


def _halved(observation: Observation) -> Observation:
    """Means of two by two pixels that are all on the object; the picture as it is where that would leave few."""
    if observation.mask.sum() < 4 * ENOUGH:
        return observation
    height, width = (side // 2 for side in observation.mask.shape)
    rgb = observation.rgb[: 2 * height, : 2 * width].reshape(height, 2, width, 2, 3)
    mask = observation.mask[: 2 * height, : 2 * width].reshape(height, 2, width, 2)
    camera = observation.camera
    means = rgb.mean(axis=(1, 3))
    if camera.saturation is not None:  # one that is clipped spoils the mean
        means = np.where((rgb >= camera.saturation).any(axis=(1, 3)), camera.saturation, means)
    return Observation(
        means,
        np.asarray(mask.all(axis=(1, 3))),
        replace(
            camera,
            focal_px=None if camera.focal_px is None else camera.focal_px / 2,
            read_noise=camera.read_noise / 2,
            full_well=None if camera.full_well is None else 4 * camera.full_well,
            bits=None if camera.bits is None else camera.bits + 1,
        ),
    )


def _rounds(
    observation: Observation,
    estimate: Callable[[Observation], Estimate],
    whole: Callable[[Estimate, Observation, np.ndarray], Estimate] | None,
    found: Estimate,
    explained: Explained,
) -> tuple[Estimate, Observation, Reflected] | None:
    """The round of least scatter, from ``found`` and what its surface explains; None if the first fails."""
    best: tuple[Estimate, Observation, Reflected] | None = None
    rgb = observation.rgb.astype(np.float64)
    direct, scatter = observation, np.inf
    for number in range(ROUNDS):
        if number:
            surface = found if whole is None or number < ROUGH_ROUNDS else whole(found, direct, rgb - direct.rgb)
            explained = _explained(surface, observation, rgb)
        again = _round(observation, estimate, found, explained, number + 1, 1.0)
        if again is None:
            break
        found, direct, reflected = again
        worth = HEAD_START if whole is not None and number == ROUGH_ROUNDS else 1.0  # a surface without gaps knows more
        if best is None or _failed(found, worth) < _failed(best[0]):
            best = found, direct, reflected
        falls = _noise(found) < STILL_FALLS * scatter
        scatter = _noise(found)
        if reflected.turn_deg < SETTLED_DEG or reflected.rounds - best[2].rounds >= PATIENCE:
            break
        if number + 1 >= SOME_ROUNDS and not falls:
            break
    return best


def _round(
    observation: Observation,
    estimate: Callable[[Observation], Estimate],
    found: Estimate,
    explained: Explained,
    number: int,
    twin_ratio: float,
) -> tuple[Estimate, Observation, Reflected] | None:
    """The estimate of the picture less the light that is ``explained``, after ``found``; None: it has no surface."""
    fit = explained.fit
    rgb = observation.rgb.astype(np.float64)
    taken = fit.alpha * explained.gathered
    direct = replace(observation, rgb=(rgb - taken).astype(np.float32))
    again = estimate(direct)
    if not has_surface(again):
        return None
    again = _as_before(again, found)
    share = float(taken[observation.mask].sum() / rgb[observation.mask].sum())
    turn = _turn_deg(again, found)
    return again, direct, Reflected(fit.alpha, fit.stderr, share, fit.before, fit.after, number, turn, twin_ratio)


def left_over(estimate: Estimate, rgb: np.ndarray) -> tuple[float, float]:
    """(each pixel's own, shared by neighbours) of the distance of its pixels of ``rgb`` (H, W, 3) to its ellipsoid.

    Picture units, as ``residual_scales``.
    """
    C, accepted = np.asarray(estimate.diagnostics["C"]), estimate.inlier
    return residual_scales(signed_distance(rgb[accepted].astype(np.float64), C), accepted)


def _only_noise(estimate: Estimate, rgb: np.ndarray) -> bool:
    """Whether what colours are off their ellipsoid by is each pixel's own: light between the parts is shared.

    The light of a hollow is nearly the same everywhere: taken out of a hill's noisy picture it lessens all distances.
    """
    white, shared = left_over(estimate, rgb)
    return shared < SHARED * white


def has_surface(estimate: Estimate) -> bool:
    """Whether there are normals to build K on: light between the parts may be just what the method fails for."""
    return bool(estimate.valid.any()) and {"twin", "noise", "rotation"} <= estimate.diagnostics.keys()


def _better_than(first: Estimate, found: Estimate) -> bool:
    """Whether what was found may stand for ``first``; a failure of that is mended only by a rotation that is sure."""
    sure = first.status == "ok" or found.diagnostics["rotation_stderr_deg"] < SURE_DEG
    return found.status == "ok" and sure


def _failed(estimate: Estimate, worth: float = 1.0) -> tuple[bool, float]:
    """By which the least is the best: whether the method failed, then its scatter over what that is ``worth``."""
    return estimate.status != "ok", _noise(estimate) / worth


def _noise(estimate: Estimate) -> float:
    """What the estimate's own pixels scatter about its ellipsoid, picture units."""
    return float(estimate.diagnostics["noise"]["from_fit"])


def flipped(estimate: Estimate, margin: float, evidence: str) -> Estimate:
    """The convex/concave twin of an estimate; what is told of the choice is ``margin`` and ``evidence``.

    In perspective it is turned a little against diag(−1, −1, 1) n: the estimate's ``twin.turn`` tells how.
    """
    told = estimate.diagnostics
    turn = np.asarray(told["twin"].get("turn", TWIN))
    twin = {"flipped": not told["twin"]["flipped"], "margin": margin, "evidence": evidence}
    return replace(
        estimate,
        normals=(estimate.normals @ turn.T).astype(np.float32),
        diagnostics=told
        | {
            "F": (np.asarray(told["F"]) @ turn.T).tolist(),
            "rotation": (turn @ np.asarray(told["rotation"])).tolist(),
            "twin": twin | ({"turn": turn.T.tolist()} if "turn" in told["twin"] else {}),
        },
    )


def _as_before(estimate: Estimate, before: Estimate) -> Estimate:
    """The estimate or its twin, whichever is nearer to the one ``before``, whose reason for the choice it keeps."""
    both = estimate.valid & before.valid
    across = np.sum(estimate.normals[both][:, :2] * before.normals[both][:, :2])
    told = before.diagnostics["twin"]
    if across < 0:
        return flipped(estimate, told["margin"], told["evidence"])
    twin = {**estimate.diagnostics["twin"], "margin": told["margin"], "evidence": told["evidence"]}
    return replace(estimate, diagnostics=estimate.diagnostics | {"twin": twin})


def _explained(estimate: Estimate, observation: Observation, rgb: np.ndarray) -> Explained:
    """What the surface of the estimate says of the accepted pixels' colours."""
    gathered = _gathered(estimate, observation, rgb)
    fit = estimate.inlier & observation.mask
    return Explained(gathered, fit_albedo(rgb[fit], gathered[fit]))


def _gathered(estimate: Estimate, observation: Observation, rgb: np.ndarray) -> np.ndarray:
    """K applied to the picture (H, W, 3), on the surface of the estimate; 0 off the mask."""
    mask, ray = observation.mask, rays(observation.camera, observation.mask.shape)
    focal_px = None if ray is None else observation.camera.focal_px
    own = of_relief(estimate.normals.astype(np.float64), ray)
    relief = depth_from_normals(own, estimate.valid, mask)
    between = depth_normals(np.where(mask, relief, 0.0), mask)
    normals = np.where(estimate.valid[..., None], own, between)
    normals = np.where(mask[..., None] & np.isfinite(normals), normals, [0.0, 0.0, 1.0])
    normals[..., 2] = np.maximum(normals[..., 2], STEEPEST)
    normals = of_surface(normals, ray)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    height = np.where(mask, height_of(relief, focal_px), 0.0)
    out = np.zeros_like(rgb)
    out[mask] = gather_direct(height, mask, normals, rgb[mask], azimuths=AZIMUTHS, focal_px=focal_px)
    return out
