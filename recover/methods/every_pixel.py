"""Methods ``unbounce``, ``knit`` and ``joint``: `weak-integrability`, and then one stage more."""

from dataclasses import replace

import numpy as np

from huesphere.recover.every_pixel.completion import CompletionSteps, bridged, completed
from huesphere.recover.interreflection.removal import remove_interreflection
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.methods.weak import recover_weak_integrability, recover_weak_integrability_near
from huesphere.render.dataset import Observation


def recover_unbounced(observation: Observation) -> Estimate:
    """`weak-integrability` on the direct light alone: interreflection is removed from the picture first."""
    found, direct, removal = remove_interreflection(
        observation, recover_weak_integrability, bridged, restart=recover_weak_integrability_near
    )
    if removal is None:
        return found
    return replace(removal.noted(found), removed=observation.rgb.astype(np.float64) - direct.rgb)


def recover_knitted(observation: Observation) -> Estimate:
    """`weak-integrability`, then every pixel: lights from one picture, and each pixel by the lights that it sees."""
    found = recover_weak_integrability(observation)
    return completed(found, observation, CompletionSteps())[0] if found.status == "ok" else found


def recover_jointly(observation: Observation) -> Estimate:
    """`knit`, then depth and F fitted together to the picture, which is taken where the residual is like noise."""
    found = recover_weak_integrability(observation)
    return completed(found, observation, CompletionSteps(joint=True))[0] if found.status == "ok" else found
