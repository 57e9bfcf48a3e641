"""What a light is: its direction and colour, and which matrix the pixels have that miss some lights.

A pixel that sees every light has the colour ρ = F n with F = Σ b aᵀ (report Eq. 6), where b is a light's colour and a
the unit vector toward it. A pixel that misses the lights of a set S has F_S = F − Σ_S b aᵀ in place of F.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from huesphere.recover.lights.parameters import LIGHTS

LEAST_SUPPORT_SHARE = 0.002  # of the pixels: what explains a smaller share is not worth looking at
ROUNDING = 5e-5  # of the brightest colour: residuals of rounding and of rendering, which pictures without noise have


@dataclass(frozen=True)
class Light:
    """One distant light: where a pixel of unit normal n sees it, the pixel's colour gains b max(0, a·n)."""

    direction: np.ndarray  # (3,) a, unit, camera frame, toward the light
    colour: np.ndarray  # (3,) b, picture units
    support: int  # how many pixels show the light by missing it
    curl: float  # relative curl of the slopes of these pixels (``evidence.relative_curl``): small on a surface
    attached: float  # share of these pixels that are turned away from the light: attached, not cast shadow


@dataclass(frozen=True)
class Lights:
    """The lights that were found in a picture, in the order in which they were found."""

    found: tuple[Light, ...]
    missing: float  # |F − Σ b aᵀ| / |F| over the lights found, Frobenius norms: 0 where they are all the light

    def record(self) -> dict[str, Any]:
        """As JSON: direction, colour, and what supports each light; how much light is missing beside them."""
        found = [
            {
                "direction": light.direction.tolist(),
                "colour": light.colour.tolist(),
                "pixels": light.support,
                "curl": light.curl,
                "attached_share": light.attached,
            }
            for light in self.found
        ]
        return {"found": found, "missing": self.missing, "complete": self.complete}

    @property
    def complete(self) -> bool:
        """Whether the lights found add up to F: no light is missing."""
        return self.missing < LIGHTS.relative_light_error


def without(F: np.ndarray, lights: tuple[Light, ...], missed: tuple[int, ...]) -> np.ndarray:
    """F_S (3, 3), the matrix of pixels that miss the lights whose numbers are in ``missed``."""
    return F - sum((np.outer(lights[j].colour, lights[j].direction) for j in missed), np.zeros((3, 3)))


def numbered(missed: int) -> tuple[int, ...]:
    """The numbers of the lights whose bits are set in ``missed``."""
    return tuple(j for j in range(missed.bit_length()) if missed >> j & 1)


def tolerance(brightest: float, noise: float) -> float:
    """The residual, picture units, up to which a colour counts as explained.

    ``brightest``: the largest channel of the picture. ``noise``: standard deviation of a channel, picture units.
    """
    return max(LIGHTS.outlier_deviations * noise, ROUNDING * brightest)
