"""One method for whoever names none: it takes the steps that the picture deserves, and says which and why.

The shell is that of ``weak-integrability`` where half the object sees every light, else that of ``robust``.
Interreflection is taken out where the recovered surface explains what colours stray by. Then every pixel gets its
normal, and of a noisy picture depth and F are fitted together. Where a shell turns out to be bent, as under lights that
are wide or many, only its core is kept, and the rest follows from a smooth map of normals to colours.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from recover.bent import Bend, bend_of
from recover.complete import BETWEEN_DEG, bridged, completed
from recover.estimate import Estimate
from recover.facing import aside_deg
from recover.irradiance import fit_irradiance
from recover.rays import rays
from recover.status import RecoveryFailure
from recover.unbounce import CLEARER, has_surface, once_more, unbounce
from render.dataset import Observation

MOST_LIT = 0.45  # share of the object on the first shell, below which half of it may be something else
LEAST_CORE, STRAIGHTER = 0.08, 10.0  # share of the object that a core must have, and times less bent it must be
CORE_ASIDE_DEG = 5.0  # of facing the camera, its nearest normal, beyond its standard error: domes 0.9, a half sky's 10
LEAST_STRAIGHTENED = 0.2  # share of a bend that light between the parts may leave: bowl .09, discs of light .26, .45
LEAVES = 3.0  # times what the map may leave out: a pixel is explained
LEAST_EXPLAINED = 0.75  # share of the object
MAP_DEG = 3.0  # what normals are off in the mean where the map explains the colour: 1.4 to 2.5 on convex shapes
LEAST_GAIN = 1.05  # times less misfit with the first surface, from which interreflection is looked into


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
    method = dominant
    found = dominant(observation)
    share = found.valid.sum() / max(1, observation.mask.sum())
    if found.status != "ok" or share < MOST_LIT:
        other = hidden(observation)
        if other.status == "ok" or not has_surface(found):
            reason = found.status if found.status != "ok" else f"{share:.0%} of the object on the first shell"
            steps.append(f"shell: grown from patches ({reason})")
            found, method = other, hidden
    if method is dominant:
        steps.append(f"shell: least median of squares, polished ({share:.0%} of the object)")
    first, direct = found, observation
    removed = None
    clean, picture, reflected = unbounce(observation, method, bridged, first=first, least_gain=LEAST_GAIN)
    if reflected is not None and reflected.misfit_before > CLEARER * reflected.misfit_after:
        found, direct, removed = clean, picture, reflected
        found = replace(found, diagnostics=found.diagnostics | {"interreflection": reflected.told()})
        gain = reflected.misfit_before / reflected.misfit_after
        steps.append(f"interreflection: {reflected.share:.1%} of the light taken out (misfit {gain:.1f} times less)")
    else:
        steps.append("interreflection: none taken out (the surface's own does not explain the misfit)")
    if found.status != "ok":
        return replace(found, method="auto", diagnostics=found.diagnostics | {"auto": steps})

    bend = _bend(found, direct)
    if found is not first and first.status == "ok":
        before = _bend(first, observation)
        if before.clear and bend.amount > LEAST_STRAIGHTENED * before.amount:
            # Taken for light of a hollow, what wide lights lack of an ellipsoid turns hills inside out.
            steps[-1] = "interreflection: none taken out (the surface's own leaves the shell bent)"
            found, bend = first, before
    if bend.clear:
        whole = _under_wide_lights(found, observation, hidden(observation), bend, steps)
        return replace(whole, method="auto", diagnostics=whole.diagnostics | {"auto": steps})
    whole = _every_pixel(found, observation, direct)
    if removed is not None and (better := once_more(observation, method, found, whole, removed)) is not None:
        found, direct, reflected = better
        found = replace(found, diagnostics=found.diagnostics | {"interreflection": reflected.told()})
        gain = removed.misfit_after / reflected.misfit_after
        steps.append(f"interreflection: once more, from the finished surface (misfit {gain:.2f} times less again)")
        whole = _every_pixel(found, observation, direct)
    lights, shares = whole.diagnostics["lights"], whole.diagnostics["knit"]
    steps.append(
        f"every pixel: {shares['all_lit']:.0%} see all lights, {shares['missing_lights']:.0%} miss some of "
        f"{len(lights['found'])} found, {shares['between']:.0%} bridged"
    )
    if "joint" in whole.diagnostics:
        fit = whole.diagnostics["joint"]
        found_so = f"it leaves {fit['misfit']:.2f} of the noise over"
        steps.append(f"depth and F fitted together: {'taken' if fit['used'] else 'not taken'} ({found_so})")
    else:
        steps.append("depth and F fitted together: not tried (no noise to speak of)")
    return replace(whole, method="auto", diagnostics=whole.diagnostics | {"auto": steps})


def _every_pixel(found: Estimate, observation: Observation, direct: Observation) -> Estimate:
    return completed(found, direct, observation.rgb.astype(np.float64) - direct.rgb, joint=True)


def _bend(estimate: Estimate, observation: Observation) -> Bend:
    return bend_of(observation.rgb, estimate.inlier, np.asarray(estimate.diagnostics["C"]))


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
    return replace(found, method="auto", diagnostics=found.diagnostics | {"auto": steps})


def _under_wide_lights(
    bent: Estimate, observation: Observation, core: Estimate, bend: Bend, steps: list[str]
) -> Estimate:
    """The estimate from the ``core`` of a ``bent`` shell and a map of normals to colours; a failure, if there is none.

    ``steps`` is told more.
    """
    steps.append(f"lights: wide or many (the normal explains {bend.share:.0%} of what colours are off the first shell)")
    share = float(core.valid.sum() / observation.mask.sum())
    if core.status != "ok" or share < LEAST_CORE:
        why = core.status if core.status != "ok" else f"{share:.0%} of the object"
        return _unexplained(bent, f"no core sees all the light whole ({why})", steps)
    aside = aside_deg(core.normals[core.valid][:, 2], fewest=1)
    if aside > CORE_ASIDE_DEG + core.diagnostics["rotation_stderr_deg"]:
        return _unexplained(bent, f"no core sees all the light whole (its nearest normal is {aside:.0f}° aside)", steps)
    if _bend(core, observation).amount * STRAIGHTER > bend.amount:
        return _unexplained(bent, "the shell's core is bent too", steps)
    steps.append(f"shell: its core alone, grown from patches ({share:.0%} of the object)")
    whole = bridged(core, observation, np.zeros(observation.rgb.shape))
    noise = float(core.diagnostics["noise"]["sigma"])
    try:
        start, ray = whole.normals.astype(np.float64), rays(observation.camera, observation.mask.shape)
        fit = fit_irradiance(observation.rgb, observation.mask, start, core.inlier, noise, ray)
    except np.linalg.LinAlgError:
        return _unexplained(bent, "the map's equations have no one solution", steps)
    explained = observation.mask & (fit.misfit < LEAVES * fit.left_out)
    told = {
        "core": share,
        "explained": float(explained.sum() / observation.mask.sum()),
        "misfit": float(np.median(fit.misfit[observation.mask])),
        "bend": {"share": bend.share, "amount": bend.amount},
        "coefficients": fit.coefficients.tolist(),
        "steps": fit.steps,
    }
    steps.append(f"every pixel: a smooth map of the normal explains {told['explained']:.0%}")
    doubt = np.where(explained, np.fmax(MAP_DEG, core.diagnostics["rotation_stderr_deg"]), BETWEEN_DEG)
    normals = np.where(core.valid[..., None], core.normals, fit.normals)
    found = replace(
        whole,
        normals=np.where(whole.valid[..., None], normals, np.nan).astype(np.float32),
        uncertainty_deg=np.where(core.valid, core.uncertainty_deg, np.where(whole.valid, doubt, np.nan)).astype(
            np.float32
        ),
        diagnostics=whole.diagnostics | {"irradiance": told},
    )
    if told["explained"] < LEAST_EXPLAINED:
        return _unexplained(found, f"a smooth map of the normal explains {told['explained']:.0%} of the object", steps)
    return found


def _unexplained(estimate: Estimate, found: str, steps: list[str]) -> Estimate:
    """The estimate, marked: its normals are of lights that the picture does not bear out."""
    failure = RecoveryFailure("extended-lights", found)
    steps.append(f"given up: {found}")
    return replace(estimate, status=failure.status, message=failure.message)
