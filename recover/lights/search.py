"""Joint estimation of lights and shape for a solution whose rotation is undetermined, and whether it is believed.

The normals of few pixels are those of a surface under many rotations, to within noise. The pixels that miss a light
decide between these rotations, once the lights are known: they are ten times as many, and the steep ones are among
them. Lights and surface are found together (``recover.lights.lit_surface``), and believed where their residuals are
small; half of the solutions are within 2° of the truth then, on random scenes. The pixels that see every light
according to them become the inlier set, and their F that of the solution: the first inlier set may have been that of
another ellipsoid.

Where all is right, the residual is each block's noise, and more where blocks cannot follow detail. If the residual is
larger, the whole turn from the first rotation to the new one counts as a possible error.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from huesphere.recover.ellipsoid.distance import signed_distance
from huesphere.recover.lights.lit_surface import LitSurface, lit_surface
from huesphere.recover.lights.parameters import LIGHTS
from huesphere.recover.problem import Problem
from huesphere.recover.solution import Solution

LEAST_LIT_SHARE = 0.03  # of the object: fewer pixels that see every light are too few for an inlier set


@dataclass(frozen=True)
class JointEstimate:
    """Lights and surface that explain the whole picture, and the solution that follows from them."""

    solution: Solution  # F, the pixels that see every light, and the covariance of the rotation
    surface: LitSurface


def estimate_jointly(problem: Problem, solution: Solution) -> tuple[JointEstimate | None, dict[str, Any]]:
    """(lights and surface by the whole picture, None if they are not believed; diagnostics).

    ``solution``: the first F with its inliers and the covariance of its rotation. Diagnostics: ``used``, and unless the
    equations broke down ``loss``, ``explained`` (share of the blocks), ``turned_deg`` (angle between the first rotation
    and the new one) and ``lights``.
    """
    try:
        found = lit_surface(problem, solution)
        change = np.linalg.solve(found.F, solution.F)
    except (np.linalg.LinAlgError, RuntimeError):  # the latter of non-negative least squares
        return None, {"used": False}
    U, _, Vt = np.linalg.svd(change)  # U Vt is the rotation nearest to the change of F
    turned = float(np.degrees(np.arccos(np.clip((np.trace(U @ Vt) - 1) / 2, -1, 1))))
    diagnostics: dict[str, Any] = {"loss": found.loss, "explained": found.explained, "turned_deg": turned}
    diagnostics["lights"] = [
        {"direction": a.tolist(), "colour": b.tolist()} for a, b in zip(found.toward, found.colour)
    ]
    all_lit = _all_lit(problem, found)
    same_chirality = np.linalg.det(change) > 0
    enough = all_lit.sum() > LEAST_LIT_SHARE * problem.mask.sum()
    used = bool(found.loss < LIGHTS.believed_loss and same_chirality and enough)
    diagnostics["used"] = used
    if not used:
        return None, diagnostics
    covariance = _rotation_covariance(found, found.normals[all_lit])
    if found.loss > _expected_loss(found.explained):
        covariance = covariance + np.radians(turned) ** 2 / 3 * np.eye(3)
    better = replace(solution, F=found.F, inlier=all_lit, rotation_covariance=covariance)
    return JointEstimate(better, found), diagnostics


def _all_lit(problem: Problem, found: LitSurface) -> np.ndarray:
    """Pixels (H, W) that see every light, by the surface and by their colour.

    The surface turns away from no light by more than the noise, and the colour is on the ellipsoid.
    """
    lost = np.maximum(-np.nan_to_num(found.normals) @ found.toward.T, 0.0) @ found.colour
    all_lit = problem.seen & (np.linalg.norm(lost, axis=-1) < problem.noise)
    distance = signed_distance(problem.rgb[all_lit], np.linalg.inv(found.F @ found.F.T))
    all_lit[all_lit] = np.abs(distance) < LIGHTS.outlier_deviations * problem.noise
    return all_lit


def _expected_loss(explained: float) -> float:
    """The largest loss of a right solution of which a share of the blocks is ``explained``."""
    if explained > LIGHTS.smooth_share:
        return LIGHTS.smooth_loss
    return LIGHTS.expected_loss + LIGHTS.expected_loss_of_detail * (1 - explained)


def _rotation_covariance(found: LitSurface, n: np.ndarray) -> np.ndarray:
    """(3, 3) radians², of the small rotation ω by which an error δF of F turns normals n (P, 3).

    ω fits F⁻¹δF n ≈ n × ω by least squares over the normals.
    """
    gram = len(n) * np.eye(3) - n.T @ n  # Σ |n × ω|² = ωᵀ gram ω
    # The right side is Σ n × (F⁻¹ δF n), up to its sign: linear in the elements of δF, row by row.
    M, moments = np.linalg.inv(found.F), n.T @ n
    by_F = np.einsum("ijk,km,lj->iml", _LEVI_CIVITA, M, moments).reshape(3, 9)
    T = np.linalg.solve(gram, by_F)
    larger = LIGHTS.error_beyond_noise * max(1.0, found.loss) ** 2
    return larger**2 * T @ found.covariance @ T.T  # type: ignore[no-any-return]


# ε_ijk: 1 for even permutations of the axes, −1 for odd ones, else 0.
_LEVI_CIVITA = np.array([[[(i - j) * (j - k) * (k - i) / 2 for k in range(3)] for j in range(3)] for i in range(3)])
