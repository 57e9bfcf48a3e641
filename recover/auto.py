"""One method for whoever names none: it takes the steps that the picture deserves, and says which and why.

The shell is that of ``weak-integrability`` where half the object sees every light, else that of ``robust``.
Interreflection is taken out where the recovered surface explains what colours stray by. Then every pixel gets its
normal, and of a noisy picture depth and F are fitted together.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from recover.complete import bridged, completed
from recover.estimate import Estimate
from recover.unbounce import CLEARER, has_surface, unbounce
from render.dataset import Observation

MOST_LIT = 0.45  # share of the object on the first shell, below which half of it may be something else
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
    direct = observation
    clean, picture, reflected = unbounce(observation, method, bridged, first=found, least_gain=LEAST_GAIN)
    if reflected is not None and reflected.misfit_before > CLEARER * reflected.misfit_after:
        found, direct = clean, picture
        found = replace(found, diagnostics=found.diagnostics | {"interreflection": reflected.told()})
        gain = reflected.misfit_before / reflected.misfit_after
        steps.append(f"interreflection: {reflected.share:.1%} of the light taken out (misfit {gain:.1f} times less)")
    else:
        steps.append("interreflection: none taken out (the surface's own does not explain the misfit)")
    if found.status != "ok":
        return replace(found, method="auto", diagnostics=found.diagnostics | {"auto": steps})

    whole = completed(found, direct, observation.rgb.astype(np.float64) - direct.rgb, joint=True)
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
