"""The report's predecessor [9] (Kontsevich, Petrov & Vergelskaya 1994): random steps, regions grown to a tolerance."""

from huesphere.recover.io.estimate import Estimate
from huesphere.recover.methods.ellipsoid_steps import fit_as_reported, fit_by_region_growing
from huesphere.recover.methods.pipeline import run_pipeline
from huesphere.recover.methods.rotation_steps import rotate_by_random_steps
from huesphere.render.dataset import Observation


def recover_kontsevich_1994(observation: Observation) -> Estimate:
    """The report's ellipsoid, the rotation by random steps down Eq. (13): what the closed form was to replace."""
    return run_pipeline(observation, fit_as_reported, rotate_by_random_steps)


def recover_by_growing(observation: Observation) -> Estimate:
    """The ellipsoid of the largest region grown to a tolerance, the rotation by random steps: no robust regression."""
    return run_pipeline(observation, fit_by_region_growing, rotate_by_random_steps)
