"""Method ``uniform-hue``: brightness free at every pixel, normals from the directions of the colours alone.

One matrix that makes them integrable (``recover.uniform_hue``), with the bas-relief ambiguity fixed by the silhouette,
by albedos that mostly do not change from place to place, and by albedos that spread little: each by what it is known to
for this picture.
"""

import numpy as np

from huesphere.recover.io.estimate import Estimate
from huesphere.recover.methods.free_brightness import FoundMatrix, recover_with_free_brightness
from huesphere.recover.methods.records import Notes
from huesphere.recover.problem import Problem
from huesphere.recover.uniform_hue.fit import fit
from huesphere.recover.uniform_hue.picture import picture_of
from huesphere.recover.uniform_hue.posterior import posterior
from huesphere.render.dataset import Observation


def recover_of_uniform_hue(observation: Observation) -> Estimate:
    """Normals, albedo and F of an object of one hue."""
    return recover_with_free_brightness(observation, find_by_integrability)


def find_by_integrability(problem: Problem, notes: Notes) -> FoundMatrix:
    """G by the joint fit. Raises RecoveryFailure (too-scattered), LinAlgError."""
    picture = picture_of(problem)
    found = fit(picture)
    known = posterior(found)
    notes["uniform_hue"] = {
        "scales": found.scales,
        "log_depth": found.log_depth,
        "shading": float(found.x[10]),
        "depth": _told(known.by_cue["depth"]),
        "lean_deg": _told(known.by_cue["lean_deg"]),
    }

    def error_deg(colours: np.ndarray, normals: np.ndarray) -> np.ndarray:
        return known.error_deg(colours @ picture.W, normals)

    return FoundMatrix(found.G @ picture.W, error_deg, known.rotation_covariance())


def _told(stderr: dict[str, float]) -> dict[str, object]:
    """Which cue fixes a number best, and the standard error that each leaves alone."""
    return {"by": min(stderr, key=lambda name: stderr[name]) if stderr else None, "stderr": stderr}
