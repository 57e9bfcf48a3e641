"""Method ``weak-integrability``: the ellipsoid refitted to its own pixels, integrability in weak form."""

from huesphere.recover.io.estimate import Estimate
from huesphere.recover.methods.ellipsoid_steps import fit_and_polish
from huesphere.recover.methods.pipeline import run_pipeline
from huesphere.recover.methods.rotation_steps import rotate_by_weak_form
from huesphere.render.dataset import Observation


def recover_weak_integrability(observation: Observation) -> Estimate:
    """Least Median of Squares, refitted without the noise's bias; no derivative of noisy data is taken."""
    return run_pipeline(observation, fit_and_polish, rotate_by_weak_form)
