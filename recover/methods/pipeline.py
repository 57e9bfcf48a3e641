"""The steps shared by all methods that fit one ellipsoid, in the order of the report.

- Choose the usable pixels.
- Require that the colours span three dimensions.
- Fit the ellipsoid, and require that the colours determine it.
- Take its root, and find the rotation.
- Choose the convex or the concave solution.
- Compute normals, F and their uncertainty.

Methods differ in how they fit the ellipsoid and in what fixes the rotation.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from huesphere.recover.cues.convexity import choose_twin
from huesphere.recover.ellipsoid.fit import definiteness
from huesphere.recover.geometry.rays import facing_camera
from huesphere.recover.geometry.tangent_uncertainty import normal_uncertainty_deg
from huesphere.recover.io.estimate import AngleCurves, EllipsoidFit, Estimate
from huesphere.recover.methods.parameters import METHOD
from huesphere.recover.methods.records import FittedEllipsoid, FittedRotation, Notes, Oriented, finite_or_none
from huesphere.recover.pixels.noise import camera_noise
from huesphere.recover.pixels.usable import Pixels, colour_signal, problem_of, spans_a_plane, usable_pixels
from huesphere.recover.problem import Problem
from huesphere.recover.reasons import Reason
from huesphere.recover.solution import Convexity, Solution
from huesphere.recover.status import RecoveryFailure
from huesphere.render.dataset import Observation


@dataclass(frozen=True)
class RotationStep:
    """What a rotation step returns: the rotation, and the report's curves over the angle α where it drew them."""

    rotation: FittedRotation
    curves: AngleCurves | None = None


FitEllipsoid = Callable[[Problem, Observation, Notes], FittedEllipsoid]
FitRotation = Callable[[np.ndarray, FittedEllipsoid, Problem, Notes], RotationStep]
Review = Callable[[Problem, Oriented, Notes], Oriented | None]


def run_pipeline(
    observation: Observation,
    fit_ellipsoid: FitEllipsoid,
    fit_rotation: FitRotation,
    review: Review = lambda problem, found, notes: None,
    *,
    window: int = 1,
) -> Estimate:
    """The estimate of a method that fits one ellipsoid and one rotation; a failure is its status, not an exception.

    ``review`` may put another ellipsoid and rotation in the place of the first once both are known; None: it does not.
    ``window``: side in pixels of the squares whose mean colour must span three dimensions; a method that works on
    single pixels needs single pixels that do.
    """
    attempt = _Attempt(observation, window)
    status, message = "ok", ""
    try:
        attempt.run(fit_ellipsoid, fit_rotation, review)
    except RecoveryFailure as failure:
        status, message = failure.status, failure.message
    except np.linalg.LinAlgError as error:  # colours of a kind that none of the checks before has a name for
        status, message = "singular", RecoveryFailure("singular", str(error)).message
    return attempt.estimate(status, message)


class _Attempt:
    """What is known so far of one run; a failure keeps it."""

    def __init__(self, observation: Observation, window: int) -> None:
        shape = observation.mask.shape
        self.observation, self.window = observation, window
        self.notes: Notes = {}
        self.normals = np.full((*shape, 3), np.nan)  # (H, W, 3) camera frame
        self.uncertainty_deg = np.full(shape, np.nan)  # (H, W)
        self.inlier = np.zeros(shape, bool)  # (H, W) on the ellipsoid
        self.reason = np.where(observation.mask, Reason.NO_SOLUTION, Reason.BACKGROUND).astype(np.uint8)
        self.solution: Solution | None = None
        self.ellipsoid: EllipsoidFit | None = None
        self.curves: AngleCurves | None = None

    def run(self, fit_ellipsoid: FitEllipsoid, fit_rotation: FitRotation, review: Review) -> None:
        """Fill in what is found. Raises RecoveryFailure as soon as nothing can follow."""
        pixels = usable_pixels(self.observation)
        problem = problem_of(pixels, self.observation)
        self.notes["pixels"] = pixels.counts
        require_colours(problem.rgb, problem.usable, self.notes, self.window)

        ellipsoid = fit_ellipsoid(problem, self.observation, self.notes)
        self._note_ellipsoid(ellipsoid, problem)
        require_ellipsoid(ellipsoid, problem, self.window)

        self.notes["s_eigen"] = None
        step = fit_rotation(ellipsoid.rotated_normals(problem.rgb), ellipsoid, problem, self.notes)
        self.curves = step.curves
        oriented, convexity = _convex_or_concave(ellipsoid, step.rotation, problem)
        better = review(problem, oriented, self.notes)
        if better is not None:
            oriented = better
            self._note_ellipsoid(better.ellipsoid, problem)
            convexity = replace(convexity, turn=better.rotation.twin().matrix @ better.rotation.matrix.T)
        self._solve(oriented, convexity, problem, pixels)

    def _note_ellipsoid(self, ellipsoid: FittedEllipsoid, problem: Problem) -> None:
        """Keep the ellipsoid's statistics, and of each pixel on which side of it its colour lies."""
        fit = ellipsoid.fit
        self.inlier = ellipsoid.inlier
        self.ellipsoid = EllipsoidFit(s0=fit.s0, r2=fit.r2, accepted=int(fit.accepted.sum()))
        self.notes["coefficients"] = [dict(c, t=finite_or_none(float(c["t"]))) for c in fit.coefficients]
        self.reason[problem.usable] = np.where(fit.residual > 0, Reason.OUTLIER_BRIGHT, Reason.OUTLIER)

    def _solve(self, oriented: Oriented, convexity: Convexity, problem: Problem, pixels: Pixels) -> None:
        """Normals, F and their uncertainty from the ellipsoid and its rotation."""
        ellipsoid, rotation, F = oriented.ellipsoid, oriented.rotation, oriented.F
        on = ellipsoid.inlier
        N = ellipsoid.rotated_normals(problem.rgb)
        self.normals = rotation.normals(N, on)
        self.reason = np.where(on, Reason.ALL_LIT, np.where(pixels.lost > 0, pixels.lost, self.reason)).astype(np.uint8)

        camera, level = self.observation.camera, float(np.median(problem.rgb[on]))
        known = camera_noise(camera, level) if camera.known else 0.0
        # The larger of the two: a camera known to be clean does not make a poor fit a good one.
        noise = max(ellipsoid.noise, known)
        self.notes["noise"] = {"sigma": noise, "from_fit": ellipsoid.noise, "from_camera": known}
        length = np.linalg.norm(N @ rotation.stretch, axis=-1)
        self.uncertainty_deg[on] = normal_uncertainty_deg(
            self.normals[on], length[on], np.linalg.inv(F), noise**2 * np.eye(3), rotation.covariance
        )
        self.solution = Solution(
            F=F,
            inlier=on,
            noise=noise,
            rotation_covariance=rotation.covariance,
            fit_noise=ellipsoid.noise,
            convexity=convexity,
            by_silhouette=ellipsoid.silhouette is not None,
            ambient=ellipsoid.ambient,
        )

        negative = float((facing_camera(self.normals, problem.ray)[on] < 0).mean())
        self.notes["r3_negative_share"] = negative
        if negative > METHOD.most_negative_n3:
            raise RecoveryFailure("n3-signs", f"{negative:.0%} of the normals face away from the camera")
        if not rotation.converged:
            raise RecoveryFailure("no-convergence", "the rotation still moved when the search ended")

    def estimate(self, status: str, message: str) -> Estimate:
        """What was found, as an estimate; ``Method`` gives it its name."""
        return Estimate(
            method="",
            status=status,
            message=message,
            normals=self.normals.astype(np.float32),
            valid=np.isfinite(self.normals[..., 2]),
            inlier=self.inlier,
            uncertainty_deg=self.uncertainty_deg.astype(np.float32),
            reason=self.reason,
            solution=self.solution,
            ellipsoid=self.ellipsoid,
            curves=self.curves,
            diagnostics=self.notes,
        )


def _convex_or_concave(
    ellipsoid: FittedEllipsoid, rotation: FittedRotation, problem: Problem
) -> tuple[Oriented, Convexity]:
    """The rotation or its twin, whichever silhouette and perspective are for, and how clearly they are."""
    near = ellipsoid.inlier if ellipsoid.near is None else ellipsoid.near
    normals = rotation.normals(ellipsoid.rotated_normals(problem.rgb), near)
    choice = choose_twin(normals, near, problem.mask, ratio=rotation.other_ratio)
    taken, other = (rotation.twin(), rotation) if choice.flipped else (rotation, rotation.twin())
    turn = other.matrix @ taken.matrix.T
    return Oriented(ellipsoid, taken), Convexity(choice.flipped, choice.margin, choice.evidence, turn)


def require_colours(rgb: np.ndarray, inside: np.ndarray, notes: Notes, window: int) -> None:
    """Raise RecoveryFailure where the colours (H, W, 3) of the pixels ``inside`` (H, W) do not span three axes."""
    variation, weakest = colour_signal(rgb, inside, window=window)
    notes["signal"] = {"variation": finite_or_none(variation), "weakest_colour": finite_or_none(weakest)}
    if variation < METHOD.least_signal:
        raise RecoveryFailure("flat-surface", f"the colours vary by {variation:.2g} times their noise")
    if weakest < METHOD.least_signal:
        kind = "along one line, as under one light or lights of one colour"
        if spans_a_plane(rgb, inside, METHOD.least_signal, window=window):
            kind = "in a plane, as under two lights or lights that lie in a plane"
        raise RecoveryFailure(
            "rank-deficient-colours", f"colours lie {kind}: the third is {weakest:.2g} times its noise"
        )


def require_ellipsoid(ellipsoid: FittedEllipsoid, problem: Problem, window: int) -> None:
    """Raise RecoveryFailure where the picture does not determine the ellipsoid."""
    fit = ellipsoid.fit
    if fit.r2 < (METHOD.least_r2 if ellipsoid.silhouette is None else METHOD.least_r2_with_silhouette):
        raise RecoveryFailure(
            "no-dominant-shell", f"robust R² is {fit.r2:.3f}, half the pixels are far from any ellipsoid"
        )
    _, weakest = colour_signal(problem.rgb, ellipsoid.inlier, window=window)
    if weakest < METHOD.least_signal:
        raise RecoveryFailure("rank-deficient-colours", f"the weakest accepted colour is {weakest:.2g} times its noise")
    definite = definiteness(problem.rgb[problem.usable], ellipsoid.inlier[problem.usable], ellipsoid.noise)
    if definite < METHOD.least_signal:
        raise RecoveryFailure(
            "ellipsoid-undetermined", f"C is fixed in one direction by {definite:.2g} times the noise"
        )
