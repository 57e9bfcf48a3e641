"""One method for whoever names none: it takes the steps that the picture deserves, and says which and why.

The shell is that of ``weak-integrability`` where half the object sees every light, else that of ``robust``.
Interreflection is taken out where the recovered surface explains what colours stray by (``recover.methods.initial``).
Then every pixel gets its normal, by the lights that are found or a smooth map of normals to colours, and of a noisy
picture depth and F are fitted together. Where a shell turns out to be bent, as under lights that are wide or many, only
its core is kept, and the rest follows from the map alone.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from huesphere.recover.cues.linear_integrability import aside_deg
from huesphere.recover.ellipsoid.lack_of_fit import Bend
from huesphere.recover.every_pixel.completion import completed
from huesphere.recover.interreflection.removal import once_more
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.methods.initial import FirstShell, bend, first_shell, settled
from huesphere.recover.status import RecoveryFailure
from huesphere.render.dataset import Observation

LEAST_CORE, STRAIGHTER = 0.08, 10.0  # share of the object that a core must have, and times less bent it must be
CORE_ASIDE_DEG = 5.0  # of facing the camera, its nearest normal, beyond its standard error: domes 0.9, a half sky's 10
LEAST_STRAIGHTENED = 0.2  # share of a bend that light between the parts may leave: bowl .09, discs of light .26, .45
LEAST_EXPLAINED = 0.75  # share of the object


def choose_steps(
    observation: Observation,
    dominant: Callable[[Observation], Estimate],
    hidden: Callable[[Observation], Estimate],
) -> Estimate:
    """The estimate of method ``auto``.

    ``dominant`` is a method for pictures of which half sees every light, ``hidden`` one for fewer. The diagnostics'
    ``auto`` tells the steps, each with its reason in a few words.
    """
    steps: list[str] = []
    first = first_shell(observation, dominant, hidden, steps)
    if first.found.status != "ok":
        return _finished(first.found, steps)
    bent = bend(first.found, first.direct)
    if first.removed is not None and first.before.status == "ok":
        before = bend(first.before, observation)
        if before.clear and bent.amount > LEAST_STRAIGHTENED * before.amount:
            # Taken for light of a hollow, what wide lights lack of an ellipsoid turns hills inside out.
            steps[-1] = "interreflection: none taken out (the surface's own leaves the shell bent)"
            first, bent = replace(first, found=first.before, direct=observation, removed=None), before
    if bent.clear:
        core = hidden(observation) if first.grown is None else first.grown
        return _finished(_under_wide_lights(first.found, observation, core, bent, steps), steps)
    whole = _every_pixel(first, observation, steps)
    if first.doubt is not None:
        whole = replace(whole, status=first.doubt.status, message=first.doubt.message)
    return _finished(whole, steps)


def _every_pixel(first: FirstShell, observation: Observation, steps: list[str]) -> Estimate:
    """Every pixel by the lights that it sees, from those that see all. ``steps`` is told more."""

    def whole_of(found: Estimate, direct: Observation) -> Estimate:
        return completed(found, direct, observation.rgb.astype(np.float64) - direct.rgb, joint=True, smooth=True)

    whole, removed = whole_of(first.found, first.direct), first.removed
    if removed is not None:
        better = once_more(observation, first.method, first.found, whole, removed)
        if better is not None:
            found, direct, reflected = better
            gain = removed.misfit_after / reflected.misfit_after
            steps.append(f"interreflection: once more, from the finished surface (misfit {gain:.2f} times less again)")
            whole = whole_of(reflected.noted(found), direct)
    lights, shares = whole.diagnostics["lights"], whole.diagnostics["knit"]
    steps.append(
        f"every pixel: {shares['all_lit']:.0%} see all lights, {shares['missing_lights']:.0%} miss some of "
        f"{len(lights['found'])} found, {shares['mapped']:.0%} by a smooth map, {shares['between']:.0%} bridged"
    )
    if "joint" in whole.diagnostics:
        fit = whole.diagnostics["joint"]
        found_so = f"it leaves {fit['misfit']:.2f} of the noise over"
        steps.append(f"depth and F fitted together: {'taken' if fit['used'] else 'not taken'} ({found_so})")
    else:
        steps.append("depth and F fitted together: not tried (no noise to speak of)")
    return whole


def _finished(estimate: Estimate, steps: list[str]) -> Estimate:
    return replace(estimate, method="auto", diagnostics=estimate.diagnostics | {"auto": steps})


def with_near_lights(found: Estimate) -> Estimate:
    """The estimate of ``auto`` where the header tells of near lights; a failure stays one, for no other method
    allows for light that changes from place to place."""
    steps = ["lights: near, the header tells where"]
    if "near" in found.diagnostics:
        told = found.diagnostics["near"]
        steps.append(
            f"every pixel: depth and the lights' colours fitted together (explains {told['explained']:.0%}; the "
            f"surface turned inside out leaves {told['left_other_way']:.2g} times as much)"
        )
    return _finished(found, steps)


def _under_wide_lights(
    bent: Estimate, observation: Observation, core: Estimate, by: Bend, steps: list[str]
) -> Estimate:
    """The estimate from the ``core`` of a ``bent`` shell and a map of normals to colours; a failure, if there is none.

    ``steps`` is told more.
    """
    steps.append(f"lights: wide or many (the normal explains {by.share:.0%} of what colours are off the first shell)")
    share = float(core.valid.sum() / observation.mask.sum())
    if core.status != "ok" or share < LEAST_CORE:
        why = core.status if core.status != "ok" else f"{share:.0%} of the object"
        return _unexplained(bent, f"no core sees all the light whole ({why})", steps)
    aside = aside_deg(core.normals[core.valid][:, 2], fewest=1)
    if aside > CORE_ASIDE_DEG + core.diagnostics["rotation_stderr_deg"]:
        return _unexplained(bent, f"no core sees all the light whole (its nearest normal is {aside:.0f}° aside)", steps)
    if bend(core, observation).amount * STRAIGHTER > by.amount and not settled(core, observation):
        return _unexplained(bent, "the shell's core is bent too", steps)
    steps.append(f"shell: its core alone, grown from patches ({share:.0%} of the object)")
    found = completed(core, observation, search=False, smooth=True)
    if found.diagnostics.get("whole_picture", {}).get("used"):
        shares, lights = found.diagnostics["knit"], found.diagnostics["lights"]["found"]
        steps.append(f"every pixel: {len(lights)} lights found together explain {1 - shares['between']:.0%}")
        if 1 - shares["between"] < LEAST_EXPLAINED:
            return _unexplained(found, f"{len(lights)} lights explain {1 - shares['between']:.0%} of the object", steps)
        return found
    if "irradiance" not in found.diagnostics:
        return _unexplained(found, "no smooth map of the normal could be made", steps)
    told = found.diagnostics["irradiance"] | {"core": share, "bend": {"share": by.share, "amount": by.amount}}
    found = replace(found, diagnostics=found.diagnostics | {"irradiance": told})
    steps.append(f"every pixel: a smooth map of the normal explains {told['explained']:.0%}")
    if told["explained"] < LEAST_EXPLAINED:
        return _unexplained(found, f"a smooth map of the normal explains {told['explained']:.0%} of the object", steps)
    return found


def _unexplained(estimate: Estimate, found: str, steps: list[str]) -> Estimate:
    """The estimate, marked: its normals are of lights that the picture does not bear out."""
    failure = RecoveryFailure("extended-lights", found)
    steps.append(f"given up: {found}")
    return replace(estimate, status=failure.status, message=failure.message)
