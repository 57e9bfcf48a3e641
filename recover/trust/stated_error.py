"""The stated error of every pixel: what noise causes, and what the evidence says about errors of the model.

A method propagates the noise of colours and the rotation's error into each normal. What else is wrong, it cannot tell:
interreflection that is left, a wrong label, an ellipsoid that is a little off. So the logarithm of the error is
regressed, over the pixels of random scenes, on the method's own figure, on where the pixel lies, on how its normal was
found, and on the evidence for the estimate as a whole. The weights are in ``stated_error_weights.json``, written by
``benchmarks/trust_fit.py``. The stated error is ``factor`` times the typical one, the geometric mean that the
regression predicts, so that more than half of the errors lie within it. The error of the rotation is stated in the same
way, from the figures of the estimate as a whole.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from scipy import ndimage

from huesphere.recover.io.estimate import Estimate
from huesphere.recover.parameters import learned
from huesphere.recover.reasons import Reason, by_colour
from huesphere.recover.trust.evidence import Evidence
from huesphere.recover.trust.joined import joined_to

LEAST_DEG, MOST_DEG = 1e-3, 90.0  # of a stated error
LEAST_OF_OWN = 0.7  # of the method's own figure: the evidence does not lower a stated error below this share of it
LEAST_OF_OWN_ROTATION = 0.3  # of its figure for the rotation, which is an upper bound where noise is the least error
APART_DEG = 20.0  # least stated error of a normal that does not join those of the all-lit pixels: its label is in doubt
STEEPEST_N3 = 0.02  # steeper normals count as this steep
# Lengths as shares of the object's size, the root of its area. Distances to the nearest explained pixel are in units of
# NEAR. Distances from the border of the core and from the outline count up to FAR. AT is added to the former and 2 AT
# to the latter before their logarithms are taken, so that none is that of 0.
NEAR, AT, FAR = 0.05, 0.005, 0.3


def with_model_error(estimate: Estimate, evidence: Evidence, mask: np.ndarray) -> Estimate:
    """The ``estimate`` of the object ``mask`` (H, W) with errors that the ``evidence`` leads one to expect."""
    given = estimate.valid & mask
    figures = pixel_figures(estimate, evidence, mask)
    found = weights()
    logarithm = sum(found["weights"][name] * image for name, image in figures.items())
    # "is apart" has the weight 0 in the regression: pixels that are apart have a least error instead. It is divided by
    # LEAST_OF_OWN here, since ``own`` is multiplied by that below.
    own = np.maximum(estimate.uncertainty_deg[given], np.where(figures["is apart"] > 0, APART_DEG / LEAST_OF_OWN, 0.0))
    stated = np.full(mask.shape, np.nan)
    stated[given] = np.clip(np.maximum(found["factor"] * 10.0**logarithm, LEAST_OF_OWN * own), LEAST_DEG, MOST_DEG)
    estimate = replace(estimate, uncertainty_deg=np.where(given, stated, estimate.uncertainty_deg).astype(np.float32))
    return _with_rotation_error(estimate, evidence)


def _with_rotation_error(estimate: Estimate, evidence: Evidence) -> Estimate:
    """The ``estimate``, its rotation's covariance multiplied so that its standard error is that of the regression.

    At least that of the distance from the most integrable rotation.
    """
    solution, own = estimate.solution, evidence.rotation_deg
    if solution is None or not np.isfinite(own) or own < LEAST_DEG:
        return estimate
    found = weights()["rotation"]
    logarithm = sum(found["weights"][name] * value for name, value in rotation_figures(evidence).items())
    least = max(LEAST_OF_OWN_ROTATION * own, evidence.turn_beyond_deg)
    stated = np.clip(max(found["factor"] * 10.0**logarithm, least), LEAST_DEG, MOST_DEG)
    covariance = solution.rotation_covariance * (stated / own) ** 2
    return replace(estimate, solution=replace(solution, rotation_covariance=covariance))


def rotation_figures(evidence: Evidence) -> dict[str, float]:
    """What the error of the rotation is regressed on, by name: decimal logarithms of angles in degrees, and 1."""
    whole = _of_the_whole(evidence)
    names = ("rotation_deg", "correlated_deg", "white_deg", "halves_deg", "turn_spread_deg", "turn_moved_deg")
    return {"one": 1.0} | {name: whole[name] for name in (*names, "not_integrable_deg")}


def pixel_figures(estimate: Estimate, evidence: Evidence, mask: np.ndarray) -> dict[str, np.ndarray]:
    """What the error of each pixel that has a normal is regressed on, by name: (P,), in raster order."""
    given = estimate.valid & mask
    reason = np.where(given, int(Reason.ALL_LIT), 0) if estimate.reason is None else estimate.reason
    size = np.sqrt(mask.sum())
    all_lit = given & (reason == Reason.ALL_LIT)
    by_own_colour = given & by_colour(reason)
    explained = joined_to(all_lit, np.nan_to_num(estimate.normals.astype(np.float64)), by_own_colour)
    away = ndimage.distance_transform_edt(~explained)[given] / size if explained.any() else np.ones(given.sum())
    within = ndimage.distance_transform_edt(all_lit)[given] / size
    rim = ndimage.distance_transform_edt(np.pad(mask, 1))[1:-1, 1:-1][given] / size
    mapped = np.isin(reason, [int(Reason.IRRADIANCE_MAP), int(Reason.KNOWN_LIGHTS)])
    kinds = {"all-lit": all_lit, "misses-lights": reason == Reason.MISSES_LIGHTS, "mapped": mapped}
    kinds |= {"interpolated": given & ~by_own_colour, "apart": by_own_colour & ~explained}
    steep = np.clip(estimate.normals[given][:, 2].astype(float), STEEPEST_N3, 1.0)
    pixels = {f"is {name}": image[given].astype(float) for name, image in kinds.items()}
    pixels |= {
        "method's own": np.log10(np.clip(estimate.uncertainty_deg[given].astype(float), LEAST_DEG, 180.0)),
        "away from colours": np.log10(1 + away / NEAR),
        "within the core": np.where(all_lit[given], np.log10(AT + np.minimum(within, FAR)), 0.0),
        "within the outline": np.log10(2 * AT + np.minimum(rim, FAR)),
        "steepness": -np.log10(steep),
    }
    ones = np.ones(int(given.sum()))
    return pixels | {name: value * ones for name, value in _of_the_whole(evidence).items()}


def weights() -> dict[str, Any]:
    """The weight of each figure, and the factor."""
    return learned("trust/stated_error_weights.json")


def _of_the_whole(evidence: Evidence) -> dict[str, float]:
    """Figures that are the same for all pixels."""
    names = (
        *("stated_deg", "rotation_deg", "correlated_deg", "white_deg", "halves_deg"),
        *("turn_spread_deg", "turn_moved_deg", "not_integrable_deg"),
    )
    found = {name: float(np.log10(np.clip(getattr(evidence, name), LEAST_DEG, 1e3))) for name in names}
    return found | {"interpolated": evidence.interpolated, "mapped": evidence.mapped}
