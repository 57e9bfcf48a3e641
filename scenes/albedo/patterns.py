"""Patterns in space, functions of the position alone: noise, stripes, cracks, dirt; values from 0 to 1.

Each has a method ``value``, which runs inside a kernel: ``mi`` and ``dr`` are Mitsuba and Dr.Jit, which `scenes` never
imports, and ``position`` is a point for each lane, in the pattern's unit. So both engines evaluate the same function.
"""

from dataclasses import dataclass
from statistics import NormalDist
from types import ModuleType
from typing import Any

import numpy as np

from huesphere.configs import textures as configs

WAVES = 12  # plane waves of one octave of noise
GAIN = 0.6  # amplitude of an octave over that of the octave before
LOGISTIC = 1.702  # the logistic function of 1.702 g is the normal distribution's Φ(g) within 0.01
NEIGHBOURS = [(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)]
MASK = 0xFFFFFFFF  # a no-op on 32-bit integers; in the scalar variant integers are Python's


@dataclass(frozen=True)
class Waves:
    """A Gaussian random field of variance 1 as a sum of plane waves of random directions and phases.

    The spectral representation of M. Shinozuka & G. Deodatis (1991), with K waves.
    """

    vectors: np.ndarray  # (K, 3) radians per unit of length
    phases: np.ndarray  # (K,) radians
    amplitudes: np.ndarray  # (K,)

    def value(self, mi: ModuleType, dr: ModuleType, position: Any) -> Any:
        total: Any = mi.Float(0.0)
        for (x, y, z), phase, amplitude in zip(
            self.vectors.tolist(), self.phases.tolist(), self.amplitudes.tolist(), strict=True
        ):
            total = total + amplitude * dr.cos(x * position.x + y * position.y + z * position.z + phase)
        return total


def waves(size: float, octaves: int, seed: int) -> Waves:
    """Waves whose half lengths are about ``size``, ``size`` / 2 …, one for each of the ``octaves``."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(octaves, WAVES, 3))
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    number = np.pi / size * 2.0 ** np.arange(octaves)[:, None] * rng.uniform(0.7, 1.3, (octaves, WAVES))
    amplitude = np.repeat(GAIN ** np.arange(octaves), WAVES)
    amplitude *= np.sqrt(2 / np.sum(amplitude**2))
    phase = rng.uniform(0, 2 * np.pi, octaves * WAVES)
    return Waves((direction * number[..., None]).reshape(-1, 3), phase, amplitude)


@dataclass(frozen=True)
class Noise:
    """Φ(contrast · g) of a Gaussian random field g: with contrast 1 all values from 0 to 1 are equally frequent."""

    field: Waves
    contrast: float

    def value(self, mi: ModuleType, dr: ModuleType, position: Any) -> Any:
        return 1 / (1 + dr.exp(-LOGISTIC * self.contrast * self.field.value(mi, dr, position)))


@dataclass(frozen=True)
class Dirt:
    """0 where a Gaussian random field is below the level that the share ``cover`` of space is below; 1 above."""

    field: Waves
    cover: float
    softness: float

    def value(self, mi: ModuleType, dr: ModuleType, position: Any) -> Any:
        above = self.field.value(mi, dr, position) - NormalDist().inv_cdf(self.cover)
        return 1 / (1 + dr.exp(-4 / self.softness * above))


@dataclass(frozen=True)
class Stripes:
    """A sine across the planes at right angles to ``direction``, steepened toward a square wave by ``sharpness``."""

    direction: np.ndarray  # (3,) unit
    period: float
    sharpness: float

    def value(self, mi: ModuleType, dr: ModuleType, position: Any) -> Any:
        x, y, z = (self.direction * 2 * np.pi / self.period).tolist()
        wave = dr.sin(x * position.x + y * position.y + z * position.z)
        return 0.5 + 0.5 / float(np.tanh(self.sharpness)) * dr.tanh(self.sharpness * wave)


@dataclass(frozen=True)
class Cracks:
    """0 on the boundaries of Voronoi cells about one random point in each cube of a grid, 1 from ``width`` / 2 away.

    The distance to the boundary is the least over all other points q of (|q − x|² − |p − x|²) / 2|q − p|, p the nearest
    point. S. Worley, "A cellular texture basis function" (1996).
    """

    size: float
    width: float
    seed: int

    def value(self, mi: ModuleType, dr: ModuleType, position: Any) -> Any:
        at = [position[k] / self.size for k in range(3)]
        cell = [dr.floor(a) for a in at]
        points = [self._point(mi, [cell[k] + offset[k] for k in range(3)]) for offset in NEIGHBOURS]
        away = [[point[k] - at[k] for k in range(3)] for point in points]
        square = [a[0] * a[0] + a[1] * a[1] + a[2] * a[2] for a in away]
        least, nearest = square[0], away[0]
        for s, a in zip(square[1:], away[1:], strict=True):
            closer = s < least
            least = dr.select(closer, s, least)
            nearest = [dr.select(closer, a[k], nearest[k]) for k in range(3)]
        border: Any = mi.Float(10.0)
        for s, a in zip(square, away, strict=True):
            apart = sum((a[k] - nearest[k]) * (a[k] - nearest[k]) for k in range(3))
            border = dr.select(apart > 1e-6, dr.minimum(border, (s - least) / (2 * dr.sqrt(apart) + 1e-9)), border)
        share = dr.minimum(border * self.size / (0.5 * self.width), 1.0)
        return share * share * (3 - 2 * share)

    def _point(self, mi: ModuleType, cell: list[Any]) -> list[Any]:
        """The random point of a cell, from a hash of its three whole numbers."""
        x, y, z = (mi.UInt32(mi.Int32(c)) & MASK for c in cell)
        mixed = (x * 0x8DA6B343) ^ (y * 0xD8163841) ^ (z * 0xCB1AB31F) ^ (self.seed * 0x9E3779B1 & MASK)
        out = []
        for k in range(3):
            mixed = _mixed(mixed + 0x6C8E9CF5 & MASK)
            out.append(cell[k] + mi.Float(mixed & 0xFFFFFF) / float(1 << 24))
        return out


def _mixed(value: Any) -> Any:
    """A hash of 32-bit integers in which every bit of the result depends on every bit given (C. Wellons, 2018)."""
    value = (value ^ (value >> 16)) * 0x7FEB352D & MASK
    value = (value ^ (value >> 15)) * 0x846CA68B & MASK
    return value ^ (value >> 16)


Pattern = Noise | Dirt | Stripes | Cracks


def pattern(spec: configs.NoiseMap | configs.StripesMap | configs.CracksMap | configs.DirtMap) -> Pattern:
    """The pattern of a config."""
    match spec:
        case configs.NoiseMap():
            return Noise(waves(spec.size, spec.octaves, spec.seed), spec.contrast)
        case configs.DirtMap():
            return Dirt(waves(spec.size, 4, spec.seed), spec.cover, spec.softness)
        case configs.StripesMap():
            direction = np.asarray(spec.direction, float)
            return Stripes(direction / np.linalg.norm(direction), spec.period, spec.sharpness)
        case configs.CracksMap():
            return Cracks(spec.size, spec.width, spec.seed)
    raise TypeError(f"no pattern for {type(spec).__name__}")
