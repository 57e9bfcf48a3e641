"""The ways in which methods fit their ellipsoid: to all pixels, as the report does, polished, from patches …

Each takes the problem, the observation and the notes, and returns a FittedEllipsoid. Raises RecoveryFailure:
rank-deficient-colours, no-ellipsoid, no-dominant-shell.
"""

from dataclasses import replace

import numpy as np

from huesphere.recover.baselines.kontsevich1994 import grow_region
from huesphere.recover.ellipsoid.distance import signed_distance
from huesphere.recover.ellipsoid.fit import Fit, least_median_of_squares, least_squares, reweighted
from huesphere.recover.ellipsoid.free_centre import fit_with_ambient
from huesphere.recover.ellipsoid.from_patches import ChosenEllipsoid, choose_ellipsoid, ellipsoid_near
from huesphere.recover.ellipsoid.refit import refit_inliers
from huesphere.recover.methods.records import FittedEllipsoid, Notes, finite_or_none
from huesphere.recover.problem import Problem
from huesphere.recover.robust_scale import mad_scale
from huesphere.recover.rotation.weak_form import without_specks
from huesphere.render.dataset import Observation


def fit_all_pixels(problem: Problem, observation: Observation, notes: Notes) -> FittedEllipsoid:
    """Least squares over all usable pixels, none of them an outlier. Eq. (10)"""
    colours = problem.rgb[problem.usable]
    return _with_inliers(problem, reweighted(colours, least_squares(colours), cut=np.inf))


def fit_as_reported(problem: Problem, observation: Observation, notes: Notes) -> FittedEllipsoid:
    """Least Median of Squares, the cut at 2.5 s0, least squares on the rest (report 2.2)."""
    colours = problem.rgb[problem.usable]
    return _with_inliers(problem, reweighted(colours, least_median_of_squares(colours)))


def fit_and_polish(problem: Problem, observation: Observation, notes: Notes) -> FittedEllipsoid:
    """Least Median of Squares, then refitted to its own pixels with the bias of noise removed.

    Where the spatially correlated residual exceeds the noise (interreflection: the model itself is off) local means
    mislead, and the report's fit is kept.
    """
    return polished_ellipsoid(problem, least_median_of_squares(problem.rgb[problem.usable]), notes)


def polished_ellipsoid(problem: Problem, C: np.ndarray, notes: Notes) -> FittedEllipsoid:
    """The ellipsoid C (3, 3) refitted as in ``fit_and_polish``."""
    polished = refit_inliers(problem.rgb, problem.usable, C)
    used = polished.correlated <= polished.noise
    notes["polish"] = {
        "noise": polished.noise,
        "misfit": polished.correlated,
        "unbiased": polished.unbiased,
        "rounds": polished.rounds,
        "used": used,
    }
    if not used:
        return reported_ellipsoid(problem, C)
    return FittedEllipsoid(polished.fit, polished.inlier, float(np.hypot(polished.noise, polished.correlated)))


def reported_ellipsoid(problem: Problem, C: np.ndarray) -> FittedEllipsoid:
    """The ellipsoid C (3, 3) refitted to the pixels within the report's cut, single pixels among them removed."""
    reported = _with_inliers(problem, reweighted(problem.rgb[problem.usable], C))
    return replace(reported, inlier=without_specks(reported.inlier) & problem.usable)


def fit_free_centre(problem: Problem, observation: Observation, notes: Notes) -> FittedEllipsoid:
    """The report's ambient term (3.6): the ellipsoid's centre is fitted too."""
    colours = problem.rgb[problem.usable]
    found = fit_with_ambient(colours)
    notes["ambient"] = {"colour": found.ambient.tolist(), "stderr": found.stderr.tolist()}
    return _with_inliers(problem, reweighted(colours - found.ambient, found.C), found.ambient)


def fit_by_region_growing(problem: Problem, observation: Observation, notes: Notes) -> FittedEllipsoid:
    """The ellipsoid of the largest region grown to a tolerance (the report's [9]): no robust regression."""
    fit, _ = grow_region(problem.rgb, problem.usable)
    return _with_inliers(problem, fit)


def fit_from_patches(problem: Problem, observation: Observation, notes: Notes) -> FittedEllipsoid:
    """The ellipsoid of the pixels that see every light, though these may be a tenth of the object."""
    return _from_patches(choose_ellipsoid(problem, observation.camera), problem, notes)


def refit_from_patches(problem: Problem, observation: Observation, C: np.ndarray, notes: Notes) -> FittedEllipsoid:
    """As ``fit_from_patches``, from the ellipsoid C (3, 3) instead of a search."""
    return _from_patches(ellipsoid_near(problem, observation.camera, C), problem, notes)


def _from_patches(chosen: ChosenEllipsoid, problem: Problem, notes: Notes) -> FittedEllipsoid:
    """The chosen ellipsoid as the record of a step."""
    notes["shell"] = {
        "share": chosen.share,
        "margin": finite_or_none(chosen.margin),
        "candidates": chosen.candidates,
        "faint_lights": chosen.refitted.hidden_lights,
    }
    own, silhouette = chosen.refitted, chosen.silhouette
    if silhouette is not None:
        notes["outline"] = {
            "rotation": silhouette.rotation.tolist(),
            "stderr_deg": np.degrees(np.sqrt(np.diag(np.linalg.inv(silhouette.precision)))).tolist(),
            "rim_misfit": None if silhouette.rim is None else silhouette.rim.misfit,
        }
    near = own.near if silhouette is None else problem.usable
    return FittedEllipsoid(
        own.fit, own.inlier, own.noise, near=near, free_of_edge=own.classified, silhouette=silhouette
    )


def _with_inliers(problem: Problem, fit: Fit, ambient: np.ndarray | float = 0.0) -> FittedEllipsoid:
    """The fit with the pixels that it accepted, and how far these are from it."""
    inlier = np.zeros(problem.usable.shape, bool)
    inlier[problem.usable] = fit.accepted
    distance = signed_distance(problem.rgb[inlier] - ambient, fit.C)
    return FittedEllipsoid(fit, inlier, mad_scale(distance), np.broadcast_to(ambient, 3))
