"""A point light, which radiates equally in all directions."""

from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import Any, ClassVar

import numpy as np

from huesphere.configs import lights as configs
from huesphere.scenes.lights.source import Light, RayLight, emitted, kernel_vector, name_of


@dataclass(frozen=True)
class PointLight(RayLight):
    """Light cosθ / r² at the distance r, where θ is the angle between the normal and the direction to the light."""

    kind: ClassVar[str] = "point"

    centre: np.ndarray  # (3,)

    def unoccluded(self, position: np.ndarray, normal: np.ndarray) -> np.ndarray:
        away = self.centre - position
        distance = np.linalg.norm(away, axis=1)
        cosine = np.einsum("nc,nc->n", normal, away) / distance
        return np.maximum(cosine, 0.0) / distance**2

    def toward(self, mi: ModuleType, dr: ModuleType, position: Any, square: Any) -> tuple[Any, Any, Any]:
        away = kernel_vector(mi, dr, self.centre) - mi.Vector3f(position)
        distance = dr.norm(away)
        return away / distance, distance, 1 / dr.square(distance)

    def emitter(self, mi: ModuleType, spectrum: Callable[[np.ndarray], dict[str, Any]]) -> dict[str, Any]:
        position = [float(x) for x in self.centre]
        return {"type": "point", "position": position, "intensity": spectrum(np.pi * self.spectrum)}

    @property
    def known_position(self) -> np.ndarray | None:
        return self.centre


def build(spec: configs.PointLight, number: int) -> list[Light]:
    """The source of light ``number`` of a config."""
    power = emitted(spec.spectrum, spec.intensity, number)
    return [PointLight(name_of(spec.spectrum, number), power, np.array(spec.position, float))]
