"""Light sources: where they stand, how strong each wavelength is, what a surface gets if nothing stands in the way.

A source's transport is scaled to the report's shading: a distant light that shines squarely on a surface gives 1.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from huesphere.configs import schema
from huesphere.scenes.spectra import emission

GAUSS_POINTS = 12  # a side, that stand for a rectangle where nothing occludes it


@dataclass(frozen=True)
class Light:
    """What all sources share."""

    name: str
    spectrum: np.ndarray  # (W,) on WAVELENGTHS: mean 1 over 400–700 nm, times the intensity


@dataclass(frozen=True)
class DistantLight(Light):
    """Parallel light: max(0, a·n)."""

    direction: np.ndarray  # (3,) unit, toward the light, camera frame


@dataclass(frozen=True)
class NearLight(Light):
    """A source at a finite distance r, in scene units: cosθ / r² of its intensity at r = 1, on its axis.

    ``kind`` "point": radiates alike in all directions from ``centre``. "sphere": a ball of ``radius``. "rectangle": one
    face of centre ± ``edge_u``/2 ± ``edge_v``/2, which radiates toward edge_u × edge_v as a matte surface does.
    None of them is seen by the camera or casts a shadow.
    """

    kind: Literal["point", "sphere", "rectangle"]
    centre: np.ndarray  # (3,)
    radius: float = 0.0
    edge_u: np.ndarray | None = None  # (3,)
    edge_v: np.ndarray | None = None  # (3,)

    @property
    def extended(self) -> bool:
        return self.kind != "point"

    def sample(self, square: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points on the source (n, 3) and the normals there (n, 3; 0 for a point) for ``square`` (n, 2) in [0, 1)²."""
        if self.kind == "point":
            return np.broadcast_to(self.centre, (len(square), 3)), np.zeros((len(square), 3))
        if self.kind == "rectangle":
            assert self.edge_u is not None
            assert self.edge_v is not None
            offset = (square[:, :1] - 0.5) * self.edge_u + (square[:, 1:] - 0.5) * self.edge_v
            normal = np.cross(self.edge_u, self.edge_v)
            return self.centre + offset, np.broadcast_to(normal / np.linalg.norm(normal), (len(square), 3))
        z = 1 - 2 * square[:, 0]
        azimuth = 2 * np.pi * square[:, 1]
        ring = np.sqrt(np.maximum(0, 1 - z**2))
        normal = np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), z], axis=1)
        return self.centre + self.radius * normal, normal

    @property
    def scale(self) -> float:
        """What the mean of cosθ cosθ_l / r² over `sample` is multiplied by: far away, on the axis, it gives 1 / r²."""
        return 4.0 if self.kind == "sphere" else 1.0  # a ball of area 4πR² shows a disc of area πR²


@dataclass(frozen=True)
class DomeLight(Light):
    """Light from all directions d with a profile over c = d·up: the whole of profile "uniform" gives 1 in the open.

    "uniform": 1; "zenith": max(c, 0); "horizon": 1 − c where c > 0; "ground": 1 where c < 0.
    """

    up: np.ndarray  # (3,) unit
    profile: Literal["uniform", "zenith", "horizon", "ground"]

    def unoccluded(self, normal: np.ndarray) -> np.ndarray:
        """(1/π) ∫ profile · max(0, n·d) dω for normals (..., 3), nothing in the way."""
        cosine = np.clip(normal @ self.up, -1, 1)
        angle = np.arccos(cosine)
        upper = (1 + cosine) / 2
        # ∫ max(0, u·d) max(0, n·d) dω = (2/3)(sin γ + (π − γ) cos γ), γ the angle between u and n.
        zenith = 2 / (3 * np.pi) * (np.sin(angle) + (np.pi - angle) * cosine)
        return {"uniform": np.ones_like(cosine), "zenith": zenith, "horizon": upper - zenith, "ground": 1 - upper}[
            self.profile
        ]


@dataclass(frozen=True)
class AmbientLight(Light):
    """The report's ambient term (3.6): the same everywhere, whatever the normal and whatever stands around."""


def unoccluded(light: "AnyLight", position: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Light that arrives at points (n, 3) of ``normal`` (n, 3) when nothing stands in its way; (n,) float64."""
    match light:
        case DistantLight():
            return np.maximum(normal @ light.direction, 0.0)
        case DomeLight():
            return light.unoccluded(normal)
        case AmbientLight():
            return np.ones(len(position))
        case NearLight():
            return _unoccluded_near(light, position, normal)


def _unoccluded_near(light: NearLight, position: np.ndarray, normal: np.ndarray) -> np.ndarray:
    away = light.centre - position
    distance = np.linalg.norm(away, axis=1)
    cosine = np.einsum("nc,nc->n", normal, away) / distance
    if light.kind == "sphere":
        return _ball(cosine, distance / light.radius) / light.radius**2
    if light.kind == "point":
        return np.maximum(cosine, 0.0) / distance**2
    abscissae, weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)
    square = np.stack(np.meshgrid(abscissae, abscissae, indexing="ij"), axis=-1).reshape(-1, 2) / 2 + 0.5
    total = np.zeros(len(position))
    for target, emitter_normal, weight in zip(
        *light.sample(square), np.outer(weights, weights).ravel() / 4, strict=True
    ):
        away = target - position
        reach = np.linalg.norm(away, axis=1)
        here = np.maximum(np.einsum("nc,nc->n", normal, away), 0.0)
        total += weight * here * np.maximum(-(away @ emitter_normal), 0.0) / reach**4
    return total


def _ball(cosine: np.ndarray, h: np.ndarray) -> np.ndarray:
    """Irradiance over π of a ball of radiance 1, its centre ``h`` radii away under ``cosine``, cut by the horizon.

    Above the horizon cosθ / h², whatever the distance; a ball that is cut: Quílez' closed form (2006).
    """
    whole = np.maximum(cosine, 0.0) / h**2
    cut = np.abs(cosine) < 1.0 / h
    c, k = cosine[cut], h[cut] ** 2
    rest = np.maximum(1.0 - k * c**2, 0.0)
    sine2 = np.maximum(1.0 - c**2, 1e-30)
    part = c * np.arccos(np.clip(-c * np.sqrt((k - 1) / sine2), -1, 1)) - np.sqrt(rest * (k - 1))
    whole[cut] = np.maximum(part / k + np.arctan(np.sqrt(rest / (k - 1))), 0.0) / np.pi
    return whole


AnyLight = DistantLight | NearLight | DomeLight | AmbientLight


def build_lights(specs: tuple[schema.LightSpec, ...]) -> tuple[AnyLight, ...]:
    """The sources that ``specs`` mean; a sky is several, one for each spectrum it is mixed of. Raises InputError."""
    lights: list[AnyLight] = []
    for number, spec in enumerate(specs):
        lights += _build(spec, number)
    return tuple(lights)


def _build(spec: schema.LightSpec, number: int) -> list[AnyLight]:
    def power(spectrum: schema.SpectrumSpec, key: str = "spectrum") -> np.ndarray:
        return spec.intensity * emission(spectrum, where=f"lights[{number}].{key}")

    def name(spectrum: schema.SpectrumSpec, kind: str = "light") -> str:
        return spectrum if isinstance(spectrum, str) else f"{kind} {number}"

    match spec:
        case schema.DistantLight():
            return [DistantLight(name(spec.spectrum), power(spec.spectrum), _unit(spec.direction))]
        case schema.PointLight():
            return [NearLight(name(spec.spectrum), power(spec.spectrum), "point", np.array(spec.position, float))]
        case schema.SphereLight():
            centre = np.array(spec.position, float)
            return [NearLight(name(spec.spectrum), power(spec.spectrum), "sphere", centre, radius=spec.radius)]
        case schema.RectangleLight():
            edge_u, edge_v = (np.array(e, float) for e in (spec.edge_u, spec.edge_v))
            near = NearLight(name(spec.spectrum), power(spec.spectrum), "rectangle", np.array(spec.position, float))
            return [replace(near, edge_u=edge_u, edge_v=edge_v)]
        case schema.AmbientLight():
            return [AmbientLight(name(spec.spectrum), power(spec.spectrum))]
        case schema.SkyLight():
            return _sky(spec, number, power)
    raise TypeError(f"no builder for {type(spec).__name__}")


def _sky(spec: schema.SkyLight, number: int, power) -> list[AnyLight]:
    up = _unit(spec.up)
    parts: list[AnyLight] = [DomeLight(f"sky {number} zenith", power(spec.zenith, "zenith"), up, "zenith")]
    parts.append(DomeLight(f"sky {number} horizon", power(spec.horizon, "horizon"), up, "horizon"))
    if spec.ground is not None:
        parts.append(DomeLight(f"sky {number} ground", power(spec.ground, "ground"), up, "ground"))
    if spec.sun is not None:
        sun = spec.sun
        strength = sun.intensity * emission(sun.spectrum, where=f"lights[{number}].sun.spectrum")
        parts.append(DistantLight(f"sun {number}", strength, _unit(sun.direction)))
    return parts


def _unit(vector: tuple[float, float, float]) -> np.ndarray:
    array = np.asarray(vector, dtype=float)
    return array / np.linalg.norm(array)
