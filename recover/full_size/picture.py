"""A large picture reduced to means over square blocks of pixels.

Colour is linear in the normal and the mean is linear, so a block has the colour of its mean normal, which is shorter
than 1 by the square of the angle over which the surface turns within it: 1e-5 for a ball of 300 blocks across.
"""

import numpy as np

from huesphere.recover.geometry.reduction import Reduction
from huesphere.render.dataset import KnownLights, Observation

MOST_PIXELS = 90_000  # most object pixels of the picture that an estimate is made on: 300 × 300


def reduced(observation: Observation, by: Reduction) -> Observation:
    """The ``observation``, in linear light, with means over blocks of pixels in the place of pixels.

    A block is on the object where at least half of its pixels are, and has the mean of those that are finite; it counts
    as clipped where one of them is. Noise becomes less, lengths in pixels shorter.
    """
    camera, mask = observation.camera, observation.mask
    finite = mask & np.isfinite(observation.rgb).all(axis=-1)
    used, on_object = by.blockwise(finite), by.on_object(mask)
    light = by.blockwise(np.where(finite[..., None], observation.rgb, 0))
    with np.errstate(invalid="ignore", divide="ignore"):
        rgb = light / used[..., None]  # NaN where no pixel of the block is finite
    if camera.saturation is not None:
        clipped = by.blockwise(finite & (observation.rgb >= camera.saturation).any(axis=-1)) > 0
        rgb[clipped] = np.maximum(rgb[clipped], camera.saturation)
    rgb = np.where(on_object[..., None], rgb, 0.0)
    lights = observation.lights and KnownLights(observation.lights.positions / by.factor, observation.lights.directions)
    return Observation(rgb.astype(np.float32), on_object, camera.of_means(by.factor), lights)
