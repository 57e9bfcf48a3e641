"""The interface of light sources, and the three families of sources that the renderer distinguishes.

Light that arrives is scaled such that a distant light on a surface that faces it gives 1, as in the report's shading.
The renderer uses only the family of a source and the methods below, and no kind of light by name.

Methods that take ``mi`` and ``dr`` (the modules Mitsuba and Dr.Jit, with a variant set) work on arrays of that variant:
one array element for each ray, or plain numbers where the variant is scalar. Nothing here imports either module.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import Any, ClassVar

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.spectra import SpectrumSpec
from huesphere.scenes.spectra import emission


@dataclass(frozen=True)
class Light(ABC):
    """A source of one spectrum. Camera frame, lengths in scene units."""

    kind: ClassVar[str]  # its name in truth.exr
    sampled: ClassVar[bool] = False  # whether it is extended, so that its visibility is sampled

    name: str
    spectrum: np.ndarray  # (W,) on WAVELENGTHS: mean 1 over 400–700 nm, times the intensity

    @abstractmethod
    def unoccluded(self, position: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """Light that arrives at points (n, 3) with the ``normal`` (n, 3) if nothing blocks it; (n,) float64."""

    def emitter(self, mi: ModuleType, spectrum: Callable[[np.ndarray], dict[str, Any]]) -> dict[str, Any]:
        """The source as the dictionary of a Mitsuba emitter, for the reference engine.

        It is scaled such that a white Lambertian surface that faces it (at distance 1) has the radiance 1. ``spectrum``
        makes a Mitsuba spectrum of values (W,). Raises InputError for a source that Mitsuba does not have.
        """
        raise InputError(f"the reference engine has no source like {self.name!r}", got=f"a light of kind {self.kind}")

    def require_outside(self, vertices: np.ndarray) -> None:
        """Raise InputError if a scene with ``vertices`` (V, 3) intersects the source; most sources have no inside."""
        return

    def facts(self) -> dict[str, Any]:
        """The entry of the source in truth.exr: its name, its kind, and all its vectors."""
        vectors = {k: v.tolist() for k, v in vars(self).items() if isinstance(v, np.ndarray) and k != "spectrum"}
        return {"name": self.name, "kind": self.kind, **vectors}

    @property
    def known_position(self) -> np.ndarray | None:
        """Its position (3,), for recovery with known lights; None if it has no one position."""
        return None

    @property
    def known_direction(self) -> np.ndarray | None:
        """The unit vector (3,) toward it, for recovery with known lights; None if it has no one direction."""
        return None

    @property
    def shading(self) -> np.ndarray | None:
        """The vector a (3,) of the report's model, with shading max(0, a·n), Eq. (5).

        0 for light that does not depend on the normal, None for a source that the model does not describe.
        """
        return None


# ---- the three families --------------------------------------------------------------------------------------------


class RayLight(Light):
    """Light that comes along a ray from a point or a direction; one shadow ray decides whether it arrives."""

    @abstractmethod
    def toward(self, mi: ModuleType, dr: ModuleType, position: Any, square: Any) -> tuple[Any, Any, Any]:
        """(unit direction from ``position`` to a point of the source, its distance, irradiance).

        The distance is None for a source that is infinitely far. The irradiance is that of a surface at ``position``
        which faces the point. ``square``, a point of [0, 1)², chooses the point of a ``sampled`` source; the light that
        arrives is the mean over the square of irradiance times the cosine at the surface. Kernel arrays in and out.
        """


class EnvironmentLight(Light):
    """Light from all directions, infinitely far away; the part that arrives is computed together with the bounces."""

    sampled: ClassVar[bool] = True

    @abstractmethod
    def radiance(self, mi: ModuleType, dr: ModuleType, direction: Any) -> Any:
        """π times its radiance along ``direction`` (unit, kernel array), at spectrum 1."""

    @abstractmethod
    def reference_radiance(self, mi: ModuleType, dr: ModuleType, direction: Any) -> Any:
        """`radiance`, written independently for the reference engine, so that a mistake in either is noticed."""


class UniformLight(Light):
    """Light that is 1 everywhere, for every normal, and is never blocked."""

    def unoccluded(self, position: np.ndarray, normal: np.ndarray) -> np.ndarray:
        return np.ones(len(position))

    @property
    def shading(self) -> np.ndarray | None:
        return np.zeros(3)


# ---- helpers of the builders ---------------------------------------------------------------------------------------


def emitted(spectrum: SpectrumSpec, intensity: float, number: int, key: str = "spectrum") -> np.ndarray:
    """Spectrum (W,) of light ``number`` of the config, from its ``key``, times the intensity. Raises InputError."""
    return intensity * emission(spectrum, where=f"lights[{number}].{key}")


def name_of(spectrum: SpectrumSpec, number: int) -> str:
    """The name of a source: that of its spectrum if it has one, otherwise "light" and its number in the config."""
    return spectrum if isinstance(spectrum, str) else f"light {number}"


def unit(vector: tuple[float, float, float]) -> np.ndarray:
    """(3,) ``vector`` at length 1."""
    array = np.asarray(vector, dtype=float)
    return array / np.linalg.norm(array)


# ---- helpers of kernels --------------------------------------------------------------------------------------------


def kernel_vector(mi: ModuleType, dr: ModuleType, values: np.ndarray) -> Any:
    """``values`` (3,) as a vector of a kernel, opaque, so that the kernel is not compiled again for another light."""
    return mi.Vector3f(*(dr.opaque(mi.Float, float(x)) for x in values))
