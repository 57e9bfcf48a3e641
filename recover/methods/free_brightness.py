"""The steps shared by the methods that let the albedo a(x) differ at every pixel, ρ = a(x) F n.

In this order:

- Choose the usable pixels.
- Require a silhouette.
- Require that the colours span three dimensions.
- Find one matrix G; the methods differ in how they find it.
- Normals are Gρ / |Gρ|, the albedo is |Gρ| up to one factor, F = G⁻¹.
- Compute the uncertainty.

No ellipsoid is fitted: where the albedo may differ at every pixel, any colour lies on it. Every usable pixel is taken
to see every light.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from huesphere.recover.cues.convexity import outward_margin
from huesphere.recover.cues.silhouette import has_silhouette
from huesphere.recover.geometry.rays import facing_camera
from huesphere.recover.geometry.tangent_uncertainty import normal_uncertainty_deg
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.methods.parameters import METHOD
from huesphere.recover.methods.pipeline import require_colours
from huesphere.recover.methods.records import Notes
from huesphere.recover.pixels.noise import camera_noise, picture_noise
from huesphere.recover.pixels.usable import Pixels, problem_of, usable_pixels
from huesphere.recover.problem import Problem
from huesphere.recover.reasons import Reason
from huesphere.recover.solution import Convexity, Solution
from huesphere.recover.status import RecoveryFailure
from huesphere.render.dataset import Observation


@dataclass(frozen=True)
class FoundMatrix:
    """G of ρ = a F n with G ∝ F⁻¹, and the errors of the normals that follow from an error of G."""

    G: np.ndarray  # (3, 3) n ∝ Gρ
    error_deg: Callable[[np.ndarray, np.ndarray], np.ndarray]  # of colours (P, 3) and normals (P, 3): (P,) degrees
    rotation_covariance: np.ndarray  # (3, 3) radians², of a small rotation of the camera frame


FindMatrix = Callable[[Problem, Notes], FoundMatrix]


def recover_with_free_brightness(observation: Observation, find: FindMatrix) -> Estimate:
    """The estimate of a method whose function ``find`` returns the matrix G; ``observation`` is in linear light.

    A RecoveryFailure or a singular matrix gives an estimate without normals and with its status, not an exception.
    ``method`` of the estimate is left empty: ``estimate_by`` fills it.
    """
    shape = observation.mask.shape
    notes: Notes = {}
    try:
        pixels = usable_pixels(observation)
        problem = problem_of(pixels, observation)
        problem = problem.with_noise(_noise(problem, observation))
        notes["pixels"] = pixels.counts
        notes["noise"] = {"sigma": problem.noise}
        require_silhouette(observation.mask)
        require_colours(problem.rgb, problem.usable, notes, window=1)
        return _estimate(find(problem, notes), problem, pixels, notes)
    except RecoveryFailure as caught:
        failure = caught
    except np.linalg.LinAlgError as error:
        failure = RecoveryFailure("singular", str(error))
    return Estimate(
        method="",
        status=failure.status,
        message=failure.message,
        normals=np.full((*shape, 3), np.nan, np.float32),
        valid=np.zeros(shape, bool),
        inlier=np.zeros(shape, bool),
        uncertainty_deg=np.full(shape, np.nan, np.float32),
        reason=np.where(observation.mask, Reason.NO_SOLUTION, Reason.BACKGROUND).astype(np.uint8),
        diagnostics=notes,
    )


def require_silhouette(mask: np.ndarray) -> None:
    """Raise RecoveryFailure where most of the border of the object ``mask`` (H, W) is the picture's edge."""
    if not has_silhouette(mask):
        raise RecoveryFailure("no-silhouette", "over half of the object's border is the edge of the picture")


def _noise(problem: Problem, observation: Observation) -> float:
    """Standard deviation of a channel's noise, picture units: the larger of the measured and the camera's stated one.

    The noise is measured in the calmest tenth of the picture, since texture is no noise.
    """
    camera, level = observation.camera, float(np.median(problem.rgb[problem.usable]))
    known = camera_noise(camera, level) if camera.known else 0.0
    return max(float(np.nan_to_num(picture_noise(problem.rgb, problem.usable))), known)


def _estimate(found: FoundMatrix, problem: Problem, pixels: Pixels, notes: Notes) -> Estimate:
    """Normals, albedo, F and their uncertainty from the matrix. Raises LinAlgError where it has no inverse."""
    usable, colours = problem.usable, problem.rgb[problem.usable]
    along = colours @ found.G.T
    scale = float(np.median(np.linalg.norm(along, axis=1)))
    G = found.G / max(scale, 1e-300)
    length = np.maximum(np.linalg.norm(along, axis=1) / max(scale, 1e-300), 1e-12)
    n = colours @ G.T / length[:, None]
    F = np.linalg.inv(G)
    normals = np.full((*usable.shape, 3), np.nan)
    normals[usable] = n
    by_noise = normal_uncertainty_deg(n, length, G, problem.noise**2 * np.eye(3), np.zeros((3, 3)))
    uncertainty, albedo = np.full(usable.shape, np.nan), np.full(usable.shape, np.nan)
    uncertainty[usable], albedo[usable] = np.hypot(by_noise, found.error_deg(colours, n)), length
    negative = float((facing_camera(normals, problem.ray)[usable] < 0).mean())
    notes["r3_negative_share"] = negative
    status, message = "ok", ""
    if negative > METHOD.most_negative_n3:
        failure = RecoveryFailure("n3-signs", f"{negative:.0%} of the normals face away from the camera")
        status, message = failure.status, failure.message
    margin = outward_margin(np.nan_to_num(normals), usable, problem.mask)
    return Estimate(
        method="",
        status=status,
        message=message,
        normals=normals.astype(np.float32),
        valid=usable.copy(),
        inlier=usable.copy(),
        uncertainty_deg=np.minimum(uncertainty, 90.0).astype(np.float32),
        reason=np.where(usable, int(Reason.ALL_LIT), pixels.lost).astype(np.uint8),
        albedo=albedo.astype(np.float32),
        solution=Solution(
            F=F,
            inlier=usable,
            noise=problem.noise,
            rotation_covariance=found.rotation_covariance,
            fit_noise=problem.noise,
            convexity=Convexity(margin=max(margin, 0.0), evidence="silhouette"),
            by_silhouette=True,
        ),
        diagnostics=notes,
    )
