"""What every light source answers, and the three families in which the renderer treats them.

A source's transport is scaled to the report's shading: a distant light that shines squarely on a surface gives 1.
The renderer asks a source for its family and for the answers below; it knows no kind of light by name.

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

    kind: ClassVar[str]  # as truth.exr names it
    sampled: ClassVar[bool] = False  # whether a part of it may be hidden, so that its visibility is sampled

    name: str
    spectrum: np.ndarray  # (W,) on WAVELENGTHS: mean 1 over 400–700 nm, times the intensity

    @abstractmethod
    def unoccluded(self, position: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """Light that arrives at points (n, 3) of ``normal`` (n, 3) when nothing stands in its way; (n,) float64."""

    def emitter(self, mi: ModuleType, spectrum: Callable[[np.ndarray], dict[str, Any]]) -> dict[str, Any]:
        """The source as the stock integrator's own, a Mitsuba dictionary.

        Radiance 1 leaves a white Lambertian surface that faces it squarely (at distance 1). ``spectrum`` makes a
        Mitsuba spectrum of values (W,). Raises InputError for a source that the stock integrator does not have.
        """
        raise InputError(f"the reference engine has no source like {self.name!r}", got=f"a light of kind {self.kind}")

    def require_outside(self, vertices: np.ndarray) -> None:
        """Raise InputError where a scene with ``vertices`` (V, 3) reaches into the source; most have no inside."""
        return

    def facts(self) -> dict[str, Any]:
        """What truth.exr says of the source: its name, kind and geometry, that is its vectors."""
        vectors = {k: v.tolist() for k, v in vars(self).items() if isinstance(v, np.ndarray) and k != "spectrum"}
        return {"name": self.name, "kind": self.kind, **vectors}

    @property
    def known_position(self) -> np.ndarray | None:
        """(3,) where it stands, for recovery with known lights; None where it stands at no point."""
        return None

    @property
    def known_direction(self) -> np.ndarray | None:
        """(3,) unit, toward it, for recovery with known lights; None where it has no one direction."""
        return None

    @property
    def shading(self) -> np.ndarray | None:
        """(3,) the vector a of the report's model, shading max(0, a·n), Eq. (5); 0 for light that no normal changes.

        None for a source that the model does not cover.
        """
        return None


# ---- the three families --------------------------------------------------------------------------------------------


class RayLight(Light):
    """Light that comes along a ray from a point or a direction: one shadow ray says whether it arrives."""

    @abstractmethod
    def toward(self, mi: ModuleType, dr: ModuleType, position: Any, square: Any) -> tuple[Any, Any, Any]:
        """Unit direction from ``position`` to a point of the source; its distance (None: infinitely far); and the
        irradiance of a surface there that faces it, which falls off with the distance.

        ``square``, a point of [0, 1)², picks the point of a source that is ``sampled``: the mean over the square of
        irradiance times the cosine at the surface is what arrives. Kernel arrays in and out.
        """


class EnvironmentLight(Light):
    """Light from all directions, infinitely far away: what of it arrives is gathered with the bounces."""

    sampled: ClassVar[bool] = True

    @abstractmethod
    def radiance(self, mi: ModuleType, dr: ModuleType, direction: Any) -> Any:
        """π times its radiance along ``direction`` (unit, kernel array), at spectrum 1."""

    @abstractmethod
    def reference_radiance(self, mi: ModuleType, dr: ModuleType, direction: Any) -> Any:
        """`radiance` written out a second time, for the reference engine, so as not to share a mistake."""


class UniformLight(Light):
    """Light that is the same everywhere, 1, whatever the normal and whatever stands around."""

    def unoccluded(self, position: np.ndarray, normal: np.ndarray) -> np.ndarray:
        return np.ones(len(position))

    @property
    def shading(self) -> np.ndarray | None:
        return np.zeros(3)


# ---- what builders share -------------------------------------------------------------------------------------------


def emitted(spectrum: SpectrumSpec, intensity: float, number: int, key: str = "spectrum") -> np.ndarray:
    """(W,) power of light ``number`` of the config by its ``key``. Raises InputError for a spectrum that is none."""
    return intensity * emission(spectrum, where=f"lights[{number}].{key}")


def name_of(spectrum: SpectrumSpec, number: int) -> str:
    """What a source is called: by its spectrum where that has a name, else by its number in the config."""
    return spectrum if isinstance(spectrum, str) else f"light {number}"


def unit(vector: tuple[float, float, float]) -> np.ndarray:
    """(3,) ``vector`` at length 1."""
    array = np.asarray(vector, dtype=float)
    return array / np.linalg.norm(array)


# ---- what kernels share --------------------------------------------------------------------------------------------


def kernel_vector(mi: ModuleType, dr: ModuleType, values: np.ndarray) -> Any:
    """(3,) values as a vector of a kernel: opaque, so that another light does not mean another compilation."""
    return mi.Vector3f(*(dr.opaque(mi.Float, float(x)) for x in values))
