"""Method ``silhouette-matrix``: one matrix from colours to normals, regressed on the inflated silhouette.

It uses neither an ellipsoid nor integrability, so that brightness may vary in any way; and its template is a guess.
What is stated allows for that: the template's depth is known to within a factor only, and where the matrix does not
bring the colours to the template, the two disagree for reasons that may be the matrix's.
"""

import numpy as np

from huesphere.recover.cues.inflated_outline import inflated
from huesphere.recover.cues.silhouette import frame_along
from huesphere.recover.cues.silhouette_matrix import bright_enough, matrix_to_template, whitening
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.methods.free_brightness import FoundMatrix, recover_with_free_brightness
from huesphere.recover.methods.records import Notes
from huesphere.recover.parameters import learned
from huesphere.recover.problem import Problem
from huesphere.render.dataset import Observation


def recover_by_silhouette_matrix(observation: Observation) -> Estimate:
    """The matrix of the inflated silhouette, and the normals and the albedo that it makes of the picture."""
    return recover_with_free_brightness(observation, find_by_silhouette)


def find_by_silhouette(problem: Problem, notes: Notes) -> FoundMatrix:
    """G by robust regression of colour directions on the template's normals. Raises LinAlgError."""
    W = whitening(problem.rgb[problem.usable])
    white = problem.rgb @ W
    bright = bright_enough(white, problem.usable)
    template = inflated(problem.mask)[bright] @ frame_along(mean_ray(problem)).T
    d = white[bright] / np.linalg.norm(white[bright], axis=1, keepdims=True)
    G = matrix_to_template(d, template)
    n = d @ G.T
    cosine = (n * template).sum(axis=1) / np.linalg.norm(n, axis=1)
    misfit = float(np.degrees(np.median(np.arccos(np.clip(cosine, -1, 1)))))
    notes["template"] = {"misfit_deg": misfit}
    known = errors()

    def error_deg(colours: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """A depth that is off by a factor turns a normal by n3 √(1 − n3²) times its logarithm."""
        n3 = np.clip(normals[:, 2], 0, 1)
        by_depth = np.degrees(known["log depth"] * n3 * np.sqrt(1 - n3**2))
        return np.hypot(by_depth, known["share of the misfit"] * misfit)

    turn = np.radians(known["share of the misfit"] * misfit)
    return FoundMatrix(G @ W, error_deg, turn**2 / 3 * np.eye(3))


def mean_ray(problem: Problem) -> np.ndarray | None:
    """Mean ray (2,) of the object, along which its silhouette is seen; None for parallel rays."""
    return None if problem.ray is None else problem.ray[problem.usable].mean(axis=0)  # type: ignore[no-any-return]


def errors() -> dict[str, float]:
    """Errors of the template and of the matrix, measured on 38 pictures of known normals.

    "log depth": root mean square of the natural logarithm of the factor of depth with which the template suits the true
    normals best. "share of the misfit": share of the median angle between the matrix's normals and the template's that
    counts as an error of the former.
    """
    return learned("cues/silhouette_matrix_errors.json")["errors"]  # type: ignore[no-any-return]
