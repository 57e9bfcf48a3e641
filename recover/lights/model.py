"""What is known of the lights: of each its direction and colour, and which matrix the pixels that miss some have.

A pixel that sees every light has the colour ρ = F n with F = Σ b aᵀ; one that misses the lights S has F − Σ_S b aᵀ.
"""

from dataclasses import dataclass

import numpy as np

LEAST_RELATIVE = 5e-5  # of the brightest colour: residuals below it count as none, noise or not


WITHIN = 3.0  # standard deviations of noise


COMPLETE = 0.03  # |F − Σ b aᵀ| / |F|


@dataclass(frozen=True)
class Light:
    """One light found: at a pixel that sees it the colour gains b (a·n)."""

    direction: np.ndarray  # (3,) a, unit, camera frame, toward the light
    colour: np.ndarray  # (3,) b, picture units
    support: int  # pixels that show its absence
    curl: float  # relative curl of those pixels' slopes: 0 for a surface
    attached: float  # share of them that are turned away from it


@dataclass(frozen=True)
class Lights:
    """The lights that cast or carry a shadow in the picture, in the order in which they were found."""

    found: tuple[Light, ...]
    missing: float  # |F − Σ b aᵀ| / |F|, 0 where every light is found

    @property
    def complete(self) -> bool:
        return self.missing < COMPLETE


def without(F: np.ndarray, lights: tuple[Light, ...], off: tuple[int, ...]) -> np.ndarray:
    """The matrix (3, 3) of pixels that miss the lights numbered ``off``."""
    return F - sum((np.outer(lights[j].colour, lights[j].direction) for j in off), np.zeros((3, 3)))


def numbered(off: int) -> tuple[int, ...]:
    """The numbers of the lights whose bits are set in ``off``."""
    return tuple(j for j in range(off.bit_length()) if off >> j & 1)


def tolerance(brightest: float, noise: float) -> float:
    """Residual, picture units, up to which a colour is explained."""
    return max(WITHIN * noise, LEAST_RELATIVE * brightest)
