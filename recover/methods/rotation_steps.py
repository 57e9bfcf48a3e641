"""The steps by which methods determine the rotation: closed form, weak form, tangents, alternation, random steps.

Each ``rotate_…`` takes rotated normals N = Ĝρ (H, W, 3) with the symmetric root Ĝ of C, the ellipsoid with its inliers,
the problem, and the notes, into which it writes diagnostics. C has a second kind of root, −Ĝ, whose determinant has the
other sign; the steps try both. They raise RecoveryFailure: too-scattered, no-convergence.
"""

import contextlib
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from huesphere.recover.baselines.kontsevich1994 import random_descent
from huesphere.recover.cues.linear_integrability import likely_rotations
from huesphere.recover.cues.parameters import CUES
from huesphere.recover.cues.silhouette import SilhouetteRotation, silhouette_of
from huesphere.recover.geometry.rotations import rotation_by, turn_between
from huesphere.recover.geometry.sphere import unit
from huesphere.recover.io.estimate import AngleCurves
from huesphere.recover.methods.parameters import METHOD
from huesphere.recover.methods.pipeline import RotationStep
from huesphere.recover.methods.records import FittedEllipsoid, FittedRotation, Notes, finite_or_none
from huesphere.recover.problem import Problem
from huesphere.recover.rotation.alternation import alternate
from huesphere.recover.rotation.closed_form import Attitude, closed_form
from huesphere.recover.rotation.tangents import TangentRotation, tangent_rotation, without_edge
from huesphere.recover.rotation.weak_form import WeakRotation, weak_rotation, without_specks
from huesphere.recover.status import RecoveryFailure

LEAST_GRAIN = 2e-4  # radians of a normal: rounding in single precision and curvature within a block make as much
# Standard error from which the weak form's rotation is combined with the silhouette's, which is known to 3.5 degrees; a
# surer one would be drawn away (research log, "Rounds of interreflection that converge").
SILHOUETTE_FROM_DEG = 2.0
STARTS = 3  # rotations of each handedness that are refined besides the closed forms
ALPHA_DEG = np.arange(0.0, 91.0)  # where the curves of the report's Fig. 1(f) are kept


class _ClosedForm(NamedTuple):
    """The closed form on one of the two roots, and the matrix that takes N = Ĝρ to the camera frame."""

    attitude: Attitude
    matrix: np.ndarray  # (3, 3)


def rotate_in_closed_form(N: np.ndarray, ellipsoid: FittedEllipsoid, problem: Problem, notes: Notes) -> RotationStep:
    """The report's closed form (3.1–3.4). Its error is bias: its uncertainty is the angle to the weak form."""
    best = _closed_forms(N, ellipsoid.inlier, notes)[0]
    rotation = _with_uncertainty_of_weak_form(
        N, ellipsoid, problem, best.matrix, True, notes, key="turn_from_closed_form_deg"
    )
    return RotationStep(rotation, _curves(best.attitude))


def rotate_by_weak_form(N: np.ndarray, ellipsoid: FittedEllipsoid, problem: Problem, notes: Notes) -> RotationStep:
    """The rotation by integrability in weak form (``recover.rotation.weak_form``), over the ellipsoid's inliers.

    Its starts are the closed forms for the two roots Ĝ and −Ĝ and the rotation of the silhouette, besides its own
    scan. Under parallel rays an uncertain result is combined with the silhouette's: indirect light bends the curls, and
    hardly the mean normals at opposite places of the silhouette. The curves of the result are those of the closed form
    with the smaller integral (18).
    """
    starts = _closed_forms(N, ellipsoid.inlier, notes)
    silhouette = _of_silhouette(N, ellipsoid, problem)
    extra = [] if silhouette is None else [silhouette.rotation]
    weak = weak_rotation(unit(N), ellipsoid.inlier, extra + [start.matrix for start in starts], problem.ray)
    turn = turn_between(weak.rotation, starts[0].matrix)
    notes["weak"] = _noted(weak) | {"turn_from_closed_form_deg": float(np.degrees(turn))}
    rotation = _of_weak_form(weak)
    if weak.twin is None:
        rotation = with_silhouette(rotation, silhouette)
    notes["weak"]["turn_to_silhouette_deg"] = float(np.degrees(turn_between(rotation.matrix, weak.rotation)))
    return RotationStep(rotation, _curves(starts[0].attitude))


def with_silhouette(rotation: FittedRotation, silhouette: SilhouetteRotation | None) -> FittedRotation:
    """The mean, by their precision, of an uncertain ``rotation`` and that of the ``silhouette``.

    The rotation itself is returned where its standard error is below SILHOUETTE_FROM_DEG, where there is no
    silhouette, and where the two have opposite chirality. Where the two differ by more than their errors allow, the
    result is less certain by as much.
    """
    if silhouette is None or np.degrees(np.sqrt(np.trace(rotation.covariance))) < SILHOUETTE_FROM_DEG:
        return rotation
    difference = silhouette.difference(rotation.matrix)
    if difference is None:
        return rotation
    precision = np.linalg.inv(rotation.covariance)
    of_difference = np.linalg.inv(rotation.covariance + np.linalg.inv(silhouette.precision))
    disagreement = max(1.0, float(difference @ of_difference @ difference) / CUES.disagreement)
    covariance = np.linalg.inv(precision + silhouette.precision)
    turn = covariance @ silhouette.precision @ difference
    return replace(rotation, matrix=rotation_by(turn) @ rotation.matrix, covariance=disagreement * covariance)


def _of_silhouette(N: np.ndarray, ellipsoid: FittedEllipsoid, problem: Problem) -> SilhouetteRotation | None:
    """The rotation from the silhouette and the rotated normals N (H, W, 3); None where it tells none."""
    silhouette = silhouette_of(problem.usable, problem.mask, problem.ray)
    if silhouette is None:
        return None
    share = float(ellipsoid.inlier.sum() / problem.usable.sum())
    return silhouette.rotation(N[problem.usable], share, ellipsoid.noise**2 * ellipsoid.fit.C)


def rotate_by_alternation(N: np.ndarray, ellipsoid: FittedEllipsoid, problem: Problem, notes: Notes) -> RotationStep:
    """The report's alternation (3.5), from the closed form for each root; the end with the least numerator is kept."""
    starts = _closed_forms(N, ellipsoid.inlier, notes)
    ends = []
    for start in starts:
        chirality = float(np.sign(np.linalg.det(start.matrix)))
        end = alternate(chirality * unit(N), ellipsoid.inlier, start.attitude.rotation)
        ends.append((end, chirality * end.rotation))
    end, matrix = min(ends, key=lambda entry: entry[0].numerator[1])
    notes["alternation"] = {"rounds": end.rounds, "turned_deg": float(np.degrees(end.turned))}
    rotation = _with_uncertainty_of_weak_form(N, ellipsoid, problem, matrix, end.converged, notes)
    return RotationStep(rotation, _curves(starts[0].attitude))


def rotate_by_random_steps(N: np.ndarray, ellipsoid: FittedEllipsoid, problem: Problem, notes: Notes) -> RotationStep:
    """Random steps that lower Eq. (13), for each root (the report's [9]); the end with the smaller integral is kept."""
    closed = _closed_forms(N, ellipsoid.inlier, notes)  # for the diagnostics and curves
    ends = [(random_descent(chirality * unit(N), ellipsoid.inlier), chirality) for chirality in (1.0, -1.0)]
    end, chirality = min(ends, key=lambda entry: entry[0].integral)
    notes["random_steps"] = {"integral": finite_or_none(end.integral), "accepted": end.accepted}
    matrix = chirality * end.rotation
    rotation = _with_uncertainty_of_weak_form(N, ellipsoid, problem, matrix, end.converged, notes)
    return RotationStep(rotation, _curves(closed[0].attitude))


def rotate_by_tangents(N: np.ndarray, ellipsoid: FittedEllipsoid, problem: Problem, notes: Notes) -> RotationStep:
    """The rotation with a depth map on a grid of cells (``recover.rotation.tangents``).

    It starts from the rotation that the silhouette gives, or from the closed forms and rotations of all kinds. Where
    the surface has detail as fine as the cells, the residual exceeds the noise; the weak form, which loses no detail,
    may then have the smaller covariance, and its rotation is taken instead.
    """
    closed = _closed_forms(N, ellipsoid.inlier, notes)
    starts = [start.matrix for start in closed]
    G = ellipsoid.root
    covariance = ellipsoid.noise**2 * (G @ G.T) + LEAST_GRAIN**2 * np.eye(3)
    found = _by_tangents(N, ellipsoid, problem, covariance, starts)
    notes["tangents"] = {
        "misfit": found.misfit,
        "freedom": found.freedom,
        "rival": finite_or_none(found.runner_up),
        "strain": found.robust_loss,
        "starts": found.starts,
        "converged": found.converged,
        "rotation_stderr_deg": np.degrees(np.sqrt(np.diag(found.covariance))).tolist(),
        "turn_from_closed_form_deg": float(np.degrees(turn_between(found.rotation, starts[0]))),
    }
    rotation = _of_tangents(found)
    if found.misfit > METHOD.fine_detail_misfit or not found.converged:
        with contextlib.suppress(RecoveryFailure):
            rotation = _weak_form_if_better(N, ellipsoid, problem, found, starts, notes) or rotation
    return RotationStep(rotation, _curves(closed[0].attitude))


def _by_tangents(
    N: np.ndarray, ellipsoid: FittedEllipsoid, problem: Problem, covariance: np.ndarray, starts: list[np.ndarray]
) -> TangentRotation:
    """The rotation by tangents, where the noise of N has the ``covariance`` (3, 3).

    The only start is the silhouette's rotation if that leads to a good solution; otherwise the ``starts`` (3, 3) and
    likely rotations of all directions are used too.
    """
    inside = ellipsoid.inlier if ellipsoid.free_of_edge else without_edge(ellipsoid.inlier)
    silhouette = ellipsoid.silhouette
    if silhouette is not None:
        with contextlib.suppress(RecoveryFailure):
            found = tangent_rotation(N, inside, covariance, [silhouette.rotation], problem.ray, silhouette)
            agrees = silhouette.loss(found.rotation) < METHOD.silhouette_conflict
            good = found.converged and found.robust_loss < METHOD.high_loss and agrees
            if good and found.misfit < METHOD.noise_free_misfit:
                return found
            if good:  # without noise fine detail leaves as large a residual as the wrong chirality does
                everything = [silhouette.rotation, *starts]
                return tangent_rotation(N, inside, covariance, everything, problem.ray, silhouette)
        starts = [silhouette.rotation, *starts]
    noise = float(np.sqrt(np.trace(covariance) / 3))
    starts = starts + likely_rotations(N, ellipsoid.inlier, np.eye(3), noise=noise, count=STARTS, ray=problem.ray)
    return tangent_rotation(N, inside, covariance, starts, problem.ray, silhouette)


def _weak_form_if_better(
    N: np.ndarray,
    ellipsoid: FittedEllipsoid,
    problem: Problem,
    found: TangentRotation,
    starts: list[np.ndarray],
    notes: Notes,
) -> FittedRotation | None:
    """The weak form's rotation if its covariance is smaller than that of the tangents' result ``found``, else None."""
    has_silhouette = ellipsoid.silhouette is not None
    # A scan over all rotations only where neither the silhouette nor the tangents say which solution is the right one.
    search = not has_silhouette and not found.converged and found.runner_up < METHOD.clear_runner_up
    others = [] if has_silhouette else starts[:2]
    weak = weak_rotation(unit(N), ellipsoid.inlier, [found.rotation, *others], problem.ray, search=search)
    notes["weak"] = _noted(weak)
    surer = np.trace(weak.covariance) < METHOD.shadow_inflation**2 * np.trace(found.covariance)
    sound = found.converged and found.misfit < METHOD.noise_free_misfit
    if weak.functions >= METHOD.fewest_bumps and (surer or (weak.converged and not sound)):
        return _of_weak_form(weak)
    return None


def _of_tangents(found: TangentRotation) -> FittedRotation:
    """The tangents' rotation with an inflated covariance.

    The covariance of independent noise is too small where the residual is spatially correlated, and more so where a
    distinct other rotation has nearly the same loss.
    """
    loss = np.sqrt(METHOD.medium_loss * max(METHOD.calm_loss, found.robust_loss))
    inflation = METHOD.shadow_inflation**2 * loss * (1 + METHOD.clear_runner_up / max(found.runner_up, 1e-3))
    rotation = FittedRotation(found.rotation, inflation * found.covariance, found.converged, found.stretch)
    if found.twin is None:
        return rotation
    other = replace(rotation, matrix=found.twin[0], stretch=found.twin[1])
    return replace(rotation, other=other, other_ratio=found.twin_ratio)


def _of_weak_form(weak: WeakRotation) -> FittedRotation:
    """The weak form's result as the record of a rotation, with its twin in perspective."""
    rotation = FittedRotation(weak.rotation, weak.covariance, weak.converged)
    if weak.twin is None:
        return rotation
    return replace(rotation, other=replace(rotation, matrix=weak.twin), other_ratio=weak.twin_ratio)


def _with_uncertainty_of_weak_form(
    N: np.ndarray,
    ellipsoid: FittedEllipsoid,
    problem: Problem,
    matrix: np.ndarray,
    converged: bool,
    notes: Notes,
    *,
    key: str = "turn_deg",
) -> FittedRotation:
    """The rotation ``matrix``, whose error may be bias: the angle to the weak form's rotation is its uncertainty.

    ``key``: the name of that angle in the ``notes``.
    """
    weak = weak_rotation(unit(N), without_specks(ellipsoid.inlier), [matrix], problem.ray)
    turn = turn_between(weak.rotation, matrix)
    notes["weak"] = {key: float(np.degrees(turn)), "scale": weak.scale}
    return FittedRotation(matrix, turn**2 / 3 * np.eye(3) + weak.covariance, converged)


def _closed_forms(N: np.ndarray, inlier: np.ndarray, notes: Notes) -> list[_ClosedForm]:
    """The closed form for each of the roots Ĝ and −Ĝ, in order of the integral (18)."""
    found = []
    for chirality in (1.0, -1.0):
        attitude = closed_form(chirality * N, inlier)
        found.append(_ClosedForm(attitude, chirality * attitude.rotation))
    found.sort(key=lambda entry: entry.attitude.integral)
    best = found[0].attitude
    notes["s_eigen"] = {"values": best.eigenvalues.tolist(), "vectors": best.eigenvectors.tolist()}
    notes["closed_form"] = {
        "r3_negative_share": best.negative_share,
        "integral": best.integral,
        "integral_other_hand": found[1].attitude.integral,
    }
    return found


def _curves(attitude: Attitude) -> AngleCurves:
    """Eq. (18) and the left side of Eq. (19) over α, for both choices of u1."""
    alpha = np.radians(ALPHA_DEG)
    return AngleCurves(
        alpha_deg=ALPHA_DEG,
        value=np.stack([angle.integral_at(alpha) for angle in attitude.angles]),
        condition=np.stack([angle.condition(alpha) for angle in attitude.angles]),
        candidate=attitude.chosen,
        chosen=float(np.degrees(attitude.angles[attitude.chosen].alpha)),
    )


def _noted(weak: WeakRotation) -> Notes:
    """The diagnostics of the weak form."""
    return {
        "scale": weak.scale,
        "stencil": weak.stencil,
        "functions": weak.functions,
        "radius": weak.radius,
        "starts": weak.starts,
        "other_hand": finite_or_none(weak.other_hand),
        "converged": weak.converged,
        "rotation_stderr_deg": np.degrees(np.sqrt(np.diag(weak.covariance))).tolist(),
    }
