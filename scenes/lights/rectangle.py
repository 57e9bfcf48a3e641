"""A rectangular light that emits to one side like a matte surface. The camera does not see it."""

from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import Any, ClassVar

import numpy as np

from huesphere.configs import lights as configs
from huesphere.scenes.lights.source import Light, RayLight, emitted, kernel_vector, name_of

GAUSS_POINTS = 12  # abscissae along each side of the quadrature for unoccluded light


@dataclass(frozen=True)
class RectangleLight(RayLight):
    """The rectangle centre ± edge_u/2 ± edge_v/2, which emits to the side of edge_u × edge_v.

    The light on a surface that faces it, far away on its axis, is 1 / r².
    """

    kind: ClassVar[str] = "rectangle"
    sampled: ClassVar[bool] = True

    centre: np.ndarray  # (3,)
    edge_u: np.ndarray  # (3,)
    edge_v: np.ndarray  # (3,)

    @property
    def normal(self) -> np.ndarray:
        """The unit vector (3,) to the side to which it emits."""
        normal = np.cross(self.edge_u, self.edge_v)
        return normal / np.linalg.norm(normal)

    def unoccluded(self, position: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """cosθ cosθ' / r² averaged over the rectangle by Gauss–Legendre quadrature."""
        abscissae, weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)
        u, v = (grid.ravel() / 2 for grid in np.meshgrid(abscissae, abscissae, indexing="ij"))
        targets = self.centre + u[:, None] * self.edge_u + v[:, None] * self.edge_v
        total = np.zeros(len(position))
        for target, weight in zip(targets, np.outer(weights, weights).ravel() / 4, strict=True):
            away = target - position
            reach = np.linalg.norm(away, axis=1)
            here = np.maximum(np.einsum("nc,nc->n", normal, away), 0.0)
            total += weight * here * np.maximum(-(away @ self.normal), 0.0) / reach**4
        return total

    def toward(self, mi: ModuleType, dr: ModuleType, position: Any, square: Any) -> tuple[Any, Any, Any]:
        centre, u, v, normal = (
            kernel_vector(mi, dr, values) for values in (self.centre, self.edge_u, self.edge_v, self.normal)
        )
        away = centre + (square[0] - 0.5) * u + (square[1] - 0.5) * v - mi.Vector3f(position)
        distance = dr.norm(away)
        toward = away / distance
        return toward, distance, dr.maximum(-dr.dot(normal, toward), 0) / dr.square(distance)

    def emitter(self, mi: ModuleType, spectrum: Callable[[np.ndarray], dict[str, Any]]) -> dict[str, Any]:
        u, v = self.edge_u, self.edge_v
        area = float(np.linalg.norm(np.cross(u, v)))
        matrix = np.eye(4)
        matrix[:3] = np.stack([u / 2, v / 2, self.normal, self.centre], axis=1)
        return {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f(matrix),
            # Black, because the sources of this project are not surfaces and reflect nothing.
            "bsdf": {"type": "diffuse", "reflectance": {"type": "spectrum", "value": 0.0}},
            "emitter": {"type": "area", "radiance": spectrum(np.pi * self.spectrum / area)},
        }


def build(spec: configs.RectangleLight, number: int) -> list[Light]:
    """The source of light ``number`` of a config."""
    power = emitted(spec.spectrum, spec.intensity, number)
    place = (np.array(vector, float) for vector in (spec.position, spec.edge_u, spec.edge_v))
    return [RectangleLight(name_of(spec.spectrum, number), power, *place)]
