"""Whether a shell is bent: how far its colours stray from the ellipsoid as a smooth function of the normal.

Lights that are wide or many have no sharp terminators: pixels lose them little by little, and an ellipsoid laid
through all of them is off by what depends on the normal alone. Of one that is right only noise is left over; of light
between parts of the surface what depends on the place. No rotation is needed: harmonics of C^½ρ turn among themselves.
"""

from dataclasses import dataclass

import numpy as np

from huesphere.recover.ellipsoid.distance import residual_scales, signed_distance
from huesphere.recover.geometry.harmonics import Harmonics
from huesphere.recover.geometry.root import symmetric_root

DEGREES = (0, 1, 2, 4)
OVER_NOISE = 0.5  # of a pixel's own, and more: which pixels were accepted, and the noise's bias, are 0.2 to 0.45
LEAST_SHARE, LEAST_AMOUNT = 0.55, 5e-4  # of shells under wide lights 0.6 to 0.9, 1e-3 up; between parts 0.2


@dataclass(frozen=True)
class Bend:
    """What the normal explains of the distances to an ellipsoid."""

    share: float  # of their variance, noise left out
    amount: float  # standard deviation of that, over the brightest colour
    noise: float  # of a pixel's distance, each pixel's own, over the brightest colour

    @property
    def clear(self) -> bool:
        return self.share > LEAST_SHARE and self.amount > max(LEAST_AMOUNT, OVER_NOISE * self.noise)


def bend_of(rgb: np.ndarray, shell: np.ndarray, C: np.ndarray) -> Bend:
    """Of the pixels ``shell`` (H, W) of a picture (H, W, 3) and the ellipsoid ρᵀCρ = 1."""
    rho = rgb[shell].astype(np.float64)
    distance = signed_distance(rho, C)
    N = rho @ symmetric_root(C).T
    values, _ = Harmonics(DEGREES).at(N / np.linalg.norm(N, axis=1, keepdims=True))
    rest = distance - values @ np.linalg.lstsq(values, distance)[0]
    explained = max(float(distance.var() - rest.var() * (1 + values.shape[1] / len(rho))), 0.0)
    white, _ = residual_scales(distance, shell)
    beyond_noise = max(float(distance.var()) - white**2, explained, 1e-300)
    bright = float(rho.max())
    return Bend(explained / beyond_noise, float(np.sqrt(explained)) / bright, white / bright)
