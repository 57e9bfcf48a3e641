"""From a RunConfig to the world it means: mesh, reflectances, lights and camera, as arrays."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from configs import schema
from configs.schema import RunConfig
from scenes import primitives
from scenes.bust import bust_mesh
from scenes.cameras import sensitivity
from scenes.lights import DistantLight, build_light
from scenes.mesh import Mesh
from scenes.spectra import reflectance
from scenes.surfaces import depth_mesh, read_depth_map, read_mesh, resample

MARGIN = 1.04  # automatic framing leaves this much air around the object
BLACK = 1  # material of a background: reflects nothing, and is no part of the object


@dataclass(frozen=True)
class View:
    """Where each pixel looks. Orthographic: pixel (row, col) looks along −z at its own x, y."""

    width: int
    height: int
    pixel_size: float  # side of a pixel on the object, scene units

    def pixel_xy(self, rows: np.ndarray, cols: np.ndarray) -> np.ndarray:
        """Position (…, 2) in scene units of points given in pixels; (0, 0) is the top left corner of the picture."""
        x = (cols - self.width / 2) * self.pixel_size
        y = (self.height / 2 - rows) * self.pixel_size
        return np.stack([x, y], axis=-1)


@dataclass(frozen=True)
class Scene:
    """All that the renderer needs to know. Camera frame throughout."""

    mesh: Mesh
    reflectances: np.ndarray  # (M, W), of each material
    is_object: np.ndarray  # (M,) bool: pixels of this material make the mask
    lights: tuple[DistantLight, ...]
    view: View
    sensitivity: np.ndarray  # (W, 3)
    pixel_vertex: (
        np.ndarray | None
    )  # (H, W) int32: where the mesh has a vertex at every pixel centre, its number, else −1
    area_pixels: bool  # shade over the pixel's area, not at its centre
    shape_label: str  # for the log: which shape this is


def build_scene(config: RunConfig) -> Scene:
    """The world of ``config``. Raises InputError for files and names that do not hold."""
    mesh, view, pixel_vertex, label = _build_shape(config)
    surface = reflectance(config.surface.reflectance, where="surface.reflectance")
    has_background = bool((mesh.material == BLACK).any())
    return Scene(
        mesh=mesh,
        reflectances=np.stack([surface, np.zeros_like(surface)]) if has_background else surface[None],
        is_object=np.array([True, False]) if has_background else np.array([True]),
        lights=tuple(build_light(light, i) for i, light in enumerate(config.lights)),
        view=view,
        sensitivity=sensitivity(config.camera.sensitivity),
        pixel_vertex=pixel_vertex,
        area_pixels=config.camera.pixel == "area",
        shape_label=label,
    )


def _build_shape(config: RunConfig) -> tuple[Mesh, View, np.ndarray | None, str]:
    spec = config.shape
    width, height = config.camera.resolution
    if isinstance(spec, schema.DepthMap):
        grid = read_depth_map(Path(spec.path), depth_scale=spec.depth_scale, toward_camera=spec.toward_camera)
        rows, cols = grid.depth.shape
        wanted = config.camera.view_height
        pixels_per_step = min(height / rows, width / cols) if wanted == "auto" else height / wanted
        sampled = resample(grid, (height, width), pixels_per_step)
        mesh, vertex = depth_mesh(sampled, 1.0 / pixels_per_step)
        return mesh, View(width, height, 1.0 / pixels_per_step), vertex, f"depth map {spec.path}"
    mesh, label = _build_mesh(spec)
    view = _frame(mesh, config.camera)
    if getattr(spec, "background", False):
        mesh = primitives.join([mesh, _background(mesh, view)])
    return mesh, view, None, label


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


def _frame(mesh: Mesh, camera: schema.Camera) -> View:
    width, height = camera.resolution
    if camera.view_height == "auto":
        reach = np.abs(mesh.vertices[:, :2]).max(axis=0)
        view_height = 2 * MARGIN * max(reach[1], reach[0] * height / width)
    else:
        view_height = camera.view_height
    return View(width, height, view_height / height)


def _background(mesh: Mesh, view: View) -> Mesh:
    """A black plane behind the object, filling the picture."""
    reach_x, reach_y = view.width * view.pixel_size, view.height * view.pixel_size
    z = mesh.vertices[:, 2].min()
    corner = np.array([-reach_x, -reach_y, z])
    plane = primitives.rectangle(corner, np.array([2 * reach_x, 0, 0]), np.array([0, 2 * reach_y, 0]), (1, 1))
    return primitives.with_material(plane, BLACK)
