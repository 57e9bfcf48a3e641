"""Pixels that the lights found do not explain, by a smooth map from normal to colour, which holds every light.

Where many lights are missed by few pixels each, or noise hides them, lights are not found one by one, and the surface
between the pixels that see all of them is a poor guess. What such a pixel sees is a smooth function of its normal all
the same (``recover.lights.irradiance_map``), as far as only the surface's own turn hides lights from it. The map tells
too which pixels see every light: some that do not have a colour near the shell by chance.
"""

from typing import Any

import numpy as np

from huesphere.recover.ellipsoid.distance import signed_distance
from huesphere.recover.every_pixel.by_light_sets import Knitted
from huesphere.recover.lights.irradiance_map import LEAVES, fit_irradiance
from huesphere.recover.pixels.usable import Pixels

LEAST_UNSURE = 0.03  # share of the object that the lights do not explain, from which a map is worth its while
MOST_EXPLAINED = 0.75  # share of these that the map explains, from which it is right for the rest too
FIRM = 0.02  # radians that a colour is off in F's weakest direction, within which a pixel is trusted to see all lights
LEVEL = 0.9  # quantile of what the map leaves of pixels known to see all lights
MAP_DEG = 2.4  # mean error of its normals, degrees, where all of the object is the core: 0.7 to 6 on random scenes


def mapped_deg(core: float) -> float:
    """What normals of the map are off in the mean, degrees, where ``core`` is the share of the object known to it."""
    return MAP_DEG / max(core, 0.01)


def by_map(
    knitted: Knitted,
    pixels: Pixels,
    core: np.ndarray,
    F: np.ndarray,
    taken: np.ndarray,
    noise: float,
    ray: np.ndarray | None,
) -> tuple[Knitted, dict[str, Any]]:
    """With the normals of a smooth map where it explains pixels that lights do not; and what is told of it.

    A pixel off the ``core`` (H, W) that is thought to see all lights, for its colour is not far off, keeps its normal
    where it is next to nothing off, or the map bears it out. Where the map explains most of what is left the rest is
    nearer to it than to the bridge, unless light of other pixels was ``taken`` out.
    """
    lit = knitted.explained & (knitted.off == 0)
    own = lit & core
    unsure = pixels.mask & ~own & ~(knitted.explained & ~lit)
    if unsure.sum() < LEAST_UNSURE * pixels.mask.sum() or not own.any():
        return knitted, {}
    seen = pixels.usable | pixels.dark
    try:
        fit = fit_irradiance(pixels.rgb, pixels.mask, knitted.normals, own, noise, ray, seen)
    except np.linalg.LinAlgError:
        return knitted, {}
    off = np.abs(signed_distance(pixels.rgb[lit], np.linalg.inv(F @ F.T))) / np.linalg.svd(F)[1][2]
    borne_out = lit & (fit.misfit_of_start < max(np.quantile(fit.misfit_of_start[own], LEVEL), LEAVES * fit.left_out))
    borne_out[lit] |= off < FIRM
    mapped = unsure & ~borne_out & fit.explains & seen
    most = (unsure & fit.explains).sum() > MOST_EXPLAINED * unsure.sum() and not taken.any()
    rest = unsure & ~borne_out & ~mapped & most
    by_lights = knitted.explained & ~mapped & ~rest
    told = {
        "explained": float((~unsure | fit.explains | borne_out)[pixels.mask].mean()),
        "misfit": float(np.median(fit.misfit[pixels.mask])),
        "coefficients": fit.coefficients.tolist(),
        "steps": fit.steps,
    }
    return Knitted(
        normals=np.where((mapped | rest)[..., None], fit.normals, knitted.normals),
        off=np.where(by_lights, knitted.off, -1),
        explained=by_lights,
        between=(knitted.between | rest) & ~mapped,
        mapped=mapped,
    ), {"irradiance": told}
