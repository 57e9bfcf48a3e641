"""The report's method (Drew & Kontsevich 1994), its variants, and the least squares that it is compared with."""

from huesphere.recover.io.estimate import Estimate
from huesphere.recover.methods.ellipsoid_steps import fit_all_pixels, fit_as_reported, fit_free_centre
from huesphere.recover.methods.pipeline import run_pipeline
from huesphere.recover.methods.rotation_steps import rotate_by_alternation, rotate_in_closed_form
from huesphere.render.dataset import Observation


def recover_least_squares(observation: Observation) -> Estimate:
    """Least squares over all the object's pixels, rotation in closed form: the baseline that outliers pull away."""
    return run_pipeline(observation, fit_all_pixels, rotate_in_closed_form)


def recover_drew_kontsevich(observation: Observation) -> Estimate:
    """The report: LMS, the cut at 2.5 s0, reweighted least squares, closed-form rotation; normals of accepted pixels.

    Beyond the report, both chiralities of the root are tried, and the silhouette decides between convex and concave.
    """
    return run_pipeline(observation, fit_as_reported, rotate_in_closed_form)


def recover_with_ambient(observation: Observation) -> Estimate:
    """The report's method with its ambient term (3.6): the ellipsoid's centre is fitted too, nine unknowns in all."""
    return run_pipeline(observation, fit_free_centre, rotate_in_closed_form)


def recover_by_alternation(observation: Observation) -> Estimate:
    """The report's ellipsoid; its closed form only starts the alternation r3 ↔ (r1, r2), which it did not try (3.5)."""
    return run_pipeline(observation, fit_as_reported, rotate_by_alternation)
