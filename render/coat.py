"""A rough dielectric coat over the matte base: direct light, exactly, from Mitsuba's own `roughplastic` scattering.

The highlight has the colour of the light, not of the surface: it is a component of its own. Light that bounces between
coated surfaces is left to the stock integrator, which the caller says aloud.
"""

import numpy as np

from configs.errors import InputError
from render.transport import Transport
from scenes.build import Scene
from scenes.lights import AnyLight, DistantLight, NearLight

SHADOWLESS = 1e-12


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


def _scattered(mi, lobe, scene: Scene, traced: Transport, light: AnyLight) -> np.ndarray:
    """π times the lobe's value and the cosine, at each pixel, times the source's falloff; (n,)."""
    if isinstance(light, DistantLight):
        toward = np.broadcast_to(light.direction, traced.pixels.points.normal.shape)
        strength = np.ones(len(toward))
    elif isinstance(light, NearLight) and not light.extended:
        away = light.centre - traced.pixels.points.position
        distance = np.linalg.norm(away, axis=1)
        toward, strength = away / distance[:, None], distance**-2
    else:
        raise InputError("surface.kind: coated", got=f"the source {light.name!r}", expected="distant and point lights")
    pixels = traced.pixels
    view = -scene.view.rays(pixels.row + 0.5, pixels.col + 0.5)[1]
    interaction = mi.SurfaceInteraction3f()
    frame = mi.Frame3f(mi.Normal3f(np.ascontiguousarray(pixels.points.normal.T, dtype=np.float32)))
    interaction.sh_frame = frame
    interaction.wi = frame.to_local(mi.Vector3f(np.ascontiguousarray(view.T, dtype=np.float32)))
    interaction.wavelengths = 550.0  # any: both lobes are grey
    outgoing = frame.to_local(mi.Vector3f(np.ascontiguousarray(toward.T, dtype=np.float32)))
    value = np.array(lobe.eval(mi.BSDFContext(), interaction, outgoing, True))[0]
    return np.pi * value * strength
