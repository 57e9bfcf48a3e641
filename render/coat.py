"""Surfaces that are not Lambertian: direct light, exactly, by Mitsuba's `roughplastic` or `render.oren_nayar`.

The highlight of a coat has the colour of the light, not of the surface: it is a component of its own. Light that
bounces between such surfaces is left to the stock integrator, which the caller notes in the log. Where something hides
a part of an extended source, all lobes lose the share of light that a Lambertian surface loses. Light from all around,
of a sky or ambient, is sampled by directions distributed as each lobe, with a shadow ray along each of those of a sky.
"""

import numpy as np

from huesphere.render.oren_nayar import oren_nayar_bsdf
from huesphere.render.raycast import RayCaster, ray_caster
from huesphere.render.transport import OFFSET_PIXELS, Transport
from huesphere.scenes.build import RoughMatte, Scene
from huesphere.scenes.lights.source import EnvironmentLight, Light, RayLight
from huesphere.scenes.quadrature import fibonacci_lattice

SHADOWLESS = 1e-12
LIGHT_POINTS = 256  # of an extended source, for each pixel
AROUND_POINTS = 256  # directions of light from all around, for each pixel, lobe and estimate
LANES = 2_000_000  # of one kernel: bounds memory
GOLDEN = 0.6180339887498949  # step of the one-dimensional sequence beside the lattice


def surface_bsdf(mi, scene: Scene, diffuse, specular: float = 1.0):
    """The coated or rough surface for Mitsuba, a dictionary or an object, with ``diffuse`` the base's reflectance."""
    if isinstance(scene.coat, RoughMatte):
        return oren_nayar_bsdf(mi, scene.coat.sigma_deg, diffuse)
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
    """Direct light on the object, (R, L, K, n): by a white base, through the coat if there is one, and off the coat.

    There are two independent estimates, R = 2, if a source shines from all directions, as a sky does; else one.
    """
    direct = traced.images[:, :, 0].mean(axis=0) if cast_shadows else traced.facing
    visible = direct / np.maximum(traced.facing, SHADOWLESS)
    white, black = ({"type": "spectrum", "value": v} for v in (1.0, 0.0))
    if isinstance(scene.coat, RoughMatte):
        lobes = [surface_bsdf(mi, scene, white)]
    else:
        lobes = [mi.load_dict(surface_bsdf(mi, scene, white, 0.0)), mi.load_dict(surface_bsdf(mi, scene, black, 1.0))]
    around = any(not isinstance(light, RayLight) for light in scene.lights)
    caster = ray_caster(mi, scene.mesh, OFFSET_PIXELS * scene.view.pixel_size) if around else None
    images = np.zeros((2 if around else 1, len(scene.lights), len(lobes), len(traced.pixels.row)), np.float32)
    for i, light in enumerate(scene.lights):
        for k, lobe in enumerate(lobes):
            if isinstance(light, RayLight):
                images[:, i, k] = _scattered(mi, lobe, scene, traced, light) * visible[i]
                continue
            blocked = caster if cast_shadows and isinstance(light, EnvironmentLight) else None
            for replicate in range(len(images)):
                images[replicate, i, k] = _from_around(mi, lobe, scene, traced, light, blocked, replicate)
    return images


def _interaction(mi, scene: Scene, traced: Transport, copies: int = 1):
    """(frames of the surface, the interactions of camera rays with it) at the pixels, as kernel arrays.

    All pixels come ``copies`` times, one copy after the other.
    """
    pixels = traced.pixels
    view = np.tile(-scene.view.rays(pixels.row + 0.5, pixels.col + 0.5)[1], (copies, 1))
    interaction = mi.SurfaceInteraction3f()
    frame = mi.Frame3f(mi.Normal3f(_rows(np.tile(pixels.points.normal, (copies, 1)))))
    interaction.sh_frame = frame
    interaction.wi = frame.to_local(mi.Vector3f(_rows(view)))
    interaction.wavelengths = 550.0  # any: both lobes are grey
    return frame, interaction


# More than seven parameters: a lobe of a scene under a light, and how it is sampled.
def _from_around(
    mi, lobe, scene: Scene, traced: Transport, light: Light, caster: RayCaster | None, replicate: int
) -> np.ndarray:
    """∫ f cosθ L dω at each pixel, (n,), L being π times the radiance of a source that is all around.

    By directions that are distributed as the lobe f, AROUND_POINTS for each pixel; ``caster`` finds what the scene
    hides, None: nothing.
    """
    import drjit as dr

    count = len(traced.pixels.row)
    shift = np.random.default_rng((replicate, 17)).random((count, 3))
    lattice = np.concatenate([fibonacci_lattice(AROUND_POINTS), GOLDEN * np.arange(AROUND_POINTS)[:, None]], axis=1)
    at_once = max(1, LANES // count)
    total = np.zeros(count)
    for first in range(0, AROUND_POINTS, at_once):
        part = lattice[first : first + at_once]
        frame, interaction = _interaction(mi, scene, traced, copies=len(part))
        u, v, choice = ((part[:, None] + shift) % 1.0).reshape(-1, 3).T
        square = mi.Point2f(mi.Float(u), mi.Float(v))
        sample, weight = lobe.sample(mi.BSDFContext(), interaction, mi.Float(choice), square, True)
        toward = frame.to_world(sample.wo)
        value = dr.select(sample.pdf > 0, weight[0], 0)
        if isinstance(light, EnvironmentLight):
            value *= light.radiance(mi, dr, toward)
        if caster is not None:
            origin = mi.Point3f(_rows(np.tile(traced.pixels.points.origin, (len(part), 1))))
            value = dr.select(caster.scene.ray_test(mi.Ray3f(origin, toward), value > 0), 0, value)
        total += np.broadcast_to(np.array(value), (len(part) * count,)).reshape(len(part), count).sum(axis=0)
    return total / AROUND_POINTS


def _scattered(mi, lobe, scene: Scene, traced: Transport, light: RayLight) -> np.ndarray:
    """π times the lobe's value and the cosine, at each pixel, times the source's falloff; (n,).

    Of an extended source the mean over LIGHT_POINTS of its points, other ones for each pixel.
    """
    import drjit as dr

    pixels = traced.pixels
    frame, interaction = _interaction(mi, scene, traced)
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
