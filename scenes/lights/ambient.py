"""The report's ambient term (3.6): the same for every normal, and never hidden."""

from dataclasses import dataclass
from typing import ClassVar

from huesphere.configs import lights as configs
from huesphere.scenes.lights.source import Light, UniformLight, emitted, name_of


@dataclass(frozen=True)
class AmbientLight(UniformLight):
    """The same everywhere, whatever the normal and whatever stands around."""

    kind: ClassVar[str] = "ambient"


def build(spec: configs.AmbientLight, number: int) -> list[Light]:
    return [AmbientLight(name_of(spec.spectrum, number), emitted(spec.spectrum, spec.intensity, number))]
