"""A sky: light from domes with profiles of zenith and horizon, light from the ground, and a sun.

Each of these has a spectrum and is a source of its own.
"""

from dataclasses import dataclass
from types import ModuleType
from typing import Any, ClassVar, Literal

import numpy as np

from huesphere.configs import lights as configs
from huesphere.configs.spectra import SpectrumSpec
from huesphere.scenes.lights.distant import DistantLight
from huesphere.scenes.lights.source import EnvironmentLight, Light, emitted, kernel_vector, unit

Profile = Literal["uniform", "zenith", "horizon", "ground"]


@dataclass(frozen=True)
class DomeLight(EnvironmentLight):
    """Light from all directions d, with a radiance that is a function of c = d·up, its *profile*.

    "uniform": 1; "zenith": max(c, 0); "horizon": 1 − c where c > 0; "ground": 1 where c < 0. It is scaled such that a
    point that nothing surrounds receives 1 from the profile "uniform".
    """

    kind: ClassVar[str] = "dome"

    up: np.ndarray  # (3,) unit
    profile: Profile

    def unoccluded(self, position: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """(1/π) ∫ profile · max(0, n·d) dω."""
        cosine = np.clip(normal @ self.up, -1, 1)
        angle = np.arccos(cosine)
        upper = (1 + cosine) / 2
        # ∫ max(0, u·d) max(0, n·d) dω = (2/3)(sin γ + (π − γ) cos γ), γ the angle between u and n.
        zenith = 2 / (3 * np.pi) * (np.sin(angle) + (np.pi - angle) * cosine)
        return {"uniform": np.ones_like(cosine), "zenith": zenith, "horizon": upper - zenith, "ground": 1 - upper}[
            self.profile
        ]

    def radiance(self, mi: ModuleType, dr: ModuleType, direction: Any) -> Any:
        up = kernel_vector(mi, dr, self.up)
        cosine = direction.x * up.x + direction.y * up.y + direction.z * up.z
        above = dr.maximum(cosine, 0)
        match self.profile:
            case "uniform":
                return dr.select(above >= 0, 1, 0)
            case "zenith":
                return above
            case "horizon":
                return dr.select(cosine > 0, 1 - above, 0)
            case "ground":
                return dr.select(cosine < 0, 1, 0)

    def reference_radiance(self, mi: ModuleType, dr: ModuleType, direction: Any) -> Any:
        cosine = dr.dot(direction, mi.Vector3f(*(float(x) for x in self.up)))
        above = cosine > 0
        return {
            "uniform": mi.Float(1),
            "zenith": dr.select(above, cosine, 0),
            "horizon": dr.select(above, 1 - cosine, 0),
            "ground": dr.select(cosine < 0, mi.Float(1), 0),
        }[self.profile]


def build(spec: configs.SkyLight, number: int) -> list[Light]:
    """The sources of light ``number`` of a config, one for each of its spectra."""
    up = unit(spec.up)
    domes: dict[Profile, SpectrumSpec | None] = {
        "zenith": spec.zenith,
        "horizon": spec.horizon,
        "ground": spec.ground,
    }
    parts: list[Light] = [
        DomeLight(f"sky {number} {profile}", emitted(spectrum, spec.intensity, number, profile), up, profile)
        for profile, spectrum in domes.items()
        if spectrum is not None
    ]
    if spec.sun is not None:
        power = emitted(spec.sun.spectrum, spec.sun.intensity, number, "sun.spectrum")
        parts.append(DistantLight(f"sun {number}", power, unit(spec.sun.direction)))
    return parts
