"""From the normals of the pixels that see every light to those of all: lights, knitting, and the joint fit of depth."""

from dataclasses import replace
from typing import Any

import numpy as np
from scipy import ndimage

from huesphere.recover.depth.joint_fit import fit_again, fit_jointly
from huesphere.recover.depth.smoothness_prior import quieted
from huesphere.recover.every_pixel.by_irradiance_map import by_map, mapped_deg
from huesphere.recover.every_pixel.by_joint_lights import knit_lit, lights_of
from huesphere.recover.every_pixel.by_light_sets import LONE, LOOSE, Knitted, knit, surface_between
from huesphere.recover.geometry.rays import facing_camera, rays
from huesphere.recover.geometry.tangent_uncertainty import DEG, expected_length, tangent_frames
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.lights.from_shadows import find_lights
from huesphere.recover.lights.model import WITHIN, Lights, numbered, without
from huesphere.recover.lights.search import WholePicture, whole_picture
from huesphere.recover.pixels.uncertain_component import likelier, nearest_along, squared_distance
from huesphere.recover.pixels.usable import Pixels, usable_pixels
from huesphere.recover.status import RecoveryFailure
from huesphere.render.dataset import Observation

BETWEEN_DEG = 15.0  # what normals of the surface between are off, on the scan and the bust under mild lights
LEAST_UNLIT = 0.25  # share of the object that misses lights, from which it tells all of them
NOISY = 3e-4  # of the brightest colour: with more noise lights that are not found singly are looked for together
GRAIN = 5e-5  # of the brightest colour: with less noise than this the joint fit has nothing to gain
DOUBTFUL = 12.0  # standard deviations that a bridged pixel may be off when what was taken out of it is in doubt
MOST_WON = 0.5  # share of the bridged pixels won back, from which the rest is bridged anew
NOISE_LIKE = 0.7, 1.3  # median of |e| over noise: 1.18 if two freedoms of three are left over; more is model error,
# less only noise that was thought too large, as where much light was taken out
OUTLIER = 12.0  # |e| over noise beyond which a pixel keeps the normal of its own colour: detail that the prior bridges
IN_SHADOW = 2.0  # times the noise that lights are looked for with, if none is found and something was taken out
NONE_FOUND = Lights((), 1.0)
LEAST_RELATIVE = 1e-7  # of the brightest colour: single precision


def completed(
    estimate: Estimate,
    observation: Observation,
    taken: np.ndarray | None = None,
    *,
    search: bool = True,
    joint: bool = False,
    smooth: bool = False,
) -> Estimate:
    """The estimate with normals of every pixel of the object; as it is where it has none to start from.

    ``taken`` (H, W, 3), if given: the light of other pixels that was taken out of the observation, picture units.
    Adds to the diagnostics ``lights`` (direction, colour, pixels that show it, …) and ``knit`` (shares of the object).
    ``search``: lights are looked for; without, pixels that miss one are bridged, which is soon done.
    ``joint``: depth and F are fitted to the picture together, and taken where what is left over is like noise.
    ``smooth``: where noise hides lights from much of the object they are looked for all together
    (``recover.lights.search``); where not all are found one by one, pixels that the known ones do not explain are
    explained by a smooth map of the normal, if that does (``recover.every_pixel.by_irradiance_map``).
    """
    if not estimate.valid.any() or "F" not in estimate.diagnostics:
        return estimate
    try:
        pixels = usable_pixels(observation)
    except RecoveryFailure:
        return estimate
    F = np.asarray(estimate.diagnostics["F"])
    noise = float(estimate.diagnostics["noise"]["sigma"])
    taken = np.zeros_like(pixels.rgb) if taken is None else taken
    start = np.where(estimate.valid[..., None], estimate.normals, np.nan).astype(np.float64)
    ray, told = rays(observation.camera, pixels.mask.shape), dict[str, Any]()
    by_all = None
    if smooth and _hidden_in_noise(estimate, pixels, noise):
        about_F = np.radians(float(estimate.diagnostics["rotation_stderr_deg"])) ** 2 / 3 * np.eye(3)
        seen = pixels.usable | pixels.dark
        by_all, told["whole_picture"] = whole_picture(
            pixels.rgb, pixels.mask, seen, estimate.inlier, F, about_F, noise, ray
        )
    if by_all is not None:
        F, estimate = by_all.F, _by_whole_picture(estimate, by_all)
        knitted = knit_lit(pixels.rgb, pixels.usable, pixels.mask, by_all.surface, noise)
        lights = lights_of(by_all.surface, knitted)
    else:
        lights = _one_by_one(pixels, estimate.inlier, F, taken, noise, ray) if search else NONE_FOUND
        knitted = knit(pixels.rgb, pixels.usable, pixels.mask, start, F, lights, noise, ray)
        knitted = _along(knitted, pixels.rgb, F, lights, taken, noise, ray)
        if smooth and not lights.complete:
            knitted, mapped = by_map(knitted, pixels, estimate.inlier, F, taken, noise, ray)
            told |= mapped
    told = told | {"lights": _told(lights), "knit": _shares(knitted, pixels.mask)}
    whole = replace(
        estimate,
        normals=knitted.normals.astype(np.float32),
        valid=pixels.mask.copy(),
        uncertainty_deg=_uncertainty(estimate, pixels.rgb, F, lights, knitted, taken, noise),
        diagnostics=estimate.diagnostics | told,
    )
    if (by_all is None and not joint) or noise < GRAIN * float(pixels.rgb.max()):
        return whole
    turn = 0.0 if by_all is None else float(estimate.diagnostics["rotation_stderr_deg"])  # the fit holds the lights
    return _jointly(whole, pixels.rgb, pixels.mask, lights, knitted, taken, noise, turn, ray)


def bridged(estimate: Estimate, observation: Observation, taken: np.ndarray) -> Estimate:
    """A surface without gaps, soon done: for the light that its parts send each other no lights are needed."""
    return completed(estimate, observation, taken, search=False)


def _hidden_in_noise(estimate: Estimate, pixels: Pixels, noise: float) -> bool:
    """Whether much of the object misses lights that noise hides, so that they are looked for all together."""
    unlit = 1 - float((estimate.inlier & pixels.mask).sum() / pixels.mask.sum())
    return unlit > LEAST_UNLIT and noise > NOISY * float(pixels.rgb.max())


def _by_whole_picture(estimate: Estimate, by_all: WholePicture) -> Estimate:
    """The estimate with the matrix and the all-lit pixels of the whole picture in place of its own."""
    changed = {
        "F": by_all.F.tolist(),
        "C": np.linalg.inv(by_all.F @ by_all.F.T).tolist(),
        "rotation_stderr_deg": float(np.degrees(np.sqrt(np.trace(by_all.covariance)))),
    }
    return replace(estimate, inlier=by_all.all_lit, diagnostics=estimate.diagnostics | changed)


def _one_by_one(
    pixels: Pixels, core: np.ndarray, F: np.ndarray, taken: np.ndarray, noise: float, ray: np.ndarray | None
) -> Lights:
    """The lights that single pixels tell."""
    lights = find_lights(pixels.rgb, pixels.usable, core, F, noise, ray)
    if not lights.found and taken.any():  # what was taken out in the shadows is wrong by more than where all is lit
        lights = find_lights(pixels.rgb, pixels.usable, core, F, IN_SHADOW * noise, ray)
    return lights


def _jointly(
    whole: Estimate,
    rgb: np.ndarray,
    mask: np.ndarray,
    lights: Lights,
    knitted: Knitted,
    taken: np.ndarray,
    noise: float,
    turn: float,
    ray: np.ndarray | None,
) -> Estimate:
    """The estimate with the normals of the joint fit under the prior, if the fit without it leaves noise over.

    ``turn``: degrees that all of them may be off besides, as the lights are.
    """
    F = np.asarray(whole.diagnostics["F"])
    fit = fit_jointly(rgb, mask, knitted.normals, whole.inlier, knitted.off, F, lights, taken, noise, ray)
    misfit = float(np.median(fit.misfit[whole.inlier & mask]))
    used = NOISE_LIKE[0] < misfit < NOISE_LIKE[1]
    told: dict[str, Any] = {"used": used, "misfit": misfit, "steps": fit.steps}
    if not used:
        return replace(whole, diagnostics=whole.diagnostics | {"joint": told})
    surface = quieted(fit)
    again = fit_again(fit, surface.slope)
    if again.loss < fit.loss:
        fit, surface = again, quieted(again)
        told["steps"] = fit.steps
    taken = mask & ~knitted.mapped & ~(knitted.explained & (surface.misfit > OUTLIER))
    told["share"] = float(taken.sum() / mask.sum())
    doubt = np.where(knitted.explained, surface.uncertainty_deg, np.maximum(surface.uncertainty_deg, BETWEEN_DEG))
    doubt = np.hypot(doubt, turn)
    return replace(
        whole,
        normals=np.where(taken[..., None], surface.normals, whole.normals).astype(np.float32),
        uncertainty_deg=np.where(taken, doubt, whole.uncertainty_deg).astype(np.float32),
        diagnostics=whole.diagnostics | {"F": fit.F.tolist(), "joint": told},
    )


def _along(
    knitted: Knitted,
    rgb: np.ndarray,
    F: np.ndarray,
    lights: Lights,
    taken: np.ndarray,
    noise: float,
    ray: np.ndarray | None,
) -> Knitted:
    """Normals, not trusting what was ``taken`` (H, W, 3) out of pixels to the last percent."""
    normals = knitted.normals.copy()
    for number in np.unique(knitted.off[knitted.explained]):
        where = knitted.explained & (knitted.off == number) & taken.any(axis=-1)
        M = without(F, lights.found, numbered(int(number)))
        normals[where] = nearest_along(rgb[where], M, normals[where], taken[where], noise)
    return _won_back(replace(knitted, normals=normals), rgb, F, lights, taken, noise, ray)


def _won_back(
    knitted: Knitted,
    rgb: np.ndarray,
    F: np.ndarray,
    lights: Lights,
    taken: np.ndarray,
    noise: float,
    ray: np.ndarray | None = None,
) -> Knitted:
    """Bridged pixels that all lights explain if what was ``taken`` out is doubted take part.

    If they are many, the rest is bridged anew.
    """
    tried = knitted.between & taken.any(axis=-1) & rgb.any(axis=-1)
    if not tried.any():
        return knitted
    g, n = taken[tried], nearest_along(rgb[tried], F, knitted.normals[tried], taken[tried], noise)
    distance = np.sqrt(squared_distance(rgb[tried] - n @ F.T, g, noise))
    near = max(WITHIN * noise, min(DOUBTFUL * noise, LOOSE * float(np.linalg.svd(F)[1][2])))
    toward = np.array([light.direction for light in lights.found]).reshape(-1, 3)
    seen = facing_camera(n, None if ray is None else ray[tried]) >= 0
    won = tried.copy()
    won[tried] = (distance < near) & seen & (n @ toward.T >= 0).all(axis=1)
    won &= ndimage.uniform_filter((won | knitted.explained).astype(float), 3) > LONE
    normals = knitted.normals.copy()
    normals[tried] = np.where(won[tried][:, None], n, normals[tried])
    between, mask = knitted.between & ~won, np.isfinite(normals[..., 0])
    if won.sum() > MOST_WON * knitted.between.sum():  # else the border of the bridge is no better than it was
        known = mask & ~between
        normals[between] = surface_between(np.where(known[..., None], normals, 0.0), known, mask, ray)[between]
    off = np.where(won, 0, knitted.off)
    return replace(knitted, normals=normals, off=off, explained=knitted.explained | won, between=between)


def _uncertainty(
    estimate: Estimate,
    rgb: np.ndarray,
    F: np.ndarray,
    lights: Lights,
    knitted: Knitted,
    taken: np.ndarray,
    noise: float,
) -> np.ndarray:
    """Expected angular error (H, W) in degrees: noise and misfit of each colour by its matrix, and rotation."""
    out = np.full(knitted.explained.shape, np.nan)
    out[np.isfinite(knitted.normals[..., 0])] = BETWEEN_DEG
    turn = float(estimate.diagnostics["rotation_stderr_deg"])
    core = float(estimate.inlier.sum() / np.isfinite(knitted.normals[..., 0]).sum())
    out[knitted.mapped] = min(np.hypot(mapped_deg(core), turn), BETWEEN_DEG)
    for number in np.unique(knitted.off[knitted.explained]):
        where = knitted.explained & (knitted.off == number)
        M = without(F, lights.found, numbered(int(number)))
        n = knitted.normals[where]
        g = taken[where]
        variance = noise**2 + squared_distance(rgb[where] - n @ M.T, g, noise) + (LEAST_RELATIVE * rgb.max()) ** 2
        a, b = (tangent @ M.T for tangent in tangent_frames(n))
        by_a, by_b = likelier(a, g, noise), likelier(b, g, noise)
        aa, ab, bb = (a * by_a).sum(axis=1), (a * by_b).sum(axis=1), (b * by_b).sum(axis=1)
        determinant = np.maximum(aa * bb - ab**2, 1e-12 * (aa + bb) ** 2)
        spread = expected_length(*(variance * s / determinant for s in (bb, -ab, aa))) * DEG
        out[where] = np.minimum(np.hypot(spread, turn), BETWEEN_DEG)
    return out.astype(np.float32)


def _told(lights: Lights) -> dict[str, Any]:
    found = [
        {
            "direction": light.direction.tolist(),
            "colour": light.colour.tolist(),
            "pixels": light.support,
            "curl": light.curl,
            "attached_share": light.attached,
        }
        for light in lights.found
    ]
    return {"found": found, "missing": lights.missing, "complete": lights.complete}


def _shares(knitted: Knitted, mask: np.ndarray) -> dict[str, float]:
    all_lit = knitted.explained & (knitted.off == 0)
    count = mask.sum()
    return {
        "all_lit": float(all_lit.sum() / count),
        "missing_lights": float((knitted.explained & ~all_lit).sum() / count),
        "mapped": float(knitted.mapped.sum() / count),
        "between": float((mask & ~knitted.explained & ~knitted.mapped).sum() / count),
    }
