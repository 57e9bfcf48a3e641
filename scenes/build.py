"""From a RunConfig to the world it means: mesh, reflectances, lights and camera, as arrays."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from huesphere.configs import schema
from huesphere.configs.schema import RunConfig
from huesphere.scenes import primitives
from huesphere.scenes.bust import bust_mesh
from huesphere.scenes.cameras import sensitivity
from huesphere.scenes.lights.source import Light
from huesphere.scenes.lights.table import build_lights
from huesphere.scenes.mesh import Mesh
from huesphere.scenes.room import WALLS, Enclosure, build_enclosure
from huesphere.scenes.spectra import reflectance
from huesphere.scenes.surfaces import depth_mesh, read_depth_map, read_mesh, resample
from huesphere.scenes.texture import paint_faces, paint_vertices
from huesphere.scenes.view import View, frame_mesh


@dataclass(frozen=True)
class Coat:
    """A rough dielectric layer over the matte base of the object."""

    roughness: float  # GGX alpha
    index: float  # refractive index


@dataclass(frozen=True)
class Scene:
    """All that the renderer is given. Camera frame throughout."""

    mesh: Mesh
    reflectances: np.ndarray  # (M, W), of each material
    is_object: np.ndarray  # (M,) bool: pixels of this material make the mask
    lights: tuple[Light, ...]
    view: View
    sensitivity: np.ndarray  # (W, 3)
    pixel_vertex: (
        np.ndarray | None
    )  # (H, W) int32: where the mesh has a vertex at every pixel centre, its number, else −1
    area_pixels: bool  # shade over the pixel's area, not at its centre
    coat: Coat | None  # over the object's materials
    enclosure: Enclosure | None  # a room around the object; its walls are no part of the mesh
    shape_label: str  # for the log: which shape this is


def build_scene(config: RunConfig) -> Scene:
    """The world of ``config``. Raises InputError for files and names that do not hold."""
    mesh, view, pixel_vertex, label = _build_shape(config)
    reflectances, is_object = _reflectances(config)
    if config.surface.checker is not None:
        paint = paint_vertices if config.surface.checker.by == "vertex" else paint_faces
        mesh = paint(mesh, config.surface.checker.size, material=1)
    if getattr(config.shape, "background", False):
        mesh = primitives.join([mesh, _background(mesh, view, material=int(is_object.sum()))])
    enclosure = None
    if config.room is not None:
        enclosure = build_enclosure(mesh, config.room, first_material=len(reflectances) - len(WALLS))
    surface, lights = config.surface, build_lights(config.lights)
    for light in lights:
        light.require_outside(mesh.vertices)
    return Scene(
        mesh=mesh,
        reflectances=reflectances,
        is_object=is_object,
        lights=lights,
        view=view,
        sensitivity=sensitivity(config.camera.sensitivity),
        pixel_vertex=pixel_vertex,
        area_pixels=config.camera.pixel == "area",
        coat=Coat(surface.roughness, surface.index) if isinstance(surface, schema.Coated) else None,
        enclosure=enclosure,
        shape_label=label,
    )


def recoloured(scene: Scene, config: RunConfig) -> Scene:
    """``scene`` with the spectra of ``config``, all else being the same in both: nothing of geometry is built again."""
    return replace(
        scene,
        reflectances=_reflectances(config)[0],
        lights=build_lights(config.lights),
        sensitivity=sensitivity(config.camera.sensitivity),
    )


def _reflectances(config: RunConfig) -> tuple[np.ndarray, np.ndarray]:
    """Of each material (M, W), and whether it is the object's (M,): the object's one or two, background, walls."""
    found = [reflectance(config.surface.reflectance, where="surface.reflectance")]
    is_object = [True]
    if config.surface.checker is not None:
        found.append(reflectance(config.surface.checker.reflectance, where="surface.checker.reflectance"))
        is_object.append(True)
    if getattr(config.shape, "background", False):
        found.append(np.zeros_like(found[0]))
        is_object.append(False)
    if config.room is not None:
        found += [reflectance(getattr(config.room, wall), where=f"room.{wall}") for wall in WALLS]
        is_object += [False] * len(WALLS)
    return np.stack(found), np.array(is_object)


# ---- the object ----------------------------------------------------------------------------------------------------


def _build_shape(config: RunConfig) -> tuple[Mesh, View, np.ndarray | None, str]:
    spec, camera = config.shape, config.camera
    if not isinstance(spec, schema.DepthMap):
        mesh, label = _build_mesh(spec)
        return mesh, frame_mesh(mesh, camera), None, label
    width, height = camera.resolution
    grid = read_depth_map(Path(spec.path), depth_scale=spec.depth_scale, toward_camera=spec.toward_camera)
    rows, cols = grid.depth.shape
    wanted = camera.view_height
    pixels_per_step = min(height / rows, width / cols) if wanted == "auto" else height / wanted
    mesh, vertex = depth_mesh(resample(grid, (height, width), pixels_per_step), 1.0 / pixels_per_step)
    view = frame_mesh(mesh, camera, view_height=height / pixels_per_step)
    return mesh, view, vertex if camera.projection == "orthographic" else None, f"depth map {spec.path}"


def _build_mesh(spec: schema.ShapeSpec) -> tuple[Mesh, str]:
    match spec:
        case schema.Bust():
            return bust_mesh(spec.detail), "the built-in bust"
        case schema.Ball():
            return primitives.ball(spec.detail, part=spec.kind), f"built-in {spec.kind}"
        case schema.Ellipsoid():
            return primitives.ellipsoid(spec.semi_axes, spec.rotation, spec.detail), "built-in ellipsoid"
        case schema.VGroove():
            return primitives.v_groove(spec.angle, spec.turn, spec.detail), f"built-in V-groove, {spec.angle:g}°"
        case schema.Bowl():
            return primitives.bowl(spec.opening, spec.detail), f"built-in bowl, {spec.opening:g}°"
        case schema.MeshFile():
            mesh = read_mesh(Path(spec.path), rotation_deg=spec.rotation, smooth_deg=spec.smooth)
            return mesh, f"mesh {spec.path}"
    raise TypeError(f"no builder for {type(spec).__name__}")


# ---- what stands around it -----------------------------------------------------------------------------------------


def _background(mesh: Mesh, view: View, material: int) -> Mesh:
    """A black plane behind the object, filling the picture."""
    reach_x, reach_y = view.width * view.pixel_size, view.height * view.pixel_size
    corner = np.array([-reach_x, -reach_y, mesh.vertices[:, 2].min()])
    plane = primitives.rectangle(corner, np.array([2 * reach_x, 0, 0]), np.array([0, 2 * reach_y, 0]), (1, 1))
    return primitives.with_material(plane, material)
