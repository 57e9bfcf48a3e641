"""Environment light for the reference engine: a Mitsuba emitter with a given spectrum and a given angular profile.

Mitsuba has none: its `envmap` multiplies colours by D65. Here each source keeps its own spectrum. All
`EnvironmentLight`s of a scene are in one emitter, because Mitsuba allows a single environment. Their radiance is
`reference_radiance`, which is written independently of the `radiance` that the ray caster uses, so that a mistake in
one shows in the comparison.
"""

import functools
from types import ModuleType
from typing import Any

from huesphere.render.backend import require_vectorised
from huesphere.scenes.lights.source import EnvironmentLight


def environment_emitter(mi: ModuleType, lights: list[tuple[EnvironmentLight, Any]]) -> Any:
    """One emitter for all ``lights``, each with its spectrum as a Mitsuba dictionary.

    Raises InputError in a scalar variant.
    """
    require_vectorised(mi, "the reference engine has a sky")
    emitter = _emitter_class(mi, mi.variant())(mi.Properties())
    emitter.lights = [(light, mi.load_dict(spectrum)) for light, spectrum in lights]
    return emitter


@functools.cache
def _emitter_class(mi: ModuleType, variant: str) -> type:
    """The emitter as a class of the variant that is set; directions are sampled evenly over the sphere."""
    import drjit as dr

    base: Any = mi.Emitter

    class Environment(base):
        def __init__(self, properties: Any) -> None:
            super().__init__(properties)
            self.m_flags = +mi.EmitterFlags.Infinite
            self.lights: list[tuple[EnvironmentLight, Any]] = []
            self.centre, self.radius = mi.Point3f(0), mi.Float(1)

        def set_scene(self, scene: Any) -> None:
            sphere = scene.bbox().bounding_sphere()
            self.centre, self.radius = mi.Point3f(sphere.center), mi.Float(sphere.radius * 2 + 1)

        def eval(self, si: Any, active: Any = True) -> Any:
            return self._radiance(si, -si.wi)

        def sample_direction(self, it: Any, sample: Any, active: Any = True) -> tuple[Any, Any]:
            toward = mi.warp.square_to_uniform_sphere(sample)
            distance = 2 * (dr.norm(it.p - self.centre) + self.radius)
            ds = mi.DirectionSample3f()
            ds.p = it.p + toward * distance
            ds.n = -toward
            ds.uv = sample
            ds.time = it.time
            ds.pdf = dr.inv_four_pi
            ds.delta = False
            ds.emitter = mi.EmitterPtr(self)
            ds.d = toward
            ds.dist = distance
            si = dr.zeros(mi.SurfaceInteraction3f)
            si.wavelengths = it.wavelengths
            return ds, self._radiance(si, toward) * (4 * dr.pi)

        def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            return mi.Float(dr.inv_four_pi)

        def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            si = dr.zeros(mi.SurfaceInteraction3f)
            si.wavelengths = it.wavelengths
            return self._radiance(si, ds.d)

        def is_environment(self) -> bool:
            return True

        def bbox(self) -> Any:
            return mi.ScalarBoundingBox3f()

        def _radiance(self, si: Any, toward: Any) -> Any:
            parts = (spectrum.eval(si) * light.reference_radiance(mi, dr, toward) for light, spectrum in self.lights)
            return sum(parts, mi.Spectrum(0))

    return Environment
