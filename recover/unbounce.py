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
from typing import Any

import numpy as np

from recover.depth import depth_from_normals
from recover.estimate import Estimate
from recover.polish import signed_distance
from recover.twin import TWIN
from render.dataset import Observation
from render.relief import gather_direct
from scenes.surfaces import depth_normals

AZIMUTHS = 24
STEEPEST = 0.08  # least n_z of the normals that gather light
ROUNDS, PATIENCE = 12, 3  # at most so many, and so many without a better one
ROUGH_ROUNDS, WHOLE_ROUNDS = 2, 4  # with gaps bridged by a smooth surface, then with every pixel's own normal
HEAD_START = 1.5  # times the scatter of the rounds before that the first round of those may have
SETTLED_DEG = 0.01  # median turn of the normals from round to round
FIRST_ALBEDO = 0.3
CLEARER = 1.3  # times the other's misfit: the twin is taken (a shallow dent and its bump: 4.8 and 80)
BY_LIGHT = "interreflection"
FIT_STEPS = 30
BREAKDOWN = 2.385  # of the robust scale: Cauchy's, at which the fit keeps 95 % efficiency

Explained = tuple[np.ndarray, tuple[np.ndarray, np.ndarray, float, float]]  # K L (H, W, 3), and what `fit_albedo` gives


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
    twin_ratio: float  # misfit of the surface turned inside out over that of the one taken, first round; 1: no evidence

    def told(self) -> dict[str, Any]:
        """For the diagnostics' ``interreflection``."""
        return {name: np.asarray(value).tolist() for name, value in asdict(self).items()}


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
    anew: that with the least scatter of its pixels about the ellipsoid is given. None where the first estimate fails
    already, or its surface lessens the misfit by a factor below ``least_gain``: then that estimate is returned.
    """
    found = first = estimate(observation) if first is None else first
    if found.status != "ok":
        return found, observation, None
    best: tuple[Estimate, Observation, Reflected] | None = None
    reflected = None
    rgb = observation.rgb.astype(np.float64)
    direct = observation
    found, twin_ratio, explained = _likelier_twin(found, observation.mask, rgb)
    if explained[1][2] < least_gain * explained[1][3]:
        return first, observation, None
    as_first = found.diagnostics["twin"]
    for number in range(ROUNDS):
        if reflected is not None:
            surface = found if whole is None or number < ROUGH_ROUNDS else whole(found, direct, rgb - direct.rgb)
            explained = _explained(surface, observation.mask, rgb, reflected.albedo)
        gathered, (albedo, stderr, before, after) = explained
        taken = albedo * gathered
        direct = replace(observation, rgb=(rgb - taken).astype(np.float32))
        again = estimate(direct)
        if again.status != "ok":
            break
        if as_first["evidence"] == BY_LIGHT:
            again = _as_first(again, found)
        both = again.valid & found.valid
        cosine = np.sum(again.normals[both] * found.normals[both], axis=-1)
        turn = float(np.degrees(np.median(np.arccos(np.clip(cosine, -1, 1)))))
        share = float(taken[observation.mask].sum() / rgb[observation.mask].sum())
        reflected = Reflected(albedo, stderr, share, before, after, number + 1, turn, twin_ratio)
        found = again
        worth = HEAD_START if whole is not None and number == ROUGH_ROUNDS else 1.0  # a surface without gaps knows more
        if best is None or _noise(found) < worth * _noise(best[0]):
            best = found, direct, reflected
        if turn < SETTLED_DEG or reflected.rounds - best[2].rounds >= PATIENCE:
            break
        if whole is not None and reflected.rounds >= ROUGH_ROUNDS + WHOLE_ROUNDS:
            break
    return (first, observation, None) if best is None else best


def _noise(estimate: Estimate) -> float:
    """What the estimate's own pixels scatter about its ellipsoid, picture units."""
    return float(estimate.diagnostics["noise"]["from_fit"])


def _likelier_twin(estimate: Estimate, mask: np.ndarray, rgb: np.ndarray) -> tuple[Estimate, float, Explained]:
    """The estimate or its twin, n → diag(−1, −1, 1) n: which of them sends itself the light that the picture shows.

    Both explain direct light alike, and the outline may be out of sight. The wrong one gains next to nothing from its
    own interreflection, so where one gains clearly it is taken. Also how many times larger the other's misfit is,
    and what `_explained` gives of the one that is taken.
    """
    start = np.full(3, FIRST_ALBEDO)
    turned = flipped(estimate, 0.0, BY_LIGHT)
    as_is, as_turned = (_explained(one, mask, rgb, start) for one in (estimate, turned))
    own, other = as_is[1][-1], as_turned[1][-1]
    if own > CLEARER * other:
        return flipped(estimate, 1 - other / own, BY_LIGHT), own / other, as_turned
    return estimate, other / max(own, 1e-300), as_is


def flipped(estimate: Estimate, margin: float, evidence: str) -> Estimate:
    """The convex/concave twin of an estimate; what is told of the choice is ``margin`` and ``evidence``."""
    told = estimate.diagnostics
    return replace(
        estimate,
        normals=(estimate.normals @ TWIN).astype(np.float32),
        diagnostics=told
        | {
            "F": (np.asarray(told["F"]) @ TWIN).tolist(),
            "rotation": (TWIN @ np.asarray(told["rotation"])).tolist(),
            "twin": {"flipped": not told["twin"]["flipped"], "margin": margin, "evidence": evidence},
        },
    )


def _as_first(estimate: Estimate, first: Estimate) -> Estimate:
    """The estimate or its twin, whichever is nearer to ``first``, whose reason for the choice it keeps."""
    both = estimate.valid & first.valid
    across = np.sum(estimate.normals[both][:, :2] * first.normals[both][:, :2])
    told = first.diagnostics["twin"]
    if across < 0:
        return flipped(estimate, told["margin"], told["evidence"])
    twin = {**estimate.diagnostics["twin"], "margin": told["margin"], "evidence": told["evidence"]}
    return replace(estimate, diagnostics=estimate.diagnostics | {"twin": twin})


def _explained(estimate: Estimate, mask: np.ndarray, rgb: np.ndarray, start: np.ndarray) -> Explained:
    """K L (H, W, 3) on the surface of the estimate, and what `fit_albedo` makes of it on the accepted pixels."""
    gathered = _gathered(estimate, mask, rgb)
    fit = estimate.inlier & mask
    return gathered, fit_albedo(rgb[fit], gathered[fit], np.asarray(estimate.diagnostics["C"]), start)


def _gathered(estimate: Estimate, mask: np.ndarray, rgb: np.ndarray) -> np.ndarray:
    """K applied to the picture (H, W, 3), on the surface of the estimate; 0 off the mask."""
    depth = depth_from_normals(estimate.normals.astype(np.float64), estimate.valid, mask)
    own = depth_normals(np.where(mask, depth, 0.0), mask)
    normals = np.where(estimate.valid[..., None], estimate.normals, own)
    normals = np.where(mask[..., None] & np.isfinite(normals), normals, [0.0, 0.0, 1.0])
    normals[..., 2] = np.maximum(normals[..., 2], STEEPEST)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    out = np.zeros_like(rgb)
    out[mask] = gather_direct(np.where(mask, depth, 0.0), mask, normals, rgb[mask], azimuths=AZIMUTHS)
    return out


def fit_albedo(
    rgb: np.ndarray, gathered: np.ndarray, C: np.ndarray, start: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float, float]:
    """(α (3,), its standard error (3,), misfit at α = 0, misfit at α): ρᵀCρ = 1 for ρ = L − α K L.

    ``rgb`` and ``gathered`` (P, 3) are L and K L of pixels of one ellipsoid. Gauss–Newton on the Sampson distances in C
    and α together, nine unknowns, Cauchy weights. The misfits are robust scales of the distance, picture units.
    """
    *_, before = _fit(rgb, np.zeros_like(gathered), C, np.zeros(3))
    alpha, stderr, after = _fit(rgb, gathered, C, start)
    return alpha, stderr, before, after


def _fit(
    rgb: np.ndarray, gathered: np.ndarray, C: np.ndarray, alpha: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """(α, standard error, robust scale)."""
    i, j = np.triu_indices(3)
    alpha, scale = alpha.astype(float), 0.0
    normal, size = np.eye(9), np.ones(9)
    for _ in range(FIT_STEPS):
        rho = rgb - alpha * gathered
        slope = 2 * np.linalg.norm(rho @ C, axis=1)
        distance = signed_distance(rho, C)
        scale = 1.4826 * float(np.median(np.abs(distance)))
        weight = 1 / (1 + (distance / max(BREAKDOWN * scale, 1e-12)) ** 2)
        by_C = rho[:, i] * rho[:, j] * np.where(i == j, 1.0, 2.0) / slope[:, None]
        by_alpha = -2 * (rho @ C) * gathered / slope[:, None]
        jacobian = np.concatenate([by_C, by_alpha], axis=1)
        size = np.sqrt(np.mean(jacobian**2, axis=0)) + 1e-30
        scaled = jacobian / size
        normal = (scaled * weight[:, None]).T @ scaled
        step = np.linalg.lstsq(normal, -(scaled * weight[:, None]).T @ distance, rcond=1e-12)[0] / size
        C = C.copy()
        C[i, j] += step[:6]
        C[j, i] = C[i, j]
        moved = np.clip(alpha + step[6:], 0.0, 1.0)
        change = np.abs(moved - alpha).max()
        alpha = moved
        if change < 1e-6:
            break
    stderr = scale * np.sqrt(np.abs(np.diag(np.linalg.pinv(normal)))[6:]) / size[6:]
    return alpha, stderr, scale
