"""Ambient light, the report's ambient term (3.6): the same for every normal, and never blocked."""

from dataclasses import dataclass
from typing import ClassVar

from huesphere.configs import lights as configs
from huesphere.scenes.lights.source import Light, UniformLight, emitted, name_of


@dataclass(frozen=True)
class AmbientLight(UniformLight):
    """Light that is the same everywhere and for every normal."""

    kind: ClassVar[str] = "ambient"


def build(spec: configs.AmbientLight, number: int) -> list[Light]:
    """The source of light ``number`` of a config."""
    return [AmbientLight(name_of(spec.spectrum, number), emitted(spec.spectrum, spec.intensity, number))]
