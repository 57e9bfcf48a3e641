"""Which ellipsoid `auto` begins with: that of least median of squares, or one grown from patches of the picture.

Least median of squares finds the ellipsoid that half of the pixels lie near. If fewer than half of the pixels see every
light, that ellipsoid is a wrong one. The residual of a wrong ellipsoid is spatially correlated; the residual of the
right ellipsoid is white, except under interreflection or wide lights, where it is spatially correlated too. If the
removal of interreflection leaves a white residual, the ellipsoid of least median of squares is kept. If the residual
stays correlated, wide lights do not explain it, and the ellipsoid from patches has a white residual, the ellipsoid from
patches is taken.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from huesphere.recover.ellipsoid.lack_of_fit import LackOfFit, lack_of_fit
from huesphere.recover.every_pixel.completion import bridged
from huesphere.recover.interreflection.parameters import INTERREFLECTION
from huesphere.recover.interreflection.removal import (
    Removal,
    Restart,
    has_surface,
    remove_interreflection,
    residual_parts,
)
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.methods.parameters import METHOD
from huesphere.recover.stages import Stage, at_work_on
from huesphere.recover.status import RecoveryFailure
from huesphere.render.dataset import Observation

# A spatially correlated residual smaller than this is taken for none: rounding, and means over blocks of pixels, make
# one of this size (share of the largest channel value on the object).
LEAST_CORRELATED = 2e-4

Recoverer = Callable[[Observation], Estimate]


@dataclass(frozen=True)
class Restartable:
    """A method for pictures without interreflection, which can also begin with a given ellipsoid."""

    recover: Recoverer
    restart: Restart  # the same, from an ellipsoid near the right one


@dataclass(frozen=True)
class Initial:
    """The estimate that `auto` begins with: of the pixels that see every light, without indirect light."""

    found: Estimate
    direct: Observation  # the picture itself where nothing was subtracted
    method: Restartable  # what made ``found`` and ``before``
    before: Estimate  # of the picture itself, nothing subtracted
    removal: Removal | None = None
    from_patches: Estimate | None = None  # what the method for few all-lit pixels says, if it was asked
    doubt: RecoveryFailure | None = None  # why it may be no true ellipsoid, though no other was found
    steps: tuple[str, ...] = ()  # what was done, each with its reason


def initial_estimate(observation: Observation, dominant: Restartable, few_lit: Restartable) -> Initial:
    """The estimate that `auto` begins with, made from the picture or from the picture without its interreflection.

    ``dominant``: the method for pictures in which half of the object's pixels or more see every light. Its estimate is
    taken if ``_certain`` finds nothing against it. Otherwise ``few_lit``, the method for pictures with fewer such
    pixels, is run too, and its estimate is taken if ``_reason_for_patches`` gives a reason. The field ``steps`` of the
    result tells in words what was done and why.
    """
    first = _without_interreflection(observation, dominant, dominant.recover(observation))
    share = first.before.valid.sum() / max(1, observation.mask.sum())
    reason = None
    if not _certain(first, observation, share):
        patches = few_lit.recover(observation)
        reason = _reason_for_patches(first, patches, observation, share)
        if reason is None:
            first = replace(first, from_patches=patches, doubt=_doubt(first, observation))
        else:
            first = replace(_without_interreflection(observation, few_lit, patches), from_patches=patches)
    if reason is None:
        steps = [f"ellipsoid: least median of squares, refitted ({share:.0%} of the object)"]
    else:
        steps = [f"ellipsoid: grown from patches ({reason})"]
    removal = first.removal
    if removal is None:
        steps.append("interreflection: not removed (the light that the surface predicts does not explain the misfit)")
    else:
        steps.append(
            f"interreflection: {removal.share:.1%} of the light removed (misfit {removal.gain:.1f} times less)"
        )
    return replace(first, steps=tuple(steps))


def bend(estimate: Estimate, observation: Observation) -> LackOfFit:
    """How much of the residual of the estimate's ellipsoid depends on the normal alone.

    ``observation``: the picture that the estimate was made from, without the indirect light if that was removed.
    """
    assert estimate.solution is not None
    return lack_of_fit(observation.rgb, estimate.inlier, estimate.solution.C)


def residual_is_white(estimate: Estimate, observation: Observation) -> bool:
    """Whether the spatially correlated part of the inliers' residual is small beside the white part, or negligible."""
    white, correlated = residual_parts(estimate, observation.rgb)
    floor = LEAST_CORRELATED * float(observation.rgb[observation.mask].max())
    return correlated < max(INTERREFLECTION.correlated_is_noise * white, floor)


def _without_interreflection(observation: Observation, method: Restartable, found: Estimate) -> Initial:
    """The estimate ``found``, or that of the picture without its interreflection, where the removal is believed.

    A removal is tried where the first surface lessens the misfit by ``rescue_gain``, and believed where in the end it
    lessens it by more than ``twin_gain``: a gain that would not decide between the twins is no proof of
    interreflection.
    """
    at_work_on(Stage.INTERREFLECTION)
    again, direct, removal = remove_interreflection(
        observation,
        method.recover,
        bridged,
        first=found,
        least_gain=INTERREFLECTION.rescue_gain,
        restart=method.restart,
    )
    if removal is None or removal.gain <= INTERREFLECTION.twin_gain:
        return Initial(found, observation, method, found)
    return Initial(removal.noted(again), direct, method, found, removal)


def _certain(first: Initial, observation: Observation, share: float) -> bool:
    """Whether the ``first`` estimate is taken without a look at ellipsoids from patches.

    Where interreflection was removed: the misfit fell by a large factor, or little correlated residual is left. Where
    none was removed: the status is `ok`, the ellipsoid holds enough of the object (``share``), its residual is white.
    """
    if first.removal is not None:
        left, before = _correlation(first.found, first.direct), _correlation(first.before, observation)
        calmer = left < min(METHOD.calm_ratio, METHOD.calmer_ratio * before)
        return first.removal.gain > METHOD.sure_removal_gain or calmer
    enough = share >= METHOD.most_lit_share
    return first.found.status == "ok" and enough and residual_is_white(first.found, observation)


def _reason_for_patches(first: Initial, patches: Estimate, observation: Observation, share: float) -> str | None:
    """Why the ellipsoid from ``patches`` is taken instead of the ``first`` one; None if it is not."""
    found = first.before
    if not has_surface(found):
        return found.status
    whiter = has_surface(patches) and _whiter(patches, first, observation)
    if found.status != "ok":
        return found.status if patches.status == "ok" or whiter else None
    if patches.status == "ok" and share < METHOD.most_lit_share:
        return f"{share:.0%} of the object on the first ellipsoid"
    if whiter and not bend(found, observation).significant:
        return "the residual of the first ellipsoid is spatially correlated"
    return None


def _whiter(patches: Estimate, first: Initial, observation: Observation) -> bool:
    """Whether the residual of the ellipsoid from ``patches`` is white, or far less correlated than the ``first`` one's.

    Where interreflection was removed, being white is not enough: the residual of a wrong ellipsoid of few pixels is
    hardly more than noise too.
    """
    correlated = residual_parts(patches, observation.rgb)[1]
    left, before = residual_parts(first.found, first.direct.rgb)[1], residual_parts(first.before, observation.rgb)[1]
    if first.removal is not None:
        some = patches.valid.sum() > METHOD.least_patch_share * observation.mask.sum()
        return bool(some and correlated < METHOD.far_less_correlated * left)
    return residual_is_white(patches, observation) or correlated < METHOD.far_less_correlated * before


def _doubt(first: Initial, observation: Observation) -> RecoveryFailure | None:
    """A failure where neither noise nor interreflection nor wide lights explain the residual; else None."""
    found = first.before
    if first.removal is not None or found.status != "ok" or bend(found, observation).significant:
        return None
    assert found.solution is not None
    _, correlated = residual_parts(found, observation.rgb)
    # The angle by which an error of this size turns a normal where F is weakest: along the shortest semi-axis of the
    # ellipsoid, whose length is 1/√(largest eigenvalue of C).
    off = np.degrees(correlated * np.sqrt(np.linalg.eigvalsh(found.solution.C)[2]))
    if off < METHOD.most_correlated_deg:
        return None
    return RecoveryFailure(
        "no-dominant-shell",
        f"the residual of the first ellipsoid is spatially correlated ({off:.0f}° of normals), and no other was found",
    )


def _correlation(estimate: Estimate, observation: Observation) -> float:
    """The spatially correlated part of the residual over its white part."""
    white, correlated = residual_parts(estimate, observation.rgb)
    return correlated / max(white, 1e-300)
