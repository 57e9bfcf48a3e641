"""The second opinion of ``auto``: brightness left free, where the picture contradicts a uniform one.

An object of one hue whose brightness varies has no colour ellipsoid. What the steps of ``auto`` make of it either fails
or is doubted, because colours do not lie on one ellipsoid or normals disagree with the silhouette. Only then, and only
where there is a silhouette, `uniform-hue` is asked. It takes the place of the first estimate where that has no normals,
or where it states smaller errors over the whole object, or where the first one is the farther from the silhouette by
more than the second says it may be off. Both are doubtful; it is a choice between them.
"""

from dataclasses import replace

import numpy as np

from huesphere.recover.cues.silhouette import has_silhouette
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.methods.near_lights import has_known_near_lights
from huesphere.recover.methods.uniform_hue import recover_of_uniform_hue
from huesphere.recover.trust.evidence import Evidence, evidence_or_none
from huesphere.recover.trust.verdict import DOUBTED, factors_of
from huesphere.render.dataset import Observation

UNCOVERED_DEG = 90.0  # error that a pixel without a normal counts as having
# Statuses that a free brightness cannot mend: too few pixels or too little colour.
NOTHING_TO_SEE = ("too-few-pixels", "not-finite", "saturated", "flat-surface", "rank-deficient-colours")
# Statuses of a residual that is a function of the normal, where the first estimate has normals.
OF_THE_LIGHT = ("extended-lights", "no-dominant-shell")


def with_free_brightness(
    first: Estimate, evidence: Evidence | None, observation: Observation
) -> tuple[Estimate, Evidence] | None:
    """The estimate of `uniform-hue`, with the evidence for it, where it is the better one; None: the ``first`` stays.

    ``first``: an estimate that was judged; ``evidence``: for it, None where it has no normals that can be tested.
    """
    if first.verdict == "trust" or first.status in NOTHING_TO_SEE:
        return None
    if first.status in OF_THE_LIGHT and first.valid.any():
        return None
    if not has_silhouette(observation.mask) or has_known_near_lights(observation):
        return None
    if evidence is not None and not _contradicted(evidence):
        return None
    free = recover_of_uniform_hue(observation)
    other = evidence_or_none(free, observation)
    if other is None:
        return None
    reason = _reason(first, free, evidence, other, observation.mask)
    if reason is None:
        return None
    return replace(free, steps=(*first.steps, f"brightness: left free at every pixel ({reason})")), other


def _contradicted(evidence: Evidence) -> bool:
    """Whether colours do not lie on one ellipsoid, or normals disagree with the silhouette."""
    credibility = factors_of(evidence)
    return min(credibility["model"], credibility["hand"]) < DOUBTED


def _reason(
    first: Estimate, free: Estimate, evidence: Evidence | None, other: Evidence, mask: np.ndarray
) -> str | None:
    """Why the estimate of free brightness is taken; None: it is not."""
    if evidence is None:
        return f"{first.status}: no normals of uniform brightness"
    stated, of_free = _stated_deg(first, mask), _stated_deg(free, mask)
    if of_free < stated:
        return f"stated error {of_free:.2g}° instead of {stated:.2g}°, and colours do not lie on one ellipsoid"
    farther = evidence.template_deg - other.template_deg
    if farther > of_free + stated:
        return f"{farther:.0f}° nearer to the silhouette, and colours do not lie on one ellipsoid"
    return None


def _stated_deg(estimate: Estimate, mask: np.ndarray) -> float:
    """Median stated error over the object ``mask`` (H, W)."""
    return float(np.median(np.where(estimate.valid, estimate.uncertainty_deg, UNCOVERED_DEG)[mask]))
