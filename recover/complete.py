"""From the normals of the pixels that see every light to those of all: lights, knitting, and the joint fit of depth."""

from dataclasses import replace
from typing import Any

import numpy as np

from recover.estimate import Estimate
from recover.joint import fit_jointly
from recover.knit import Knitted, knit
from recover.lights import Lights, find_lights, numbered, without
from recover.pixels import usable_pixels
from recover.status import RecoveryFailure
from recover.uncertainty import DEG, expected_length, tangent_frames
from render.dataset import Observation

BETWEEN_DEG = 15.0  # what normals of the surface between are off, on the scan and the bust under mild lights
GRAIN = 5e-5  # of the brightest colour: with less noise than this the joint fit has nothing to gain
NOISE_LIKE = 0.9, 1.3  # median of |e| over noise: 1.18 if two freedoms of three are left over; more is model error
OUTLIER = 4.0  # |e| over noise beyond which a pixel keeps the normal of its own colour
LEAST_RELATIVE = 1e-7  # of the brightest colour: single precision


def completed(estimate: Estimate, observation: Observation, *, joint: bool = False) -> Estimate:
    """The estimate with normals of every pixel of the object; as it is where it has none to start from.

    Adds to the diagnostics ``lights`` (direction, colour, pixels that show it, …) and ``knit`` (shares of the object).
    ``joint``: depth and F are fitted to the picture together, and taken where what is left over is like noise.
    """
    if not estimate.valid.any() or "F" not in estimate.diagnostics:
        return estimate
    try:
        pixels = usable_pixels(observation)
    except RecoveryFailure:
        return estimate
    F = np.asarray(estimate.diagnostics["F"])
    noise = float(estimate.diagnostics["noise"]["sigma"])
    start = np.where(estimate.valid[..., None], estimate.normals, np.nan).astype(np.float64)
    lights = find_lights(pixels.rgb, pixels.usable, estimate.inlier, F, noise)
    knitted = knit(pixels.rgb, pixels.usable, pixels.mask, start, F, lights, noise)
    whole = replace(
        estimate,
        normals=knitted.normals.astype(np.float32),
        valid=pixels.mask.copy(),
        uncertainty_deg=_uncertainty(estimate, pixels.rgb, F, lights, knitted, noise),
        diagnostics=estimate.diagnostics | {"lights": _told(lights), "knit": _shares(knitted, pixels.mask)},
    )
    if not joint or noise < GRAIN * float(pixels.rgb.max()):
        return whole
    return _jointly(whole, pixels.rgb, pixels.mask, lights, knitted, noise)


def _jointly(
    whole: Estimate, rgb: np.ndarray, mask: np.ndarray, lights: Lights, knitted: Knitted, noise: float
) -> Estimate:
    """The estimate with the normals of the joint fit, if that leaves noise over."""
    F = np.asarray(whole.diagnostics["F"])
    fit = fit_jointly(rgb, mask, knitted.normals, whole.inlier, knitted.off, F, lights, noise)
    misfit = float(np.median(fit.misfit[whole.inlier & mask]))
    used = NOISE_LIKE[0] < misfit < NOISE_LIKE[1]
    told: dict[str, Any] = {"used": used, "misfit": misfit, "steps": fit.steps}
    if not used:
        return replace(whole, diagnostics=whole.diagnostics | {"joint": told})
    taken = mask & ~(knitted.explained & (fit.misfit > OUTLIER))
    told["share"] = float(taken.sum() / mask.sum())
    doubt = np.where(knitted.explained, fit.uncertainty_deg, np.maximum(fit.uncertainty_deg, BETWEEN_DEG))
    return replace(
        whole,
        normals=np.where(taken[..., None], fit.normals, whole.normals).astype(np.float32),
        uncertainty_deg=np.where(taken, doubt, whole.uncertainty_deg).astype(np.float32),
        diagnostics=whole.diagnostics | {"F": fit.F.tolist(), "joint": told},
    )


def _uncertainty(
    estimate: Estimate, rgb: np.ndarray, F: np.ndarray, lights: Lights, knitted: Knitted, noise: float
) -> np.ndarray:
    """Expected angular error (H, W) in degrees: noise and misfit of each colour by its matrix, and rotation."""
    out = np.full(knitted.explained.shape, np.nan)
    out[np.isfinite(knitted.normals[..., 0])] = BETWEEN_DEG
    turn = float(estimate.diagnostics["rotation_stderr_deg"])
    for number in np.unique(knitted.off[knitted.explained]):
        where = knitted.explained & (knitted.off == number)
        M = without(F, lights.found, numbered(int(number)))
        n = knitted.normals[where]
        misfit = np.linalg.norm(rgb[where] - n @ M.T, axis=1)
        variance = noise**2 + misfit**2 + (LEAST_RELATIVE * rgb.max()) ** 2
        a, b = (tangent @ M.T for tangent in tangent_frames(n))
        aa, ab, bb = (a * a).sum(axis=1), (a * b).sum(axis=1), (b * b).sum(axis=1)
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
        "between": float((mask & ~knitted.explained).sum() / count),
    }
