"""The table of the kinds of light: the function that builds the sources of each model of ``configs.lights``."""

from collections.abc import Callable, Sequence
from typing import Any

from huesphere.configs import lights as configs
from huesphere.scenes.lights import ambient, distant, point, rectangle, sky, sphere
from huesphere.scenes.lights.source import Light

BUILDERS: dict[type[configs.LightModel], Callable[[Any, int], list[Light]]] = {
    configs.DistantLight: distant.build,
    configs.PointLight: point.build,
    configs.SphereLight: sphere.build,
    configs.RectangleLight: rectangle.build,
    configs.AmbientLight: ambient.build,
    configs.SkyLight: sky.build,
}


def build_lights(specs: Sequence[configs.LightModel]) -> tuple[Light, ...]:
    """The light sources of a config's ``specs``; a sky is several sources. Raises InputError for unknown spectra."""
    return tuple(light for number, spec in enumerate(specs) for light in BUILDERS[type(spec)](spec, number))
