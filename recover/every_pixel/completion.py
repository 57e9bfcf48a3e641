"""From the pixels that see every light to all pixels of the object: lights, shadow labels, and the joint fit of depth.

The order: estimate lights and surface jointly where noise hides single lights, else find the lights one by one; label
each pixel with the lights that it misses, and take its normal from its own colour; what no set of lights explains comes
from a smooth map of normals to colours, or from the surface between its neighbours; of noisy pictures depth and F are
fitted together at the end.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from huesphere.recover.depth.joint_fit import fit_again, fit_jointly
from huesphere.recover.depth.smoothness_prior import denoised
from huesphere.recover.ellipsoid.distance import residual_scales, signed_distance
from huesphere.recover.every_pixel.by_irradiance_map import map_error_deg, with_irradiance_map
from huesphere.recover.every_pixel.by_joint_lights import label_by_joint_lights, lights_of
from huesphere.recover.every_pixel.by_light_sets import (
    LabelledPixels,
    interpolated_normals,
    label_by_light_sets,
    with_explained_neighbours,
)
from huesphere.recover.every_pixel.leaning_on_colour import leaning_on_colour
from huesphere.recover.every_pixel.parameters import EVERY_PIXEL
from huesphere.recover.geometry.blocks import block_sums
from huesphere.recover.geometry.rays import facing_camera
from huesphere.recover.geometry.tangent_uncertainty import DEG, expected_length, tangent_frames
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.lights.from_shadows import find_lights
from huesphere.recover.lights.model import Light, Lights, numbered, without
from huesphere.recover.lights.parameters import LIGHTS
from huesphere.recover.lights.search import estimate_jointly
from huesphere.recover.pixels.uncertain_component import (
    nearest_normals_uncertain,
    squared_distance_uncertain,
    without_uncertain_part,
)
from huesphere.recover.pixels.usable import problem_of, usable_pixels
from huesphere.recover.problem import Problem
from huesphere.recover.reasons import Reason, interpolated
from huesphere.recover.solution import Solution
from huesphere.recover.status import RecoveryFailure
from huesphere.render.dataset import Observation

# If more of the interpolated pixels than this are explained after all, the others are interpolated anew (share).
REINTERPOLATE_FROM_SHARE = 0.5

NOISE_WORTH_JOINT_FIT = 5e-5  # Noise below which the joint fit of depth and F has nothing to gain (brightest colour).

# If a joint fit without lights turns all normals by more than the first, lights are looked for with the F of that fit.
# It is not made where the same fit at half the size turns them by less than the second.
TURN_BEFORE_LIGHTS_DEG, LITTLE_TURN_DEG = 1.0, 0.5

HALF = 2  # side of the cells, in pixels, of a joint fit that is not the last
NONE_FOUND = Lights((), 1.0)
LEAST_RELATIVE = 1e-7  # of the brightest colour: single precision holds no more


@dataclass(frozen=True)
class JointOutcome:
    """How the joint fit of depth and F ended."""

    used: bool  # its normals were taken
    misfit: float  # median residual of the inliers over the noise
    steps: int
    share: float | None = None  # of the object that has its normals; None: not used


@dataclass(frozen=True)
class Completion:
    """Normals of every pixel of the object, how each was found, and the lights that explain the colours."""

    solution: Solution  # F after all that was fitted; inliers are the pixels that see every light
    normals: np.ndarray  # (H, W, 3) unit, NaN off the object
    uncertainty_deg: np.ndarray  # (H, W) expected angular error, degrees
    reason: np.ndarray  # (H, W) uint8, codes of ``recover.reasons``
    missed: np.ndarray  # (H, W) int32, bit j: the pixel misses light j; 0 where it is not known which it misses
    lights: Lights
    shares: dict[str, float]  # of the object: all_lit, missing_lights, mapped, between
    joint: JointOutcome | None  # None: not tried, as where there is hardly any noise
    map_explains: float | None  # share of the object that lights and the irradiance map explain; None: no map
    lights_estimated_jointly: bool  # with the surface, from the whole picture
    notes: dict[str, Any]  # for the diagnostics
    # (H, W, 3) normals of a joint fit to a picture of half the size, where the fit to the whole is not taken although
    # indirect light was removed: that light may be predicted better from them. None: there are none.
    smoothed: np.ndarray | None = None

    def of(self, estimate: Estimate) -> Estimate:
        """The ``estimate`` that was completed, with what the completion found in the place of its own."""
        return replace(
            estimate,
            normals=self.normals.astype(np.float32),
            valid=self.reason > 0,
            inlier=self.solution.inlier,
            uncertainty_deg=self.uncertainty_deg.astype(np.float32),
            reason=self.reason,
            missed=self.missed,
            solution=self.solution,
            lights=self.lights,
            diagnostics=estimate.diagnostics | self.notes,
        )


@dataclass(frozen=True)
class CompletionSteps:
    """Which steps a completion takes."""

    search: bool = True
    """Look for lights, those given being tried first. Without this step those given are taken as they are; if none are
    given, pixels that miss a light are interpolated, which is quick."""

    joint: bool = False
    """Fit depth and F to the picture together, if it has noise to speak of, and take the result where its residual is
    like noise. Lights found one by one are looked for anew where such a fit without lights turns all normals by more
    than TURN_BEFORE_LIGHTS_DEG. Where lights were estimated jointly the fit is made at the end even without this
    step."""

    smooth: bool = False
    """Where lights were not estimated jointly, and those found or given do not add up to F, try to explain the
    remaining pixels by a smooth map from normals to colours (``recover.every_pixel.by_irradiance_map``)."""

    lights_jointly: bool = False
    """Where much of the object misses lights that noise hides, estimate lights and surface jointly
    (``recover.lights.search``)."""


def completed(
    estimate: Estimate,
    observation: Observation,
    steps: CompletionSteps,
    removed: np.ndarray | None = None,
    lights: Lights | None = None,
) -> tuple[Estimate, Completion | None]:
    """The estimate with normals of every pixel, and the completion; the estimate as it is where it has no solution.

    ``observation``: the picture that the estimate was made from; ``removed`` (H, W, 3): the indirect light that was
    subtracted from the camera's picture before, picture units.
    ``lights`` as for ``complete``.
    """
    solution = estimate.solution
    if solution is None or not estimate.valid.any():
        return estimate, None
    try:
        pixels = usable_pixels(observation)
    except RecoveryFailure:
        return estimate, None
    problem = problem_of(pixels, observation, solution.noise)
    if removed is not None:
        problem = replace(problem, removed=removed)
    found = complete(problem, solution, steps, pixels.lost, lights)
    return replace(found.of(estimate), removed=removed), found


def bridged(estimate: Estimate, observation: Observation, removed: np.ndarray) -> Estimate:
    """The estimate as a surface without gaps, quickly: indirect light needs the surface, not the lights."""
    return completed(estimate, observation, CompletionSteps(search=False), removed)[0]


def complete(
    problem: Problem,
    solution: Solution,
    steps: CompletionSteps,
    lost: np.ndarray | None = None,
    lights: Lights | None = None,
) -> Completion:
    """Normals of every pixel, from the matrix F of those that see every light.

    The solution may come from any method or from a calibration. ``lost`` (H, W): codes of ``recover.reasons`` that say
    why pixels are not usable; None: not known.
    ``lights``: those of nearly the same picture, as an earlier completion found them; None: none are known.
    """
    notes: dict[str, Any] = {}
    together, map_explains = None, None
    if steps.lights_jointly and _noise_hides_lights(problem, solution):
        prior = np.radians(solution.rotation_stderr_deg) ** 2 / 3 * np.eye(3)
        together, notes["whole_picture"] = estimate_jointly(problem, replace(solution, rotation_covariance=prior))
    if together is not None:
        solution = together.solution
        labelled = label_by_joint_lights(problem, together.surface)
        lights = lights_of(together.surface, labelled)
    else:
        lights = NONE_FOUND if lights is None else lights
        lights = _one_by_one(problem, solution, lights.found) if steps.search else lights
        if steps.joint and lights.found and _noise_is_worth_a_fit(problem):
            turned = _turned_by_fit(problem, solution)
            if turned is not solution:
                solution, lights = turned, _one_by_one(problem, turned, lights.found)
        labelled = label_by_light_sets(problem, _inlier_normals(problem, solution), solution.F, lights)
        labelled = _allowing_for_removal(labelled, problem, solution.F, lights)
        if steps.smooth and not lights.complete:
            labelled, mapped = with_irradiance_map(labelled, problem, solution)
            map_explains = None if not mapped else mapped["explained"]
            notes |= {} if not mapped else {"irradiance": mapped}
        labelled = leaning_on_colour(labelled, problem, solution)
    shares = _shares(labelled, problem.mask)
    notes["knit"] = shares
    found = Completion(
        solution=solution,
        normals=labelled.normals,
        uncertainty_deg=_uncertainty(labelled, problem, solution, lights),
        reason=_reasons(labelled, problem, lost),
        missed=np.where(labelled.explained, labelled.missed, 0).astype(np.int32),
        lights=lights,
        shares=shares,
        joint=None,
        map_explains=map_explains,
        lights_estimated_jointly=together is not None,
        notes=notes,
    )
    if (together is None and not steps.joint) or not _noise_is_worth_a_fit(problem):
        return found
    return _with_joint_fit(found, problem, labelled)


def _noise_is_worth_a_fit(problem: Problem) -> bool:
    """Whether the noise is large enough for a joint fit of depth and F to lessen it."""
    return problem.noise >= NOISE_WORTH_JOINT_FIT * problem.brightest


def _turned_by_fit(problem: Problem, solution: Solution) -> Solution:
    """The solution with the F of a joint fit without lights, if that turns all normals much and its residual is noise.

    Lights found with an F that is turned wrongly are turned with it, and later fits, which keep the lights, would keep
    that error.
    """
    labelled = label_by_light_sets(problem, _inlier_normals(problem, solution), solution.F, NONE_FOUND)
    surface = labelled.normals, labelled.missed, NONE_FOUND
    if _turn_deg(fit_jointly(problem, solution, *surface, finest=HALF).F, solution.F) < LITTLE_TURN_DEG:
        return solution
    fit = fit_jointly(problem, solution, *surface)
    misfit = float(np.median(fit.misfit[solution.inlier & problem.mask]))
    believed = EVERY_PIXEL.noise_like_least < misfit < EVERY_PIXEL.noise_like_most
    turned = _turn_deg(fit.F, solution.F) > TURN_BEFORE_LIGHTS_DEG
    return replace(solution, F=fit.F) if believed and turned else solution


def _turn_deg(one: np.ndarray, other: np.ndarray) -> float:
    """Angle of the rotation by which two matrices F (3, 3) differ, degrees."""
    U, _, Vt = np.linalg.svd(np.linalg.solve(one, other))
    return float(np.arccos(np.clip((np.trace(U @ Vt) - 1) / 2, -1, 1)) * DEG)


def _noise_hides_lights(problem: Problem, solution: Solution) -> bool:
    """Whether to estimate lights and surface jointly, because noise hides single lights.

    So it is where more than EVERY_PIXEL.least_unlit_share of the object are not inliers, the noise is above
    EVERY_PIXEL.noisy_picture of the brightest colour, and the inliers' residual is mostly independent from pixel to
    pixel. A spatially correlated residual, as interreflection leaves that was not all removed, is no noise.
    """
    outside = 1 - float((solution.inlier & problem.mask).sum() / problem.mask.sum())
    if outside <= EVERY_PIXEL.least_unlit_share or problem.noise <= EVERY_PIXEL.noisy_picture * problem.brightest:
        return False
    return not _residual_is_correlated(problem, solution)


def _inlier_normals(problem: Problem, solution: Solution) -> np.ndarray:
    """Unit normals F⁻¹(ρ − ambient) (H, W, 3) of the inliers, NaN elsewhere. Eq. (7)"""
    n = np.full(problem.rgb.shape, np.nan)
    own = (problem.rgb[solution.inlier] - solution.ambient) @ np.linalg.inv(solution.F).T
    n[solution.inlier] = own / np.linalg.norm(own, axis=-1, keepdims=True)
    return n


def _one_by_one(problem: Problem, solution: Solution, supposed: tuple[Light, ...]) -> Lights:
    """The lights, found one by one by the pixels that miss them; those ``supposed`` are tried first.

    Indirect light that was not removed, or not correctly, changes colours in shadows by more than it changes the
    colours of the pixels that see every light. Where there is indirect light, and no light is found or the lights found
    leave much of the object unexplained, a second search allows for more noise. The lights of the second search are
    taken if they leave less of the object unexplained, and a smaller part of F missing.
    """
    lights = find_lights(problem, solution, supposed)
    indirect = problem.removed.any() or _residual_is_correlated(problem, solution)
    if lights.complete or not indirect:
        return lights
    unexplained = _unexplained_share(problem, solution, lights)
    if lights.found and unexplained < EVERY_PIXEL.search_again_share:
        return lights
    noisier = problem.with_noise(EVERY_PIXEL.shadow_noise_factor * problem.noise)
    others = find_lights(noisier, solution, lights.found or supposed)
    better = others.missing < lights.missing and _unexplained_share(problem, solution, others) < unexplained
    return others if better else lights


def _unexplained_share(problem: Problem, solution: Solution, lights: Lights) -> float:
    """Share of the object whose colours no set of the ``lights`` explains."""
    labelled = label_by_light_sets(problem, _inlier_normals(problem, solution), solution.F, lights)
    return 1 - float((labelled.explained & problem.mask).sum() / problem.mask.sum())


def _residual_is_correlated(problem: Problem, solution: Solution) -> bool:
    """Whether a large part of the inliers' residual is alike in neighbouring pixels, so that it is no noise."""
    own = solution.inlier & problem.usable
    white, correlated = residual_scales(signed_distance(problem.rgb[own], solution.C), own)
    return correlated >= EVERY_PIXEL.correlated_is_noise * white


def _with_joint_fit(found: Completion, problem: Problem, labelled: LabelledPixels) -> Completion:
    """The completion with the joint fit's normals, denoised by a smoothness prior, if the fit's residual is noise."""
    fit = fit_jointly(problem, found.solution, found.normals, labelled.missed, found.lights)
    misfit = float(np.median(fit.misfit[found.solution.inlier & problem.mask]))
    outcome = JointOutcome(EVERY_PIXEL.noise_like_least < misfit < EVERY_PIXEL.noise_like_most, misfit, fit.steps)
    if not outcome.used:
        smoothed = _smoothed(found, problem, labelled) if problem.removed.any() else None
        return replace(found, joint=outcome, smoothed=smoothed, notes=found.notes | {"joint": _noted(outcome)})
    surface = denoised(fit)
    again = fit_again(fit, surface.slope)
    if again.loss < fit.loss:
        fit, surface = again, denoised(again)
    own = problem.mask & ~labelled.mapped & ~(labelled.explained & (surface.misfit > EVERY_PIXEL.own_colour_deviations))
    outcome = replace(outcome, steps=fit.steps, share=float(own.sum() / problem.mask.sum()))
    doubt = surface.uncertainty_deg
    doubt = np.where(labelled.explained, doubt, np.maximum(doubt, EVERY_PIXEL.interpolated_error_deg))
    # The fit holds the lights: where they were estimated jointly, all normals may be off by their rotation besides.
    doubt = np.hypot(doubt, found.solution.rotation_stderr_deg if found.lights_estimated_jointly else 0.0)
    return replace(
        found,
        solution=replace(found.solution, F=fit.F),
        normals=np.where(own[..., None], surface.normals, found.normals),
        uncertainty_deg=np.where(own, doubt, found.uncertainty_deg),
        joint=outcome,
        notes=found.notes | {"joint": _noted(outcome)},
    )


def _smoothed(found: Completion, problem: Problem, labelled: LabelledPixels) -> np.ndarray | None:
    """Normals (H, W, 3) of a joint fit at half the size; None where its residual is more than noise."""
    fit = fit_jointly(problem, found.solution, found.normals, labelled.missed, found.lights, finest=HALF)
    inlier = block_sums((found.solution.inlier & problem.mask).astype(float), HALF) == HALF**2
    own = inlier & fit.cells.where
    if not own.any() or np.median(fit.misfit[own]) >= EVERY_PIXEL.noise_like_most:
        return None
    surface, normals = denoised(fit), found.normals.copy()
    normals[problem.mask] = fit.cells.normals_at_pixels(surface.normals[fit.cells.where], problem.mask)
    return normals


def _noted(outcome: JointOutcome) -> dict[str, Any]:
    notes = {"used": outcome.used, "misfit": outcome.misfit, "steps": outcome.steps}
    return notes if outcome.share is None else notes | {"share": outcome.share}


def _allowing_for_removal(labelled: LabelledPixels, problem: Problem, F: np.ndarray, lights: Lights) -> LabelledPixels:
    """The labels, with normals that allow for an error of the indirect light that was removed."""
    normals, removed = labelled.normals.copy(), problem.removed
    for number in np.unique(labelled.missed[labelled.explained]):
        where = labelled.explained & (labelled.missed == number) & removed.any(axis=-1)
        M = without(F, lights.found, numbered(int(number)))
        normals[where] = nearest_normals_uncertain(problem.rgb[where], M, normals[where], removed[where], problem.noise)
    return _won_back(replace(labelled, normals=normals), problem, F, lights)


def _won_back(labelled: LabelledPixels, problem: Problem, F: np.ndarray, lights: Lights) -> LabelledPixels:
    """The labels, with those interpolated pixels explained that see every light if the removed light may have an error.

    If they are many, the others are interpolated anew.
    """
    rgb, removed, noise, ray = problem.rgb, problem.removed, problem.noise, problem.ray
    tried = labelled.interpolated & removed.any(axis=-1) & rgb.any(axis=-1)
    if not tried.any():
        return labelled
    g = removed[tried]
    n = nearest_normals_uncertain(rgb[tried], F, labelled.normals[tried], g, noise)
    distance = np.sqrt(squared_distance_uncertain(rgb[tried] - n @ F.T, g, noise))
    near = max(
        LIGHTS.outlier_deviations * noise,
        min(EVERY_PIXEL.removal_doubt_deviations * noise, EVERY_PIXEL.undetermined_rad * float(np.linalg.svd(F)[1][2])),
    )
    toward = np.array([light.direction for light in lights.found]).reshape(-1, 3)
    seen = facing_camera(n, None if ray is None else ray[tried]) >= 0
    won = tried.copy()
    won[tried] = (distance < near) & seen & (n @ toward.T >= 0).all(axis=1)
    won &= with_explained_neighbours(won | labelled.explained)
    normals = labelled.normals.copy()
    normals[tried] = np.where(won[tried][:, None], n, normals[tried])
    between, mask = labelled.interpolated & ~won, np.isfinite(normals[..., 0])
    if (
        won.sum() > REINTERPOLATE_FROM_SHARE * labelled.interpolated.sum()
    ):  # the border of what is interpolated has moved
        known = mask & ~between
        normals[between] = interpolated_normals(np.where(known[..., None], normals, 0.0), known, mask, ray)[between]
    off = np.where(won, 0, labelled.missed)
    return replace(labelled, normals=normals, missed=off, explained=labelled.explained | won, interpolated=between)


def _reasons(labelled: LabelledPixels, problem: Problem, lost: np.ndarray | None) -> np.ndarray:
    """Codes (H, W) of ``recover.reasons``."""
    why_lost = np.zeros(problem.mask.shape, np.uint8) if lost is None else lost
    reason = np.where(problem.mask, interpolated(why_lost), Reason.BACKGROUND)
    reason = np.where(labelled.mapped, Reason.IRRADIANCE_MAP, reason)
    by_lights = np.where(labelled.missed == 0, Reason.ALL_LIT, Reason.MISSES_LIGHTS)
    return np.where(labelled.explained, by_lights, reason).astype(np.uint8)


def _uncertainty(labelled: LabelledPixels, problem: Problem, solution: Solution, lights: Lights) -> np.ndarray:
    """Expected angular error (H, W) in degrees: noise and residual of each colour by its matrix, and the rotation."""
    rgb, removed, noise = problem.rgb, problem.removed, problem.noise
    on_object = np.isfinite(labelled.normals[..., 0])
    out = np.full(labelled.explained.shape, np.nan)
    out[on_object] = EVERY_PIXEL.interpolated_error_deg
    turn = solution.rotation_stderr_deg
    core = float(solution.inlier.sum() / on_object.sum())
    out[labelled.mapped] = min(np.hypot(map_error_deg(core), turn), EVERY_PIXEL.interpolated_error_deg)
    for number in np.unique(labelled.missed[labelled.explained]):
        where = labelled.explained & (labelled.missed == number)
        M = without(solution.F, lights.found, numbered(int(number)))
        n = labelled.normals[where]
        g = removed[where]
        variance = (
            noise**2 + squared_distance_uncertain(rgb[where] - n @ M.T, g, noise) + (LEAST_RELATIVE * rgb.max()) ** 2
        )
        a, b = (tangent @ M.T for tangent in tangent_frames(n))
        by_a, by_b = without_uncertain_part(a, g, noise), without_uncertain_part(b, g, noise)
        aa, ab, bb = (a * by_a).sum(axis=1), (a * by_b).sum(axis=1), (b * by_b).sum(axis=1)
        determinant = np.maximum(aa * bb - ab**2, 1e-12 * (aa + bb) ** 2)
        spread = expected_length(*(variance * s / determinant for s in (bb, -ab, aa))) * DEG
        out[where] = np.minimum(np.hypot(spread, turn), EVERY_PIXEL.interpolated_error_deg)
    return out


def _shares(labelled: LabelledPixels, mask: np.ndarray) -> dict[str, float]:
    """Shares of the object, by how its pixels' normals were found."""
    all_lit = labelled.explained & (labelled.missed == 0)
    count = mask.sum()
    return {
        "all_lit": float(all_lit.sum() / count),
        "missing_lights": float((labelled.explained & ~all_lit).sum() / count),
        "mapped": float(labelled.mapped.sum() / count),
        "between": float((mask & ~labelled.explained & ~labelled.mapped).sum() / count),
    }
