"""Test whether the residual to an ellipsoid is a function of the normal: then another light model is needed.

Lights that are wide or many have no sharp terminators: pixels lose their light gradually, and an ellipsoid fitted to
all of them has a residual that depends on the normal alone. A right ellipsoid leaves noise alone. Interreflection
leaves a residual that depends on the place. So the distances are regressed on spherical harmonics of the normal. No
rotation is needed: rotating the normals, C^½ρ up to a rotation, mixes harmonics of one degree among themselves.
"""

from dataclasses import dataclass

import numpy as np

from huesphere.recover.ellipsoid.distance import residual_scales, signed_distance
from huesphere.recover.ellipsoid.parameters import ELLIPSOID
from huesphere.recover.geometry.harmonics import Harmonics
from huesphere.recover.geometry.root import symmetric_root

DEGREES = (0, 1, 2, 4)  # of the harmonics: those that matte shading has up to degree 4 (odd ones beyond 1 vanish)


@dataclass(frozen=True)
class LackOfFit:
    """What the normal explains of the distances to an ellipsoid."""

    share: float  # of their variance, without that of independent noise
    amount: float  # standard deviation of what the normal explains, over the brightest channel value
    noise: float  # standard deviation of the independent part, over the brightest channel value

    @property
    def significant(self) -> bool:
        """The residual is a function of the normal, beyond what noise and interreflection make of it."""
        least = max(ELLIPSOID.least_explained_amount, ELLIPSOID.explained_over_noise * self.noise)
        return self.share > ELLIPSOID.least_explained_share and self.amount > least


def lack_of_fit(rgb: np.ndarray, inlier: np.ndarray, C: np.ndarray) -> LackOfFit:
    """Of the pixels ``inlier`` (H, W) of a picture ``rgb`` (H, W, 3) to the ellipsoid C (3, 3), picture units."""
    rho = rgb[inlier].astype(np.float64)
    distance = signed_distance(rho, C)
    N = rho @ symmetric_root(C).T
    values, _ = Harmonics(DEGREES).at(N / np.linalg.norm(N, axis=1, keepdims=True))
    rest = distance - values @ np.linalg.lstsq(values, distance)[0]
    explained = max(float(distance.var() - rest.var() * (1 + values.shape[1] / len(rho))), 0.0)
    independent, _ = residual_scales(distance, inlier)
    beyond_noise = max(float(distance.var()) - independent**2, explained, 1e-300)
    bright = float(rho.max())
    return LackOfFit(explained / beyond_noise, float(np.sqrt(explained)) / bright, independent / bright)
