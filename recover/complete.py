"""From the normals of the pixels that see every light to those of all: an estimate completed by lights and knitting."""

from dataclasses import replace
from typing import Any

import numpy as np

from recover.estimate import Estimate
from recover.knit import Knitted, knit
from recover.lights import Lights, find_lights, without
from recover.pixels import usable_pixels
from recover.status import RecoveryFailure
from recover.uncertainty import DEG, expected_length
from render.dataset import Observation

BETWEEN_DEG = 15.0  # what normals of the surface between are off, on the scan and the bust under mild lights
LEAST_RELATIVE = 1e-7  # of the brightest colour: single precision


def completed(estimate: Estimate, observation: Observation) -> Estimate:
    """The estimate with normals of every pixel of the object; as it is where it has none to start from.

    Adds to the diagnostics ``lights`` (direction, colour, pixels that show it, …) and ``knit`` (shares of the object).
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
    return replace(
        estimate,
        normals=knitted.normals.astype(np.float32),
        valid=pixels.mask.copy(),
        uncertainty_deg=_uncertainty(estimate, pixels.rgb, F, lights, knitted, noise),
        diagnostics=estimate.diagnostics | {"lights": _told(lights), "knit": _shares(knitted, pixels.mask)},
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
        M = without(F, lights.found, tuple(j for j in range(len(lights.found)) if number >> j & 1))
        n = knitted.normals[where]
        misfit = np.linalg.norm(rgb[where] - n @ M.T, axis=1)
        variance = noise**2 + misfit**2 + (LEAST_RELATIVE * rgb.max()) ** 2
        first = np.stack([-n[:, 1], n[:, 0], np.zeros(len(n))], axis=-1)
        first[np.abs(n[:, 2]) > 0.9] = np.stack([np.zeros(len(n)), -n[:, 2], n[:, 1]], axis=-1)[np.abs(n[:, 2]) > 0.9]
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        a, b = first @ M.T, np.cross(n, first) @ M.T
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
