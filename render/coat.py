"""A rough dielectric coat over the matte base: direct light, exactly, from Mitsuba's own `roughplastic` scattering.

The highlight has the colour of the light, not of the surface: it is a component of its own. Light that bounces between
coated surfaces is left to the stock integrator, which the caller notes in the log. Where something hides a part of an
extended source, both lobes lose the share of light that a matte surface loses.
"""

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.render.transport import Transport
from huesphere.scenes.build import Scene
from huesphere.scenes.lights.source import Light, RayLight
from huesphere.scenes.quadrature import fibonacci_lattice

SHADOWLESS = 1e-12
LIGHT_POINTS = 256  # of an extended source, for each pixel


def coat_bsdf(scene: Scene, diffuse: dict, specular: float = 1.0) -> dict:
    """The coated surface as a Mitsuba dictionary, with ``diffuse`` the base's reflectance."""
    assert scene.coat is not None
    return {
        "type": "roughplastic",
        "distribution": "ggx",
        "alpha": scene.coat.roughness,
        "int_ior": scene.coat.index,
        "nonlinear": False,
        "diffuse_reflectance": diffuse,
        "specular_reflectance": {"type": "spectrum", "value": specular},
    }


def coated_light(mi, scene: Scene, traced: Transport, *, cast_shadows: bool) -> np.ndarray:
    """Direct light on the coated object, (L, 2, n): through the coat to a white base and back, and off the coat."""
    direct = traced.images[:, :, 0].mean(axis=0) if cast_shadows else traced.facing
    visible = direct / np.maximum(traced.facing, SHADOWLESS)
    white, black = ({"type": "spectrum", "value": v} for v in (1.0, 0.0))
    lobes = [mi.load_dict(coat_bsdf(scene, white, 0.0)), mi.load_dict(coat_bsdf(scene, black, 1.0))]
    images = [[_scattered(mi, lobe, scene, traced, light) for lobe in lobes] for light in scene.lights]
    return np.asarray(images, dtype=np.float32) * visible[:, None]


def _scattered(mi, lobe, scene: Scene, traced: Transport, light: Light) -> np.ndarray:
    """π times the lobe's value and the cosine, at each pixel, times the source's falloff; (n,).

    Of an extended source the mean over LIGHT_POINTS of its points, other ones for each pixel.
    """
    if not isinstance(light, RayLight):
        raise InputError(
            "surface.kind: coated", got=f"the source {light.name!r}", expected="distant, point, sphere, rectangle"
        )
    import drjit as dr

    pixels = traced.pixels
    view = -scene.view.rays(pixels.row + 0.5, pixels.col + 0.5)[1]
    interaction = mi.SurfaceInteraction3f()
    frame = mi.Frame3f(mi.Normal3f(_rows(pixels.points.normal)))
    interaction.sh_frame = frame
    interaction.wi = frame.to_local(mi.Vector3f(_rows(view)))
    interaction.wavelengths = 550.0  # any: both lobes are grey
    lattice = fibonacci_lattice(LIGHT_POINTS if light.sampled else 1)
    shift = np.random.default_rng(0).random((len(pixels.row), 2))
    position = mi.Point3f(_rows(pixels.points.position))
    total = np.zeros(len(pixels.row))
    for point in lattice:
        u, v = ((point + shift) % 1.0).T
        toward, _, strength = light.toward(mi, dr, position, (mi.Float(u), mi.Float(v)))
        outgoing = frame.to_local(toward)
        total += np.array(strength) * np.array(lobe.eval(mi.BSDFContext(), interaction, outgoing, True))[0]
    return np.pi * total / len(lattice)


def _rows(vectors: np.ndarray) -> np.ndarray:
    """(n, 3) as the (3, n) float32 that Mitsuba wants."""
    return np.ascontiguousarray(vectors.T, dtype=np.float32)
