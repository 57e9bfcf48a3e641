"""The reference engine: Mitsuba's own spectral `path` integrator, unchanged; the other engines are tested with it."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from huesphere.render.coat import surface_bsdf
from huesphere.render.reference_albedo import albedo_texture, vertex_attributes
from huesphere.render.reference_environment import environment_emitter
from huesphere.scenes.build import Scene
from huesphere.scenes.lights.source import EnvironmentLight
from huesphere.scenes.mesh import Mesh
from huesphere.scenes.primitives import join
from huesphere.scenes.spectra import WAVELENGTHS

DEPTH = {"direct": 2, "one-bounce": 3, "full": -1}  # path vertices that Mitsuba counts: emitter included
PATHS_AT_ONCE = 2_000_000  # about a second of work
CHANNELS = ("band0_R", "band1_G", "band2_B")  # specfilm sorts its channels by name: these keep R G B in order


def build_reference_scene(mi, scene: Scene, sampler: str = "independent"):
    """``scene`` as a Mitsuba scene with a spectral film.

    ``mi`` is the Mitsuba module with a spectral variant set, ``sampler`` the name of a Mitsuba sampler.
    """
    world = {"type": "scene", "sensor": _sensor(mi, scene, sampler)}
    mesh = scene.mesh if scene.enclosure is None else join([scene.mesh, scene.enclosure.mesh()])
    for number in np.unique(mesh.material):
        varies = scene.albedo is not None and scene.is_object[number]
        reflectance = albedo_texture(mi, scene, _spectrum) if varies else _spectrum(scene.reflectances[number])
        coated = scene.coat is not None and scene.is_object[number]
        surface = surface_bsdf(mi, scene, reflectance) if coated else {"type": "diffuse", "reflectance": reflectance}
        world[f"mesh{number}"] = _mesh(mi, mesh, int(number), surface, vertex_attributes(scene) if varies else {})
    sky = [(light, _spectrum(light.spectrum)) for light in scene.lights if isinstance(light, EnvironmentLight)]
    if sky:
        world["sky"] = environment_emitter(mi, sky)
    for i, light in enumerate(scene.lights):
        if not isinstance(light, EnvironmentLight):
            world[f"light{i}"] = light.emitter(mi, _spectrum)
    return mi.load_dict(world)


def render_reference(
    mi, scene: Scene, transport: str, *, samples: int, seed: int, max_bounces: int | None
) -> np.ndarray:
    """Mitsuba's picture (H, W, 3) in camera units; ``transport`` is "direct", "one-bounce" or "full"."""
    return _render(mi, build_reference_scene(mi, scene), _depth(transport, max_bounces), samples, seed)


def render_parts(
    mi, scene: Scene, transport: str, *, samples: int, seed: int, max_bounces: int | None
) -> list[np.ndarray]:
    """The picture split into direct light, one bounce and the rest, each (H, W, 3), up to the level ``transport``.

    With the same seed Mitsuba follows the same paths whatever their greatest length. So the difference of two pictures
    is the light that the longer paths add, without noise of the shorter ones, and 0 where a surface sees no other.
    """
    world = build_reference_scene(mi, scene)
    reaches = list(DEPTH)[: list(DEPTH).index(transport) + 1]
    pictures = [_render(mi, world, _depth(reach, max_bounces), samples, seed) for reach in reaches]
    return [pictures[0], *(longer - shorter for shorter, longer in pairwise(pictures))]


def render_lights(mi, scene: Scene, transport: str, *, samples: int, seed: int, max_bounces: int | None) -> np.ndarray:
    """`render_parts` for each source alone, (L, parts, H, W, 3); each source gets 1/L of the samples of a pixel."""
    share = max(1, samples // len(scene.lights))
    seeds = np.random.SeedSequence(seed).generate_state(len(scene.lights))
    alone = [replace(scene, lights=(light,)) for light in scene.lights]
    return np.stack(
        [
            np.stack(render_parts(mi, one, transport, samples=share, seed=int(s), max_bounces=max_bounces))
            for one, s in zip(alone, seeds, strict=True)
        ]
    )


def _depth(transport: str, max_bounces: int | None) -> int:
    return max_bounces + 2 if transport == "full" and max_bounces is not None else DEPTH[transport]


def _render(mi, world, depth: int, samples: int, seed: int) -> np.ndarray:
    """The picture (H, W, 3) by paths of at most ``depth`` vertices, as the mean of several launches of few paths.

    Mitsuba reacts to an interrupt only between launches.
    """
    integrator = mi.load_dict({"type": "path", "max_depth": depth, "rr_depth": 1000, "hide_emitters": True})
    width, height = world.sensors()[0].film().size()
    most = max(1, PATHS_AT_ONCE // (width * height))
    total = np.zeros((height, width, 3))
    for number, done in enumerate(range(0, samples, most)):
        count = min(most, samples - done)
        launch = int(np.random.SeedSequence((seed, number)).generate_state(1)[0])
        # Not mi.render: it would wrap an interrupt in an error of its own.
        image = np.array(integrator.render(world, seed=launch, spp=count))
        if integrator.should_stop():  # Mitsuba took the interrupt for itself
            raise KeyboardInterrupt
        total += count * image[..., :3].astype(np.float64)
    return total / samples


def _spectrum(values: np.ndarray) -> dict:
    """``values`` (W,) at WAVELENGTHS as the dictionary of a Mitsuba spectrum."""
    if not (values > 0).any():  # a light that is off: `irregular` refuses it
        return {"type": "uniform", "value": 0.0}
    return {
        "type": "irregular",
        "wavelengths": ", ".join(f"{w:g}" for w in WAVELENGTHS),
        "values": ", ".join(f"{v:.9g}" for v in values),
    }


def _sensor(mi, scene: Scene, sampler: str) -> dict:
    """The camera and film of ``scene`` as the dictionary of a Mitsuba sensor; ``sampler`` is a Mitsuba sampler's name.

    The camera is on the z axis and looks toward −z. In an orthographic view it stands at ``view.front``, in front of
    everything; in perspective at ``view.eye``. The three channels of the film have the camera's sensitivities.
    """
    view = scene.view
    z = view.front if view.eye is None else view.eye
    look = mi.ScalarTransform4f().look_at(origin=[0, 0, z], target=[0, 0, z - 1], up=[0, 1, 0])
    film = {
        "type": "specfilm",
        "width": view.width,
        "height": view.height,
        "component_format": "float32",
        "rfilter": {"type": "box"},
    }
    for channel, curve in zip(CHANNELS, scene.sensitivity.T, strict=True):
        film[channel] = _spectrum(curve)
    shared = {"near_clip": 1e-3 * view.pixel_size, "far_clip": 1e4, "film": film, "sampler": {"type": sampler}}
    if view.focal_px is None:
        half_width = view.width * view.pixel_size / 2
        return {
            "type": "orthographic",
            "to_world": look @ mi.ScalarTransform4f().scale([half_width, half_width, 1]),
            **shared,
        }
    angle = 2 * np.degrees(np.arctan(view.height / 2 / view.focal_px))
    return {"type": "perspective", "to_world": look, "fov": float(angle), "fov_axis": "y", **shared}


def _mesh(mi, mesh: Mesh, number: int, surface, attributes: dict[str, np.ndarray]):
    """The faces of material ``number`` as a Mitsuba mesh with the scattering function ``surface``.

    That is an object of Mitsuba or its dictionary. ``attributes`` (V', 1) of the first V' vertices, by their names.
    """
    faces = mesh.faces[mesh.material == number]
    properties = mi.Properties()
    properties["mesh_bsdf"] = mi.load_dict(surface) if isinstance(surface, dict) else surface
    shape = mi.Mesh(
        f"mesh{number}",
        vertex_count=len(mesh.vertices),
        face_count=len(faces),
        has_vertex_normals=True,
        has_vertex_texcoords=mesh.uv is not None,
        props=properties,
    )
    for name, values in attributes.items():
        padded = np.zeros(len(mesh.vertices), np.float32)
        padded[: len(values)] = values[:, 0]
        shape.add_attribute(name, 1, padded)
    parameters = mi.traverse(shape)
    if mesh.uv is not None:
        parameters["vertex_texcoords"] = mesh.uv.astype(np.float32).ravel()
    parameters["vertex_positions"] = mesh.vertices.astype(np.float32).ravel()
    parameters["vertex_normals"] = mesh.normals.astype(np.float32).ravel()
    parameters["faces"] = faces.astype(np.uint32).ravel()
    parameters.update()
    return shape
