"""Builds the scene that a RunConfig describes, as arrays: mesh, reflectances, lights, camera."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from huesphere.configs import schema
from huesphere.configs.errors import InputError
from huesphere.configs.schema import RunConfig
from huesphere.scenes import primitives
from huesphere.scenes.albedo.albedo import Albedo, build_albedo, reflectances_of
from huesphere.scenes.bust import bust_mesh
from huesphere.scenes.cameras import sensitivity
from huesphere.scenes.depth_maps.read import read_depth_map
from huesphere.scenes.extent import require_size
from huesphere.scenes.gel import gel_mesh, gel_view
from huesphere.scenes.lights.source import Light
from huesphere.scenes.lights.table import build_lights
from huesphere.scenes.mesh import Mesh
from huesphere.scenes.meshes.read import read_mesh
from huesphere.scenes.room import WALLS, Enclosure, build_enclosure
from huesphere.scenes.sculpture import sculpture
from huesphere.scenes.spectra import reflectance, table_ends
from huesphere.scenes.surfaces import DepthGrid, depth_mesh, resample
from huesphere.scenes.texture import paint_faces, paint_vertices
from huesphere.scenes.view import View, frame_mesh


@dataclass(frozen=True)
class Coat:
    """A rough dielectric layer over the matte base of the object."""

    roughness: float  # GGX alpha
    index: float  # refractive index


@dataclass(frozen=True)
class RoughMatte:
    """The base of the object as V-shaped facets: Oren & Nayar (1994)."""

    sigma_deg: float  # standard deviation of the slopes of the facets


@dataclass(frozen=True)
class Scene:
    """Everything that the renderer is given, in the camera frame (x right, y up, z toward the camera) and scene units.

    M materials, W wavelengths (``scenes.spectra.WAVELENGTHS``).
    """

    mesh: Mesh
    reflectances: np.ndarray  # (M, W) of each material
    is_object: np.ndarray  # (M,) bool: whether a material belongs to the object, whose pixels are the mask
    lights: tuple[Light, ...]
    view: View
    sensitivity: np.ndarray  # (W, 3) of the camera
    # (H, W) int32 number of the vertex at each pixel's centre, −1 without one; None if the mesh is not a depth map's
    pixel_vertex: np.ndarray | None
    area_pixels: bool  # whether shading is averaged over the pixel's area rather than taken at its centre
    coat: Coat | RoughMatte | None  # of the object's materials, where they are not Lambertian
    enclosure: Enclosure | None  # a room around the object; its walls are not in the mesh
    shape_label: str  # name of the shape for the log
    unit: str | None = None  # the length that a scene unit is, "mm"; None where the shape has no size of its own
    # Weights of the object's reflectances at each point of its surface, all faces of which have the material 0; None if
    # each face has the one reflectance of its material
    albedo: Albedo | None = None


Log = Callable[[str], None]
VERY_DEEP = 4.0  # times the picture's width or height: a depth map that is deeper is pointed out


def _nothing(_: str) -> None:
    return


def build_scene(config: RunConfig, log: Log = _nothing) -> Scene:
    """The scene of ``config``. Raises InputError for files that cannot be read and unknown names.

    ``log`` is called with lines for the user: what was guessed or mended in files, and the range of a depth map.
    """
    mesh, view, pixel_vertex, label = _build_shape(config, log)
    for line in table_ends(config):
        log(line)
    reflectances, is_object = scene_reflectances(config)
    if config.surface.checker is not None:
        paint = paint_vertices if config.surface.checker.by == "vertex" else paint_faces
        mesh = paint(mesh, config.surface.checker.size, material=1)
    albedo = build_albedo(config.surface, mesh, view)
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
        coat=_scattering(surface),
        enclosure=enclosure,
        shape_label=label,
        unit="mm" if isinstance(config.shape, schema.Gel) else None,
        albedo=albedo,
    )


def recoloured(scene: Scene, config: RunConfig) -> Scene:
    """``scene`` with the spectra of ``config``, whose geometry must be the same; the geometry is not built again."""
    return replace(
        scene,
        reflectances=scene_reflectances(config)[0],
        lights=build_lights(config.lights),
        sensitivity=sensitivity(config.camera.sensitivity),
    )


def scene_reflectances(config: RunConfig) -> tuple[np.ndarray, np.ndarray]:
    """(reflectances (M, W), whether each is the object's (M,)), in the order object, background, walls."""
    found = reflectances_of(config.surface)
    if isinstance(config.shape, schema.Gel) and config.shape.markers is not None:
        found.append(reflectance(config.shape.markers.reflectance, where="shape.markers.reflectance"))
    is_object = [True] * len(found)
    if getattr(config.shape, "background", False):
        found.append(np.zeros_like(found[0]))
        is_object.append(False)
    if config.room is not None:
        found += [reflectance(getattr(config.room, wall), where=f"room.{wall}") for wall in WALLS]
        is_object += [False] * len(WALLS)
    return np.stack(found), np.array(is_object)


def _scattering(surface: schema.Matte) -> Coat | RoughMatte | None:
    """How the object scatters light, if not as a Lambertian surface."""
    if isinstance(surface, schema.Coated):
        return Coat(surface.roughness, surface.index)
    return RoughMatte(surface.sigma) if isinstance(surface, schema.OrenNayar) else None


# ---- the object ----------------------------------------------------------------------------------------------------


def _build_shape(config: RunConfig, log: Log) -> tuple[Mesh, View, np.ndarray | None, str]:
    """(mesh, view, ``Scene.pixel_vertex``, ``Scene.shape_label``) of the config's shape."""
    spec, camera = config.shape, config.camera
    if not isinstance(spec, schema.DepthMap):
        mesh, label = _build_mesh(spec, config.surface, log)
        view = gel_view(mesh, camera) if isinstance(spec, schema.Gel) else frame_mesh(mesh, camera)
        if isinstance(spec, schema.MeshFile):
            require_size(mesh, view, spec.path, log)
        return mesh, view, None, label
    width, height = camera.resolution
    grid = read_depth_map(
        Path(spec.path),
        depth_scale=spec.depth_scale,
        toward_camera=spec.toward_camera,
        no_data=spec.no_data,
        channel=spec.channel,
        log=log,
    )
    rows, cols = grid.depth.shape
    wanted = camera.view_height
    pixels_per_step = min(height / rows, width / cols) if wanted == "auto" else height / wanted
    resampled = resample(grid, (height, width), pixels_per_step)
    if not resampled.mask.any():
        got = f"a grid of {cols} x {rows} samples, {pixels_per_step:.3g} pixels to a sample"
        expected = "samples of surface at the centres of pixels"
        raise InputError("no pixel meets the depth map", got=got, expected=expected, where=spec.path)
    _log_range(grid, resampled, pixels_per_step, (width, height), log)
    mesh, vertex = depth_mesh(resampled, 1.0 / pixels_per_step)
    mesh = replace(mesh, uv=mesh.vertices[:, :2] / [cols, rows] + 0.5)  # a picture lies on the whole map
    view = frame_mesh(mesh, camera, view_height=height / pixels_per_step)
    return mesh, view, vertex if camera.projection == "orthographic" else None, f"depth map {Path(spec.path).name}"


def _log_range(grid: DepthGrid, resampled: DepthGrid, pixels_per_step: float, size: tuple[int, int], log: Log) -> None:
    """Say how deep a depth map is, in its own unit and in pixels, and whether that is much for its width."""
    low, high = grid.depth[grid.mask].min(), grid.depth[grid.mask].max()
    in_pixels = f"{low * pixels_per_step:.4g} to {high * pixels_per_step:.4g} px"
    deep = (high - low) * pixels_per_step > VERY_DEEP * max(size)
    hint = "; much deeper than wide: shape.depth_scale, shape.no_data?" if deep else ""
    count = int(resampled.mask.sum())
    log(f"depth: {low:.4g} to {high:.4g} grid steps (scene units), {in_pixels}, over {count} pixels{hint}")


def _build_mesh(spec: schema.ShapeSpec, surface: schema.Matte, log: Log) -> tuple[Mesh, str]:
    """(mesh, label) of any shape but a depth map; of a file, with what the maps of ``surface`` may need."""
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
        case schema.Sculpture():
            mesh = sculpture(
                spec.seed,
                detail=spec.detail,
                size=spec.size,
                holes=spec.holes,
                relief=spec.relief,
                rotation_deg=spec.rotation,
            )
            return mesh, f"sculpture {spec.seed}"
        case schema.Gel():
            return gel_mesh(spec, log), "gel membrane, in mm"
        case schema.MeshFile():
            mesh = read_mesh(
                Path(spec.path),
                rotation_deg=spec.rotation,
                smooth_deg=spec.smooth,
                attributes=any(part is not None for part in (surface.texture, surface.mixture, surface.srgb)),
                log=log,
            )
            return mesh, f"mesh {Path(spec.path).name}"
    raise TypeError(f"no builder for {type(spec).__name__}")


# ---- the background ------------------------------------------------------------------------------------------------


def _background(mesh: Mesh, view: View, material: int) -> Mesh:
    """A plane of this material behind the object that fills the picture."""
    reach_x, reach_y = view.width * view.pixel_size, view.height * view.pixel_size
    corner = np.array([-reach_x, -reach_y, mesh.vertices[:, 2].min()])
    plane = primitives.rectangle(corner, np.array([2 * reach_x, 0, 0]), np.array([0, 2 * reach_y, 0]), (1, 1))
    return primitives.with_material(plane, material)
