"""The kinds of light: for each model of `configs.lights.LightSpec`, the function that builds its sources."""

from collections.abc import Callable
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


def build_lights(specs: tuple[configs.LightSpec, ...]) -> tuple[Light, ...]:
    """The sources that ``specs`` mean; a sky is several, one for each of its spectra. Raises InputError."""
    return tuple(light for number, spec in enumerate(specs) for light in BUILDERS[type(spec)](spec, number))
