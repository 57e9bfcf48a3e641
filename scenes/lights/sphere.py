"""A spherical light with the same radiance everywhere. The camera does not see it, and it casts no shadow."""

from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import Any, ClassVar

import numpy as np

from huesphere.configs import lights as configs
from huesphere.configs.errors import InputError
from huesphere.scenes.lights.source import Light, RayLight, emitted, kernel_vector, name_of


@dataclass(frozen=True)
class SphereLight(RayLight):
    """Light cosθ / r² at the distance r from its centre, for any radius, unless the horizon cuts the sphere.

    θ is the angle between the normal and the direction to the centre.
    """

    kind: ClassVar[str] = "sphere"
    sampled: ClassVar[bool] = True

    centre: np.ndarray  # (3,)
    radius: float

    def unoccluded(self, position: np.ndarray, normal: np.ndarray) -> np.ndarray:
        away = self.centre - position
        distance = np.linalg.norm(away, axis=1)
        cosine = np.einsum("nc,nc->n", normal, away) / distance
        return _ball(cosine, distance / self.radius) / self.radius**2

    def toward(self, mi: ModuleType, dr: ModuleType, position: Any, square: Any) -> tuple[Any, Any, Any]:
        """As `RayLight.toward`, with directions distributed evenly over the cone that the sphere fills."""
        away = kernel_vector(mi, dr, self.centre) - mi.Vector3f(position)
        radius = dr.opaque(mi.Float, float(self.radius))
        distance = dr.norm(away)
        sine2 = dr.minimum(dr.square(radius / distance), 1)
        spread = sine2 / (1 + dr.sqrt(1 - sine2))  # 1 − cos of the cone's half-angle, without cancellation
        cosine = 1 - square[0] * spread
        ring = dr.sqrt(dr.maximum(1 - dr.square(cosine), 0))
        sin_phi, cos_phi = dr.sincos(2 * dr.pi * square[1])
        toward = mi.Frame3f(away / distance).to_world(mi.Vector3f(ring * cos_phi, ring * sin_phi, cosine))
        reach = distance * cosine - dr.sqrt(dr.maximum(dr.square(radius) - dr.square(distance * ring), 0))
        return toward, reach, 2 * spread / dr.square(radius)

    def emitter(self, mi: ModuleType, spectrum: Callable[[np.ndarray], dict[str, Any]]) -> dict[str, Any]:
        area = np.pi * self.radius**2  # of the visible disc
        return {
            "type": "sphere",
            "center": [float(x) for x in self.centre],
            "radius": float(self.radius),
            # Black, because the sources of this project are not surfaces and reflect nothing.
            "bsdf": {"type": "diffuse", "reflectance": {"type": "spectrum", "value": 0.0}},
            "emitter": {"type": "area", "radiance": spectrum(np.pi * self.spectrum / area)},
        }

    def require_outside(self, vertices: np.ndarray) -> None:
        """Raise InputError if the object intersects the sphere, where its form factor is not valid."""
        nearest = float(np.linalg.norm(vertices - self.centre, axis=1).min())
        if nearest <= self.radius:
            raise InputError(
                f"the object reaches into the ball light {self.name!r}",
                got=f"a radius of {self.radius:g}",
                expected=f"less than {nearest:.4g}, the distance of its centre from the object",
            )

    @property
    def known_position(self) -> np.ndarray | None:
        return self.centre


def _ball(cosine: np.ndarray, h: np.ndarray) -> np.ndarray:
    """Irradiance / π by a sphere of radiance 1 whose centre is ``h`` radii away at an angle with this ``cosine``.

    It is cosθ / h² if the whole sphere is above the horizon; if the horizon cuts it, Quílez' closed form (2006).
    """
    whole = np.maximum(cosine, 0.0) / h**2
    cut = np.abs(cosine) < 1.0 / h
    c, k = cosine[cut], h[cut] ** 2
    rest = np.maximum(1.0 - k * c**2, 0.0)
    sine2 = np.maximum(1.0 - c**2, 1e-30)
    part = c * np.arccos(np.clip(-c * np.sqrt((k - 1) / sine2), -1, 1)) - np.sqrt(rest * (k - 1))
    whole[cut] = np.maximum(part / k + np.arctan(np.sqrt(rest / (k - 1))), 0.0) / np.pi
    return whole


def build(spec: configs.SphereLight, number: int) -> list[Light]:
    """The source of light ``number`` of a config."""
    power = emitted(spec.spectrum, spec.intensity, number)
    return [SphereLight(name_of(spec.spectrum, number), power, np.array(spec.position, float), spec.radius)]
