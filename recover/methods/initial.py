"""Which shell `auto` begins with: least median of squares', cleared of interreflection if need be, or one that grew.

Least median of squares takes the ellipsoid that half the pixels are near to, and with fewer under all lights that is
none of the true ones. It betrays itself: neighbours share what their colours are off it by, where of a true shell
only noise is left over. So do they where parts of the surface light each other, and under wide lights. If taking the
light between the parts out leaves noise, that was it. If it leaves them as unlike noise as before, and one of the
shells that grow from patches has noise alone, that one is taken.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from huesphere.recover.ellipsoid.lack_of_fit import Bend, bend_of
from huesphere.recover.every_pixel.completion import bridged
from huesphere.recover.interreflection.removal import CLEARER, SHARED, Reflected, has_surface, left_over, unbounce
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.status import RecoveryFailure
from huesphere.render.dataset import Observation

Method = Callable[[Observation], Estimate]

MOST_LIT = 0.45  # share of the object on the first shell, below which half of it may be something else
NOTHING = 2e-4  # of the brightest: what neighbours may share at least, as rounding and blocks do
CALM, CALMER = 1.0, 0.8  # times a pixel's own and what they shared before: light between the parts explains it
SURELY = 5.0  # times less misfit: so it does, whatever is left
FAR_LESS, LEAST_GROWN = 0.25, 0.1  # times what neighbours share on the first shell; share of the object
MOST_OFF_DEG = 1.0  # of normals, by what neighbours share, beyond which a shell that nothing explains is not believed
LEAST_GAIN = 1.05  # times less misfit with the first surface, from which interreflection is looked into


@dataclass(frozen=True)
class FirstShell:
    """The pixels that see every light, in the picture that is left when interreflection is taken out."""

    found: Estimate
    direct: Observation  # the picture itself where nothing was taken out
    method: Method
    before: Estimate  # of the picture itself
    removed: Reflected | None = None
    grown: Estimate | None = None  # what ``hidden`` says of the picture, if it was asked
    doubt: RecoveryFailure | None = None  # why it may be no true shell, though no other was found


def first_shell(observation: Observation, dominant: Method, hidden: Method, steps: list[str]) -> FirstShell:
    """As the header tells; ``dominant`` and ``hidden`` as for `recover.methods.auto.choose_steps`. ``steps`` is told
    more.
    """
    first = _cleared(observation, dominant, dominant(observation))
    share = first.before.valid.sum() / max(1, observation.mask.sum())
    reason = None
    if not _sure(first, observation, share):
        core = hidden(observation)
        reason = _reason(first, core, observation, share)
        if reason is None:
            first = replace(first, grown=core, doubt=_doubt(first, observation))
        else:
            first = replace(_cleared(observation, hidden, core), grown=core)
    if reason is None:
        steps.append(f"shell: least median of squares, polished ({share:.0%} of the object)")
    else:
        steps.append(f"shell: grown from patches ({reason})")
    if first.removed is None:
        steps.append("interreflection: none taken out (the surface's own does not explain the misfit)")
    else:
        gain = first.removed.misfit_before / first.removed.misfit_after
        steps.append(
            f"interreflection: {first.removed.share:.1%} of the light taken out (misfit {gain:.1f} times less)"
        )
    return first


def bend(estimate: Estimate, observation: Observation) -> Bend:
    """Of the estimate's shell in the picture that it is of."""
    return bend_of(observation.rgb, estimate.inlier, np.asarray(estimate.diagnostics["C"]))


def settled(estimate: Estimate, observation: Observation) -> bool:
    """Whether what its pixels are off its ellipsoid by is their own, or next to nothing."""
    white, shared = left_over(estimate, observation.rgb)
    return shared < max(SHARED * white, NOTHING * float(observation.rgb[observation.mask].max()))


def _cleared(observation: Observation, method: Method, found: Estimate) -> FirstShell:
    """What is left of ``found`` when interreflection is taken out, if there is some."""
    again, direct, removed = unbounce(observation, method, bridged, first=found, least_gain=LEAST_GAIN)
    if removed is None or removed.misfit_before <= CLEARER * removed.misfit_after:
        return FirstShell(found, observation, method, found)
    return FirstShell(removed.noted(again), direct, method, found, removed)


def _sure(first: FirstShell, observation: Observation, share: float) -> bool:
    """Whether nothing speaks against it: half the object is on it to within noise, or is in direct light alone."""
    if first.removed is not None:
        left, before = _roughness(first.found, first.direct), _roughness(first.before, observation)
        return first.removed.misfit_before > SURELY * first.removed.misfit_after or left < min(CALM, CALMER * before)
    return first.found.status == "ok" and share >= MOST_LIT and settled(first.found, observation)


def _reason(first: FirstShell, core: Estimate, observation: Observation, share: float) -> str | None:
    """Why the shell ``core`` is taken for the ``first`` one; None if it is not."""
    found = first.before
    if not has_surface(found):
        return found.status
    calm = has_surface(core) and _calmer(core, first, observation)
    if found.status != "ok":
        return found.status if core.status == "ok" or calm else None
    if core.status == "ok" and share < MOST_LIT:
        return f"{share:.0%} of the object on the first shell"
    if calm and not bend(found, observation).clear:
        return "neighbours share what the first shell leaves over"
    return None


def _calmer(core: Estimate, first: FirstShell, observation: Observation) -> bool:
    """Whether neighbours share next to nothing on the ``core``, and far less than on the ``first`` shell.

    Where light between the parts explains that in part, small shells that are none hold hardly more than noise too.
    """
    shared = left_over(core, observation.rgb)[1]
    left, before = left_over(first.found, first.direct.rgb)[1], left_over(first.before, observation.rgb)[1]
    if first.removed is not None:
        some = core.valid.sum() > LEAST_GROWN * observation.mask.sum()
        return bool(some and shared < FAR_LESS * left)
    return settled(core, observation) or shared < FAR_LESS * before


def _doubt(first: FirstShell, observation: Observation) -> RecoveryFailure | None:
    """Where neither noise nor light between the parts nor wide lights explain what the first shell leaves over."""
    found = first.before
    if first.removed is not None or found.status != "ok" or bend(found, observation).clear:
        return None
    _, shared = left_over(found, observation.rgb)
    off = np.degrees(shared * np.sqrt(np.linalg.eigvalsh(found.diagnostics["C"])[2]))
    if off < MOST_OFF_DEG:
        return None
    return RecoveryFailure(
        "no-dominant-shell", f"neighbours share {off:.0f}° of misfit on the first shell, no other grew"
    )


def _roughness(estimate: Estimate, observation: Observation) -> float:
    """What neighbours share of the distance to the ellipsoid, over each pixel's own."""
    white, shared = left_over(estimate, observation.rgb)
    return shared / max(white, 1e-300)
