"""The membrane of a camera-based tactile sensor, as its camera sees it through the clear pad: pressed by an object.

The camera looks at the back of a matte membrane; what is pressed into the pad bulges it toward the camera. Where the
object touches, the membrane has the object's height, up to a last, slight smoothing. Around the object the membrane
falls to its plane at rest: its height is smoothed repeatedly with a Gaussian, and after each smoothing raised to the
object's height wherever it is below it (D. F. Gomes, P. Paoletti, S. Luo, "Generation of GelSight tactile images for
sim2real learning", IEEE Robotics and Automation Letters 6, 2021). All lengths are millimetres; the membrane at rest is
the plane z = 0. The pad has the refractive index of the medium in front of it, so that rays are straight.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import ndimage
from scipy.interpolate import RegularGridInterpolator

from huesphere.configs import schema
from huesphere.configs.errors import InputError
from huesphere.scenes.depth_maps.read import read_depth_map
from huesphere.scenes.mesh import Mesh
from huesphere.scenes.surfaces import DepthGrid, depth_mesh
from huesphere.scenes.view import View, frame_mesh

SMOOTHINGS = (3.0, 2.0, 1.0, 0.5)  # standard deviations one after the other, in units of `softness`
LAST_SMOOTHING = 0.15  # of the whole surface: a membrane has no sharper edge, in units of `softness`
OFF_GRID = (0.382, 0.236)  # of a cell: a ray that meets an edge of the mesh may miss both of its faces
SHOWN = 0.96  # share of the membrane's height or width that the picture shows
FAR = -1e6  # mm, where there is no object

Heights = Callable[[np.ndarray, np.ndarray], np.ndarray]


def gel_mesh(spec: schema.Gel, log: Callable[[str], None]) -> Mesh:
    """The membrane of a config, with its markers as material 1. Raises InputError for a depth map that is none."""
    width, height = spec.size
    step = max(width, height) / spec.detail
    columns, rows = round(width / step), round(height / step)
    shift = np.array(OFF_GRID) * step
    x = (np.arange(columns) + 0.5 - columns / 2) * step + shift[0]
    y = (rows / 2 - 0.5 - np.arange(rows)) * step + shift[1]
    grid_x, grid_y = np.meshgrid(x, y)
    bulge = membrane(grid_x, grid_y, spec, step, log)
    mesh, _ = depth_mesh(DepthGrid(bulge, np.ones_like(bulge, dtype=bool)), step)
    mesh = replace(mesh, vertices=mesh.vertices + np.array([*shift, 0.0]))
    if spec.markers is None:
        return mesh
    centres = mesh.vertices[mesh.faces].mean(axis=1)[:, :2]
    off = centres - np.round(centres / spec.markers.spacing) * spec.markers.spacing
    marked = np.hypot(off[:, 0], off[:, 1]) < spec.markers.radius
    return replace(mesh, material=marked.astype(np.int32))


def gel_view(mesh: Mesh, camera: schema.Camera) -> View:
    """The view of the membrane at rest, so that the camera stands at one place whatever is pressed into the pad.

    Without a height of its own (``camera.view_height``) the picture shows the membrane but for its border.
    """
    at_rest = replace(mesh, vertices=mesh.vertices * [1, 1, 0])
    width, height = camera.resolution
    extent = np.ptp(mesh.vertices[:, :2], axis=0)
    view = frame_mesh(at_rest, camera, view_height=SHOWN * min(extent[1], extent[0] * height / width))
    return replace(view, front=max(view.front, float(mesh.vertices[:, 2].max()) + view.pixel_size))


def membrane(
    x: np.ndarray, y: np.ndarray, spec: schema.Gel, step: float, log: Callable[[str], None] = lambda _: None
) -> np.ndarray:
    """Height (H, W) of the membrane toward the camera at grid points x, y (H, W), ``step`` apart."""
    if spec.indenter == "none":
        return np.zeros_like(x)
    angle = np.radians(spec.turn)
    right, up = x - spec.position[0], y - spec.position[1]
    along = np.cos(angle) * right + np.sin(angle) * up
    across = np.cos(angle) * up - np.sin(angle) * right
    contact = np.maximum(spec.press + _indenter(spec, log)(along, across), 0.0)
    surface = contact
    for factor in SMOOTHINGS:
        surface = np.maximum(ndimage.gaussian_filter(surface, factor * spec.softness / step), contact)
    return np.asarray(ndimage.gaussian_filter(surface, LAST_SMOOTHING * spec.softness / step))


# ---- what is pressed into the pad ----------------------------------------------------------------------------------
# Heights (...,) toward the camera over coordinates along and across the object; 0 at the foremost point.


def _indenter(spec: schema.Gel, log: Callable[[str], None]) -> Heights:
    if isinstance(spec.indenter, schema.IndenterMap):
        return _from_file(spec.indenter, log)
    shapes: dict[str, Callable[[float], Heights]] = {"ball": _ball, "key": _key, "screw": _screw}
    return shapes[str(spec.indenter)](spec.diameter)


def _ball(diameter: float) -> Heights:
    radius = diameter / 2

    def heights(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        square = radius**2 - u**2 - v**2
        return np.where(square > 0, np.sqrt(np.maximum(square, 0)) - radius, FAR)

    return heights


def _screw(diameter: float) -> Heights:
    """A metric thread along u: flanks at 60°, crests of an eighth and roots of a quarter of the pitch (ISO 68-1)."""
    radius, pitch = diameter / 2, diameter / 5
    depth = 0.5413 * pitch

    def heights(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        around = np.arcsin(np.clip(v / radius, -1, 1)) / (2 * np.pi)
        from_crest = np.abs(2 * ((u / pitch - around) % 1.0) - 1)
        thread = radius - depth * (1 - np.clip((0.75 - from_crest) / 0.625, 0, 1))
        square = thread**2 - v**2
        return np.where(square > 0, np.sqrt(np.maximum(square, 0)) - radius, FAR)

    return heights


def _key(diameter: float) -> Heights:
    """A door key along u: a bow of ``diameter`` with a hole, a blade with groove and cuts; its edges are bevelled."""
    unit = diameter / 10

    def heights(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        u, v = u / unit, v / unit
        bow = np.hypot(u + 7, v) - 5
        hole = 1.5 - np.hypot(u + 9, v)
        cuts = 0.9 * np.clip(1.3 - np.abs((u - 1.5) % 2.4 - 1.2) * 1.6, 0, 1) * (1 + np.cos(2.1 * u)) / 2
        cuts = np.where((u > 1.5) & (u < 11.1), cuts, 0.0)
        blade = np.maximum.reduce([u - 13 + 0.7 * np.abs(v), -3 - u, v - 2.1, -v - 2.1 + cuts])
        outside = np.maximum(np.minimum(bow, blade), hole)
        groove = 0.5 * np.exp(-(((v - 0.7) / 0.45) ** 4)) * (u > -1)
        return np.asarray(unit * (-np.maximum(outside + 0.4, 0) * 1.5 - groove))

    return heights


def _from_file(spec: schema.IndenterMap, log: Callable[[str], None]) -> Heights:
    """A depth map whose grid is ``width`` millimetres wide."""
    grid = read_depth_map(Path(spec.path), log=log)
    step = spec.width / grid.depth.shape[1]
    if not grid.mask.any():
        raise InputError("a depth map without a surface", where=spec.path)
    depth = np.where(grid.mask, (grid.depth - grid.depth[grid.mask].max()) * step, FAR)
    rows, columns = depth.shape
    v, u = (np.arange(rows) + 0.5 - rows / 2) * step, (np.arange(columns) + 0.5 - columns / 2) * step
    at = RegularGridInterpolator((v, u), depth[::-1], bounds_error=False, fill_value=FAR)

    def heights(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.asarray(at(np.stack([v, u], axis=-1)))

    return heights
