"""Pixels that the lights found do not explain, by a smooth map from normal to colour that contains every light.

Where many lights are missed by few pixels each, or noise hides them, lights are not found one by one, and the surface
interpolated between the pixels that see all of them is a poor guess. What such a pixel sees is a smooth function of its
normal all the same (``recover.lights.irradiance_map``), as far as lights are hidden from it by the surface's own turn
alone. The map also confirms which pixels see every light: others have a colour near the ellipsoid by chance.
"""

from typing import Any

import numpy as np

from huesphere.recover.ellipsoid.distance import signed_distance
from huesphere.recover.every_pixel.by_light_sets import LabelledPixels
from huesphere.recover.every_pixel.parameters import EVERY_PIXEL
from huesphere.recover.lights.irradiance_map import fit_irradiance
from huesphere.recover.lights.parameters import LIGHTS
from huesphere.recover.problem import Problem
from huesphere.recover.solution import Solution

LEAST_UNCERTAIN_SHARE = 0.03  # of the object: fewer pixels that no lights explain are not worth the time of a map


def map_error_deg(core_share: float) -> float:
    """Expected mean error of the map's normals, degrees, where ``core_share`` of the object sees every light."""
    return EVERY_PIXEL.map_error_deg / max(core_share, 0.01)


def with_irradiance_map(
    labelled: LabelledPixels, problem: Problem, solution: Solution
) -> tuple[LabelledPixels, dict[str, Any]]:
    """(the labels, with normals of a smooth map where it explains pixels that lights do not; diagnostics).

    A pixel that seems to see all lights, for its colour is near the ellipsoid, but is no inlier of the ``solution``,
    keeps its normal where the colour is very near or the map confirms the normal. Where the map explains most of the
    remaining pixels, the rest of them take their normals from the map too, unless indirect light was removed from the
    picture. The labels are returned as they are, without diagnostics, where few pixels are unexplained, or the map's
    equations break down.
    """
    mask, F = problem.mask, solution.F
    all_lit = labelled.explained & (labelled.missed == 0)
    core = all_lit & solution.inlier
    uncertain = mask & ~core & ~(labelled.explained & ~all_lit)
    if uncertain.sum() < LEAST_UNCERTAIN_SHARE * mask.sum() or not core.any():
        return labelled, {}
    try:
        fit = fit_irradiance(problem, labelled.normals, core)
    except np.linalg.LinAlgError:
        return labelled, {}
    off_rad = np.abs(signed_distance(problem.rgb[all_lit], solution.C)) / np.linalg.svd(F)[1][2]
    usual = np.quantile(fit.misfit_of_start[core], EVERY_PIXEL.confirming_quantile)
    confirmed = all_lit & (fit.misfit_of_start < max(usual, LIGHTS.outlier_deviations * fit.expected_residual))
    confirmed[all_lit] |= off_rad < EVERY_PIXEL.surely_all_lit_rad
    mapped = uncertain & ~confirmed & fit.explains & problem.seen
    most = (uncertain & fit.explains).sum() > EVERY_PIXEL.most_explained_by_map * uncertain.sum()
    rest = uncertain & ~confirmed & ~mapped & (most and not problem.removed.any())
    by_lights = labelled.explained & ~mapped & ~rest
    diagnostics = {
        "explained": float((~uncertain | fit.explains | confirmed)[mask].mean()),
        "misfit": float(np.median(fit.misfit[mask])),
        "coefficients": fit.coefficients.tolist(),
        "steps": fit.steps,
    }
    return LabelledPixels(
        normals=np.where((mapped | rest)[..., None], fit.normals, labelled.normals),
        missed=np.where(by_lights, labelled.missed, -1),
        explained=by_lights,
        interpolated=(labelled.interpolated | rest) & ~mapped,
        mapped=mapped,
    ), diagnostics
