"""Method ``robust``: the ellipsoid of the pixels that see every light, though these may be a tenth of the object.

The ellipsoid grows from patches (``recover.ellipsoid.from_patches``), the rotation comes from tangents
(``recover.rotation.tangents``). Where few pixels leave the rotation uncertain, lights and surface are estimated jointly
from the whole picture (``recover.lights.search``).
"""

from dataclasses import replace

import numpy as np

from huesphere.recover.cues.linear_integrability import off_axis_deg
from huesphere.recover.ellipsoid.fit import fit_accepted
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.lights.search import estimate_jointly
from huesphere.recover.methods.ellipsoid_steps import fit_from_patches, refit_from_patches
from huesphere.recover.methods.parameters import METHOD
from huesphere.recover.methods.pipeline import run_pipeline
from huesphere.recover.methods.records import FittedEllipsoid, FittedRotation, Notes, Oriented
from huesphere.recover.methods.rotation_steps import rotate_by_tangents
from huesphere.recover.problem import Problem
from huesphere.recover.solution import Solution
from huesphere.recover.status import RecoveryFailure
from huesphere.render.dataset import Observation

WINDOW = 5  # pixels, side of the squares whose mean colours must span three dimensions: the search works on blocks


def recover_robust(observation: Observation) -> Estimate:
    """Ellipsoid from patches, rotation by tangents. The noise is the camera's where that is known."""
    estimate = run_pipeline(observation, fit_from_patches, rotate_by_tangents, _estimate_lights_jointly, window=WINDOW)
    return _with_doubt(estimate)


def recover_robust_near(observation: Observation, C: np.ndarray) -> Estimate:
    """The same from the ellipsoid C (3, 3), inverse squared picture units, instead of a search for it."""

    def refit(problem: Problem, observation: Observation, notes: Notes) -> FittedEllipsoid:
        return refit_from_patches(problem, observation, C, notes)

    estimate = run_pipeline(observation, refit, rotate_by_tangents, _estimate_lights_jointly, window=WINDOW)
    return _with_doubt(estimate)


def _estimate_lights_jointly(problem: Problem, found: Oriented, notes: Notes) -> Oriented | None:
    """What lights and surface of the whole picture say of an uncertain rotation; None: it is certain, or they fail."""
    ellipsoid, rotation = found.ellipsoid, found.rotation
    stderr = float(np.degrees(np.sqrt(np.trace(rotation.covariance))))
    if stderr < METHOD.joint_lights_from_deg and rotation.converged:
        return None
    solution = Solution(found.F, ellipsoid.inlier, ellipsoid.noise, rotation.covariance, ambient=ellipsoid.ambient)
    jointly, told = estimate_jointly(problem.with_noise(ellipsoid.noise), solution)
    notes["whole_picture"] = told | {"first_rotation_stderr_deg": stderr}
    if jointly is None:
        return None
    better = jointly.solution
    usable = problem.usable
    try:
        fit = fit_accepted(problem.rgb[usable], better.inlier[usable], noise=ellipsoid.noise)
    except RecoveryFailure:
        return None
    fit = replace(fit, C=better.C)
    turned = FittedRotation(better.rotation, better.rotation_covariance, converged=True)
    return Oriented(replace(ellipsoid, fit=fit, inlier=better.inlier), turned)


def _with_doubt(estimate: Estimate) -> Estimate:
    """The estimate, its status "rotation-undetermined" where its standard error or its normals show so.

    Lights stand in front of the object, so a normal that faces the camera sees them all and is an inlier. This is asked
    for where no silhouette has fixed which way that is.
    """
    if estimate.status != "ok":
        return estimate
    turn = estimate.rotation_stderr_deg
    off_axis = 0.0
    if estimate.solution is not None and not estimate.solution.by_silhouette:
        off_axis = off_axis_deg(estimate.normals[estimate.valid][:, 2], fewest=1)
    if turn <= METHOD.undetermined_rotation_deg and off_axis <= METHOD.most_off_axis_deg:
        return estimate
    uncertain = f"the rotation is known to {turn:.2g}°"
    aside = (
        f"no normal faces the camera, the nearest is {off_axis:.0f}° off: these pixels miss a light, or the "
        "rotation is wrong"
    )
    why = uncertain if turn > METHOD.undetermined_rotation_deg else aside
    failure = RecoveryFailure("rotation-undetermined", why)
    return replace(estimate, status=failure.status, message=failure.message)
