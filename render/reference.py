"""The stock renderer: Mitsuba's spectral `path` integrator on the same scene, against which every engine is tested."""

import numpy as np

from scenes.build import Scene
from scenes.mesh import Mesh
from scenes.spectra import WAVELENGTHS

DEPTH = {"direct": 2, "one-bounce": 3, "full": -1}  # path vertices that Mitsuba counts: emitter included
CHANNELS = ("band0_R", "band1_G", "band2_B")  # specfilm sorts its channels by name: these keep R G B in order


def build_reference_scene(mi, scene: Scene):
    """``scene`` as a Mitsuba scene with a spectral film; ``mi`` has a spectral variant set."""
    world = {"type": "scene", "sensor": _sensor(mi, scene)}
    for number in np.unique(scene.mesh.material):
        world[f"mesh{number}"] = _mesh(mi, scene.mesh, int(number), _spectrum(scene.reflectances[number]))
    for i, light in enumerate(scene.lights):
        # An emitter of irradiance π E gives a white Lambertian surface that faces it the radiance E.
        world[f"light{i}"] = {
            "type": "directional",
            "direction": [float(-x) for x in light.direction],
            "irradiance": _spectrum(np.pi * light.spectrum),
        }
    return mi.load_dict(world)


def render_reference(
    mi, scene: Scene, transport: str, *, samples: int, seed: int, max_bounces: int | None
) -> np.ndarray:
    """Stock picture (H, W, 3) in camera units before exposure; ``transport`` is "direct", "one-bounce" or "full"."""
    depth = DEPTH[transport]
    if transport == "full" and max_bounces is not None:
        depth = max_bounces + 2
    integrator = mi.load_dict({"type": "path", "max_depth": depth, "rr_depth": 1000, "hide_emitters": True})
    world = build_reference_scene(mi, scene)
    image = np.array(mi.render(world, integrator=integrator, spp=samples, seed=seed))
    return image[..., :3].astype(np.float64)


def _spectrum(values: np.ndarray) -> dict:
    return {
        "type": "irregular",
        "wavelengths": ", ".join(f"{w:g}" for w in WAVELENGTHS),
        "values": ", ".join(f"{v:.9g}" for v in values),
    }


def _sensor(mi, scene: Scene) -> dict:
    view = scene.view
    top = float(scene.mesh.vertices[:, 2].max()) + view.pixel_size
    half_width = view.width * view.pixel_size / 2
    look = mi.ScalarTransform4f().look_at(origin=[0, 0, top], target=[0, 0, top - 1], up=[0, 1, 0])
    film = {
        "type": "specfilm",
        "width": view.width,
        "height": view.height,
        "component_format": "float32",
        "rfilter": {"type": "box"},
    }
    for channel, curve in zip(CHANNELS, scene.sensitivity.T, strict=True):
        film[channel] = _spectrum(curve)
    return {
        "type": "orthographic",
        "to_world": look @ mi.ScalarTransform4f().scale([half_width, half_width, 1]),
        "near_clip": 1e-3 * view.pixel_size,
        "far_clip": 1e4,
        "film": film,
        "sampler": {"type": "independent"},
    }


def _mesh(mi, mesh: Mesh, number: int, reflectance: dict):
    faces = mesh.faces[mesh.material == number]
    properties = mi.Properties()
    properties["mesh_bsdf"] = mi.load_dict({"type": "diffuse", "reflectance": reflectance})
    shape = mi.Mesh(
        f"mesh{number}",
        vertex_count=len(mesh.vertices),
        face_count=len(faces),
        has_vertex_normals=True,
        props=properties,
    )
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = mesh.vertices.astype(np.float32).ravel()
    parameters["vertex_normals"] = mesh.normals.astype(np.float32).ravel()
    parameters["faces"] = faces.astype(np.uint32).ravel()
    parameters.update()
    return shape
