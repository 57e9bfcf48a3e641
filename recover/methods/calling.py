"""The call of a method: the observation is prepared for the method, and the estimate is judged and completed."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from huesphere.configs.threads import one_blas_thread
from huesphere.recover.full_size.normals import at_full_size
from huesphere.recover.full_size.picture import MOST_PIXELS, reduced
from huesphere.recover.geometry.reduction import reduction_of
from huesphere.recover.geometry.rotations import TWIN
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.methods.records import Notes, finite_or_none
from huesphere.recover.stages import Stage, at_work_on
from huesphere.recover.trust.evidence import Evidence, evidence_or_none
from huesphere.recover.trust.verdict import judged
from huesphere.render.dataset import Observation, linear_light

# From a judged estimate, the evidence for it and the picture to another estimate with its evidence, which is not judged
# yet; None: the first one stays.
SecondOpinion = Callable[[Estimate, Evidence | None, Observation], tuple[Estimate, Evidence] | None]


def estimate_by(
    name: str,
    function: Callable[[Observation], Estimate],
    observation: Observation,
    most_pixels: int | None = None,
    otherwise: SecondOpinion | None = None,
) -> Estimate:
    """The estimate of the method ``name``, a ``function`` for observations in linear light.

    Samples that are still encoded for a display are decoded; linear-algebra libraries (BLAS) use one thread; a large
    picture is reduced, and the estimate taken back to its size (``recover.full_size``); the estimate is judged
    (``recover.trust.verdict``); the diagnostics get what follows from the estimate's records, so that the two cannot
    disagree. ``most_pixels``: the number of object pixels above which the picture is reduced; None: MOST_PIXELS.
    ``otherwise``: gives another estimate where the verdict on this one is not "trust".
    """
    with one_blas_thread():
        linear = linear_light(observation)
        by = reduction_of(linear.mask, most_pixels or MOST_PIXELS)
        if by is None:
            estimate = _judged_by(function, linear, otherwise)
        else:
            at_work_on(Stage.REDUCTION)
            picture = reduced(linear, by)
            small = _judged_by(function, picture, otherwise)
            at_work_on(Stage.FULL_SIZE)
            estimate = at_full_size(small, picture, linear, by)
    return replace(estimate, method=name, diagnostics=estimate.diagnostics | _derived(estimate))


def _judged_by(
    function: Callable[[Observation], Estimate], observation: Observation, otherwise: SecondOpinion | None
) -> Estimate:
    """The estimate by a ``function``, or the second opinion, with its verdict; the observation is in linear light."""
    at_work_on(Stage.ELLIPSOID)
    estimate = function(observation)
    at_work_on(Stage.VERDICT)
    evidence = evidence_or_none(estimate, observation)
    first = judged(estimate, observation, evidence)
    if otherwise is None or first.verdict == "trust":
        return first
    opinion = otherwise(first, evidence, observation)
    if opinion is None:
        return first
    other, evidence = opinion
    return judged(other, observation, evidence)


def _derived(estimate: Estimate) -> Notes:
    """The entries of the diagnostics that follow from the estimate's records; keys in docs/format.md."""
    notes: Notes = {}
    if estimate.ellipsoid is not None:
        fit = estimate.ellipsoid
        notes |= {"s0": fit.s0, "r2": fit.r2, "accepted": fit.accepted}
    if estimate.solution is not None:
        solution, convexity = estimate.solution, estimate.solution.convexity
        twin: Notes = {
            "flipped": convexity.flipped,
            "margin": convexity.margin,
            "evidence": convexity.evidence,
        }
        if not np.allclose(convexity.turn, TWIN, rtol=0, atol=1e-9):  # in perspective only
            twin["turn"] = convexity.turn.tolist()
        notes |= {
            "C": solution.C.tolist(),
            "F": solution.F.tolist(),
            "rotation": solution.rotation.tolist(),
            "rotation_stderr_deg": finite_or_none(solution.rotation_stderr_deg),
            "reflection": solution.reflection,
            "cond_F": finite_or_none(solution.condition),
            "twin": twin,
        }
    if estimate.curves is not None:
        notes["alpha_curve"] = estimate.curves.record()
    if estimate.lights is not None:
        notes["lights"] = estimate.lights.record()
    if estimate.steps:
        notes["auto"] = list(estimate.steps)
    return notes
