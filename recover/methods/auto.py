"""Method ``auto``, the default: it takes the steps that the picture calls for, and says which and why.

The ellipsoid is that of `weak-integrability` where half the object sees every light, else that of `robust`.
Interreflection is removed where the recovered surface predicts it (``recover.methods.initial``). Then every pixel gets
its normal, by the lights that are found or by a smooth map from normals to colours, and of a noisy picture depth and F
are fitted together (``recover.every_pixel.completion``). Where an ellipsoid turns out to be bent, as under lights that
are wide or many, only its core is kept, and the rest follows from the map alone. Where the header gives the positions
of near lights, ``recover.methods.near_lights`` takes over.
"""

from dataclasses import replace

import numpy as np

from huesphere.recover.cues.linear_integrability import off_axis_deg
from huesphere.recover.ellipsoid.lack_of_fit import LackOfFit
from huesphere.recover.every_pixel.completion import Completion, CompletionSteps, completed
from huesphere.recover.interreflection.removal import remove_once_more
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.lights.model import Lights
from huesphere.recover.methods.initial import Initial, Restartable, bend, initial_estimate, residual_is_white
from huesphere.recover.methods.near_lights import has_known_near_lights, recover_near
from huesphere.recover.methods.parameters import METHOD
from huesphere.recover.methods.robust import recover_robust, recover_robust_near
from huesphere.recover.methods.weak import recover_weak_integrability, recover_weak_integrability_near
from huesphere.recover.stages import Stage, at_work_on
from huesphere.recover.status import RecoveryFailure
from huesphere.render.dataset import Observation

# The methods of the initial estimate: where half of the object sees every light, and where less of it does.
DOMINANT = Restartable(recover_weak_integrability, recover_weak_integrability_near)
FEW_LIT = Restartable(recover_robust, recover_robust_near)


def recover_automatically(observation: Observation) -> Estimate:
    """The steps that the picture calls for; ``Estimate.steps`` says which, each with its reason in a few words.

    Where equations of a later step have no solution, the estimate is that of `weak-integrability`.
    """
    try:
        return _by_steps(observation)
    except (np.linalg.LinAlgError, RecoveryFailure) as error:
        simple = recover_weak_integrability(observation)
        return replace(simple, steps=(f"given up: {error}; the estimate is that of weak-integrability",))


def _by_steps(observation: Observation) -> Estimate:
    """The estimate by all steps. Raises LinAlgError, RecoveryFailure."""
    if has_known_near_lights(observation):
        return _with_near_lights(observation)
    first = initial_estimate(observation, DOMINANT, FEW_LIT)
    if first.found.status != "ok":
        return replace(first.found, steps=first.steps)
    first, bent = _without_mistaken_removal(first, observation)
    if bent.significant:
        core = recover_robust(observation) if first.from_patches is None else first.from_patches
        return _under_wide_lights(first, observation, core, bent)
    whole = _every_pixel(first, observation)
    if first.doubt is not None:
        whole = replace(whole, status=first.doubt.status, message=first.doubt.message)
    return whole


def _without_mistaken_removal(first: Initial, observation: Observation) -> tuple[Initial, LackOfFit]:
    """The initial estimate and how bent its ellipsoid is; the ones before the removal if much of the bend remained.

    The deviation from an ellipsoid that wide lights cause can be mistaken for the interreflection of a hollow; the
    removal would then turn hills into hollows.
    """
    bent = bend(first.found, first.direct)
    if first.removal is None or first.before.status != "ok":
        return first, bent
    before = bend(first.before, observation)
    if before.significant and bent.amount > METHOD.least_straightened * before.amount:
        steps = (
            *first.steps[:-1],
            "interreflection: not removed (what the surface predicts leaves the ellipsoid bent)",
        )
        return replace(first, found=first.before, direct=observation, removal=None, steps=steps), before
    return first, bent


def _every_pixel(first: Initial, observation: Observation) -> Estimate:
    """The estimate with a normal of every pixel, by the lights that the pixel sees.

    Where indirect light was removed, it is removed once more if the surface of all pixels predicts it better than the
    surface of the pixels that see every light does; the lights of the first completion are tried first by the second.
    """

    def complete(
        found: Estimate, direct: Observation, steps: CompletionSteps, lights: Lights | None = None
    ) -> tuple[Estimate, Completion | None]:
        at_work_on(Stage.LIGHTS)
        removed = observation.rgb.astype(np.float64) - direct.rgb
        return completed(found, direct, steps, removed, lights)

    steps, every_step = list(first.steps), CompletionSteps(joint=True, smooth=True, lights_jointly=True)
    whole, completion = complete(first.found, first.direct, every_step)
    if first.removal is not None and completion is not None:
        surfaces = [whole]
        if completion.smoothed is not None:
            surfaces.append(replace(whole, normals=completion.smoothed.astype(np.float32)))
        better = remove_once_more(observation, first.method.restart, first.found, surfaces, first.removal)
        if better is not None and better.removal is not None:
            gain = first.removal.misfit_after / better.removal.misfit_after
            steps.append(f"interreflection: once more, from the completed surface (misfit {gain:.2f} times less again)")
            # Lights are estimated jointly here only if they were in the first completion. The picture differs little
            # from the first one and has no more noise; and where single lights were found before, a joint estimate
            # would discard them.
            again = replace(every_step, lights_jointly=completion.lights_estimated_jointly)
            found = better.removal.noted(better.estimate)
            whole, completion = complete(found, better.observation, again, completion.lights)
    if completion is not None:
        steps += _told(completion)
    return replace(whole, steps=tuple(steps))


def _told(completion: Completion) -> list[str]:
    """What the completion did, in words."""
    lights, shares, joint = completion.lights.found, completion.shares, completion.joint
    steps = []
    steps.append(
        f"every pixel: {shares['all_lit']:.0%} see all lights, {shares['missing_lights']:.0%} miss some of "
        f"{len(lights)} found, {shares['mapped']:.0%} by a smooth map, {shares['between']:.0%} interpolated"
    )
    if joint is None:
        steps.append("depth and F fitted together: not tried (no noise to speak of)")
    else:
        taken = "taken" if joint.used else "not taken"
        steps.append(f"depth and F fitted together: {taken} (the residual is {joint.misfit:.2f} times the noise)")
    return steps


def _with_near_lights(observation: Observation) -> Estimate:
    """The estimate under near lights of known position; a failure is returned: no other method allows for them."""
    steps = ["lights: near, at the positions that the header gives"]
    found, outcome = recover_near(observation)
    if outcome is not None:
        steps.append(
            f"every pixel: depth and the lights' colours fitted together (explains {outcome.explained:.0%}; the "
            f"surface turned inside out leaves {outcome.other_ratio:.2g} times the residual)"
        )
    return replace(found, steps=tuple(steps))


def _under_wide_lights(first: Initial, observation: Observation, core: Estimate, by: LackOfFit) -> Estimate:
    """The estimate from the ``core`` of a bent ellipsoid and jointly estimated lights or a map from normals to colours.

    Without such a core, or where neither explains enough of the object, the status is that of ``_unexplained``. ``by``:
    how bent the ellipsoid of the ``first`` estimate is.
    """
    steps = [
        *first.steps,
        f"lights: wide or many (the normal explains {by.share:.0%} of the first ellipsoid's residual)",
    ]
    share = float(core.valid.sum() / observation.mask.sum())
    if core.status != "ok" or share < METHOD.least_core_share:
        why = core.status if core.status != "ok" else f"{share:.0%} of the object"
        return _unexplained(first.found, f"no core sees all the light whole ({why})", steps)
    off_axis = off_axis_deg(core.normals[core.valid][:, 2], fewest=1)
    if off_axis > METHOD.most_core_off_axis_deg + core.rotation_stderr_deg:
        why = f"its normal nearest to the camera is {off_axis:.0f}° off axis"
        return _unexplained(first.found, f"no core sees all the light whole ({why})", steps)
    straight = bend(core, observation).amount * METHOD.straighter <= by.amount
    if not straight and not residual_is_white(core, observation):
        return _unexplained(first.found, "the ellipsoid's core is bent too", steps)
    steps.append(f"ellipsoid: its core alone, grown from patches ({share:.0%} of the object)")
    found, completion = completed(core, observation, CompletionSteps(search=False, smooth=True, lights_jointly=True))
    if completion is None:
        return _unexplained(found, "its core has no solution", steps)
    if completion.lights_estimated_jointly:
        explained, count = 1 - completion.shares["between"], len(completion.lights.found)
        steps.append(f"every pixel: {count} lights estimated jointly explain {explained:.0%}")
        if explained < METHOD.least_explained:
            return _unexplained(found, f"{count} lights explain {explained:.0%} of the object", steps)
        return replace(found, steps=tuple(steps))
    if completion.map_explains is None:
        return _unexplained(found, "no smooth map of the normal could be made", steps)
    irradiance = completion.notes["irradiance"] | {"core": share, "bend": {"share": by.share, "amount": by.amount}}
    found = replace(found, diagnostics=found.diagnostics | {"irradiance": irradiance})
    steps.append(f"every pixel: a smooth map of the normal explains {completion.map_explains:.0%}")
    if completion.map_explains < METHOD.least_explained:
        why = f"a smooth map of the normal explains {completion.map_explains:.0%} of the object"
        return _unexplained(found, why, steps)
    return replace(found, steps=tuple(steps))


def _unexplained(estimate: Estimate, lacking: str, steps: list[str]) -> Estimate:
    """The estimate, its status extended-lights: no core is found, or neither lights nor a smooth map explain enough.

    ``lacking``: what was missing, in words. With the remedy of that status it is the message; by itself it is the last
    of the ``steps``.
    """
    failure = RecoveryFailure("extended-lights", lacking)
    return replace(estimate, status=failure.status, message=failure.message, steps=(*steps, f"given up: {lacking}"))
