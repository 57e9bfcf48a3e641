"""A rough dielectric coat over the matte base: direct light, exactly, from Mitsuba's own `roughplastic` scattering.

The highlight has the colour of the light, not of the surface: it is a component of its own. Light that bounces between
coated surfaces is left to the stock integrator, which the caller says aloud. Where something hides a part of an
extended source, both lobes lose the share of light that a matte surface loses.
"""

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.render.transport import Transport
from huesphere.scenes.build import Scene
from huesphere.scenes.lights import AnyLight, DistantLight, NearLight
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


def _scattered(mi, lobe, scene: Scene, traced: Transport, light: AnyLight) -> np.ndarray:
    """π times the lobe's value and the cosine, at each pixel, times the source's falloff; (n,).

    Of an extended source the mean over LIGHT_POINTS of its points, other ones for each pixel.
    """
    if not isinstance(light, DistantLight | NearLight):
        raise InputError(
            "surface.kind: coated", got=f"the source {light.name!r}", expected="distant, point, sphere, rectangle"
        )
    pixels = traced.pixels
    view = -scene.view.rays(pixels.row + 0.5, pixels.col + 0.5)[1]
    interaction = mi.SurfaceInteraction3f()
    frame = mi.Frame3f(mi.Normal3f(_rows(pixels.points.normal)))
    interaction.sh_frame = frame
    interaction.wi = frame.to_local(mi.Vector3f(_rows(view)))
    interaction.wavelengths = 550.0  # any: both lobes are grey
    lattice = fibonacci_lattice(LIGHT_POINTS if isinstance(light, NearLight) and light.extended else 1)
    shift = np.random.default_rng(0).random((len(pixels.row), 2))
    total = np.zeros(len(pixels.row))
    for point in lattice:
        toward, strength = _toward(mi, light, pixels.points.position, (point + shift) % 1.0)
        outgoing = frame.to_local(mi.Vector3f(_rows(toward)))
        total += strength * np.array(lobe.eval(mi.BSDFContext(), interaction, outgoing, True))[0]
    return np.pi * total / len(lattice)


def _toward(
    mi, light: DistantLight | NearLight, position: np.ndarray, square: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Unit directions (n, 3) to points of the source, and the irradiance (n,) of a surface that faces them."""
    if isinstance(light, DistantLight):
        return np.broadcast_to(light.direction, position.shape), np.ones(len(position))
    if light.kind == "sphere":
        # Even over the cone that the ball fills: a dozen times fewer points than spread over its surface.
        away = light.centre - position
        distance = np.linalg.norm(away, axis=1)
        sine2 = np.minimum((light.radius / distance) ** 2, 1)
        spread = sine2 / (1 + np.sqrt(1 - sine2))  # 1 − cos of the cone's half-angle
        cosine = 1 - square[:, 0] * spread
        ring, azimuth = np.sqrt(np.maximum(1 - cosine**2, 0)), 2 * np.pi * square[:, 1]
        local = np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), cosine], axis=1)
        toward = mi.Frame3f(mi.Vector3f(_rows(away / distance[:, None]))).to_world(mi.Vector3f(_rows(local)))
        return np.array(toward).T, 2 * spread / light.radius**2
    target, emitter_normal = light.sample(square)
    away = target - position
    distance = np.linalg.norm(away, axis=1)
    toward = away / distance[:, None]
    if not light.extended:
        return toward, distance**-2
    return toward, np.maximum(-np.einsum("nc,nc->n", emitter_normal, toward), 0) / distance**2


def _rows(vectors: np.ndarray) -> np.ndarray:
    """(n, 3) as the (3, n) float32 that Mitsuba wants."""
    return np.ascontiguousarray(vectors.T, dtype=np.float32)
