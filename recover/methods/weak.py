"""Method ``weak-integrability``: the ellipsoid refitted to its own pixels, integrability in weak form."""

import numpy as np

from huesphere.recover.io.estimate import Estimate
from huesphere.recover.methods.ellipsoid_steps import fit_and_polish, polished_ellipsoid, reported_ellipsoid
from huesphere.recover.methods.pipeline import run_pipeline
from huesphere.recover.methods.records import FittedEllipsoid, Notes
from huesphere.recover.methods.rotation_steps import rotate_by_weak_form
from huesphere.recover.problem import Problem
from huesphere.recover.status import RecoveryFailure
from huesphere.render.dataset import Observation


def recover_weak_integrability(observation: Observation) -> Estimate:
    """Least Median of Squares, refitted without the noise's bias; no derivative of noisy data is taken."""
    return run_pipeline(observation, fit_and_polish, rotate_by_weak_form)


def recover_weak_integrability_near(observation: Observation, C: np.ndarray) -> Estimate:
    """The same without a search: the ellipsoid C (3, 3), inverse squared picture units, is near the right one."""

    def polish(problem: Problem, observation: Observation, notes: Notes) -> FittedEllipsoid:
        try:
            return polished_ellipsoid(problem, C, notes)
        except RecoveryFailure:
            return reported_ellipsoid(problem, C)

    return run_pipeline(observation, polish, rotate_by_weak_form)
