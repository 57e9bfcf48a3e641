"""The verdict on an estimate: trust, doubtful or failed, with what is doubted, and stated errors that allow for it.

Every method's estimate passes here (``recover.methods.calling``). The status stays "ok", and the verdict is "trust",
only where the factor for convex or concave, and the product of all others (``recover.trust.factors``), are credible,
the stated error of the median pixel is at most MOST_MEDIAN_DEG, and that of the rotation at most MOST_ROTATION_DEG. A
method states the errors that noise causes; what the evidence says about errors of the model is added to them first
(``recover.trust.stated_error``). An estimate that leaves the brightness free at every pixel is never trusted: its
colours lie on an ellipsoid whatever the normals are.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from huesphere.recover.io.estimate import Estimate
from huesphere.recover.parameters import learned
from huesphere.recover.status import RecoveryFailure
from huesphere.recover.trust.evidence import Evidence, evidence_of
from huesphere.recover.trust.factors import FACTORS
from huesphere.recover.trust.stated_error import with_model_error
from huesphere.render.dataset import Observation

MOST_MEDIAN_DEG, MOST_ROTATION_DEG = 5.0, 3.0  # stated errors of a result that is to be trusted
FREE_BRIGHTNESS = "the brightness is free at every pixel, so that no colour contradicts the normals"
DOUBTED = 0.8  # credibility of a factor below which it is told as a doubt


def judged(estimate: Estimate, observation: Observation, evidence: Evidence | None = None) -> Estimate:
    """The ``estimate`` of the ``observation`` (linear light) with its verdict, doubts and errors.

    ``evidence``: if it is known already.
    """
    try:
        evidence = evidence or evidence_of(estimate, observation)
    except np.linalg.LinAlgError as error:
        failure = RecoveryFailure("singular", str(error))
        return replace(estimate, status=failure.status, message=failure.message, doubts=(failure.message,))
    if evidence is None:
        doubts = (estimate.message, *_about_the_object(observation)) if estimate.status != "ok" else ()
        return replace(estimate, doubts=doubts)
    credibility = factors_of(evidence)
    if estimate.albedo is None:  # the regression's scenes are of one albedo
        estimate = with_model_error(estimate, evidence, observation.mask)
    notes = {"factors": credibility, "evidence": evidence.record()}
    estimate = replace(estimate, diagnostics=estimate.diagnostics | {"trust": notes})
    found = _doubts(estimate, evidence, credibility)
    if estimate.albedo is not None:
        others = found if _refused(estimate, evidence, credibility) else []
        found = [*others, RecoveryFailure("unconfirmed-hue", FREE_BRIGHTNESS)]
    if estimate.status != "ok":
        doubts = (estimate.message, *(failure.message for failure in found), *_about_the_object(observation))
        return replace(estimate, doubts=doubts)
    if estimate.albedo is None and not _refused(estimate, evidence, credibility):
        return estimate
    doubts = (*(failure.message for failure in found), *_about_the_object(observation))
    return replace(estimate, status=found[0].status, message=found[0].message, doubts=doubts)


def _about_the_object(observation: Observation) -> tuple[str, ...]:
    """A doubt where the whole of a photograph was taken as the object."""
    if observation.camera.known or not observation.mask.all():
        return ()
    return ("the whole picture was taken as the object; if it is not, give --mask or --region",)


def weights() -> dict[str, Any]:
    """Offset and weights of each factor, and the least credibilities: of ``hand``, and of the product of the others."""
    return learned("trust/verdict_weights.json")


def factors_of(evidence: Evidence) -> dict[str, float]:
    """Credibility (0 … 1) by each factor."""
    found = {}
    for name, factor in FACTORS.items():
        own, figures = weights()["factors"][name], factor.figures(evidence)
        z = own["offset"] - sum(own["weights"][figure] * value for figure, value in figures.items())
        found[name] = float(1 / (1 + np.exp(-np.clip(z, -50, 50))))
    return found


def _refused(estimate: Estimate, evidence: Evidence, credibility: dict[str, float]) -> bool:
    """Whether an estimate of status "ok" is not to be trusted."""
    median = float(np.nanmedian(estimate.uncertainty_deg[estimate.valid]))
    of_hand = credibility["hand"]
    others = float(np.prod([value for name, value in credibility.items() if name != "hand"]))
    refused = of_hand < weights()["least"]["hand"] or others < weights()["least"]["others"]
    return refused or median > MOST_MEDIAN_DEG or _rotation_error_deg(estimate, evidence) > MOST_ROTATION_DEG


def _rotation_error_deg(estimate: Estimate, evidence: Evidence) -> float:
    """The stated error of the rotation, or its least error by the evidence if that is larger, degrees."""
    return float(np.nanmax([estimate.rotation_stderr_deg, evidence.turn_beyond_deg]))


def _doubts(estimate: Estimate, evidence: Evidence, credibility: dict[str, float]) -> list[RecoveryFailure]:
    """What speaks against the estimate, the gravest first; at least one."""
    needed = dict.fromkeys(credibility, DOUBTED) | {"hand": weights()["least"]["hand"]}
    # Credibility over what is needed, or a limit over what is stated: the less, the graver; below 1 a doubt.
    grave = {name: value / needed[name] for name, value in credibility.items()}
    median = float(np.nanmedian(estimate.uncertainty_deg[estimate.valid]))
    if estimate.rotation_stderr_deg > MOST_ROTATION_DEG:
        grave["uncertain"] = min(grave["uncertain"], MOST_ROTATION_DEG / estimate.rotation_stderr_deg)
    if evidence.turn_beyond_deg > MOST_ROTATION_DEG:
        grave["rotation"] = min(grave["rotation"], MOST_ROTATION_DEG / evidence.turn_beyond_deg)
    if median > MOST_MEDIAN_DEG:
        grave["uncertain"] = min(grave["uncertain"], MOST_MEDIAN_DEG / median)
    order = sorted(grave, key=lambda name: grave[name])
    chosen = [name for name in order if grave[name] < 1] or order[:1]
    told = replace(evidence, rotation_deg=estimate.rotation_stderr_deg)  # as stated, which evidence alone is not
    return [RecoveryFailure(FACTORS[name].status, FACTORS[name].told(told, median)) for name in chosen]
