"""Parallel light from one direction: shading max(0, a·n), the light of the report's model."""

from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import Any, ClassVar

import numpy as np

from huesphere.configs import lights as configs
from huesphere.scenes.lights.source import Light, RayLight, emitted, kernel_vector, name_of, unit


@dataclass(frozen=True)
class DistantLight(RayLight):
    """Parallel light max(0, a·n), where a is ``direction``."""

    kind: ClassVar[str] = "distant"

    direction: np.ndarray  # (3,) unit, toward the light, camera frame

    def unoccluded(self, position: np.ndarray, normal: np.ndarray) -> np.ndarray:
        return np.maximum(normal @ self.direction, 0.0)

    def toward(self, mi: ModuleType, dr: ModuleType, position: Any, square: Any) -> tuple[Any, Any, Any]:
        return kernel_vector(mi, dr, self.direction), None, mi.Float(1)

    def emitter(self, mi: ModuleType, spectrum: Callable[[np.ndarray], dict[str, Any]]) -> dict[str, Any]:
        direction = [float(-x) for x in self.direction]
        return {"type": "directional", "direction": direction, "irradiance": spectrum(np.pi * self.spectrum)}

    @property
    def known_direction(self) -> np.ndarray | None:
        return self.direction

    @property
    def shading(self) -> np.ndarray | None:
        return self.direction


def build(spec: configs.DistantLight, number: int) -> list[Light]:
    """The source of light ``number`` of a config."""
    power = emitted(spec.spectrum, spec.intensity, number)
    return [DistantLight(name_of(spec.spectrum, number), power, unit(spec.direction))]
