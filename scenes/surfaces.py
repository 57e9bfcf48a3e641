"""Shapes from files: depth maps on a grid, and triangle meshes."""

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import ndimage

from huesphere.configs.errors import InputError
from huesphere.configs.picture_size import require_size
from huesphere.configs.quiet import silence
from huesphere.scenes.mesh import Mesh
from huesphere.scenes.mesh_file import MOST_FACES, load_mesh
from huesphere.scenes.primitives import rotation_matrix


@dataclass(frozen=True)
class DepthGrid:
    """Depth toward the camera on a square grid, in grid steps; row 0 at the top."""

    depth: np.ndarray  # (H, W) float64; off the mask a smooth continuation without meaning
    mask: np.ndarray  # (H, W) bool


# ---- depth maps ----------------------------------------------------------------------------------------------------


def read_depth_map(path: Path, *, depth_scale: float = 1.0, toward_camera: bool = True) -> DepthGrid:
    """Read a depth map (H, W) from a file: depth toward the camera, in grid steps, row 0 at the top.

    Formats: npz (array ``depth``, optional array ``mask``), npy, EXR, PNG or TIFF of one channel (16-bit values are not
    reduced to 8 bits), or text with one row of numbers a line. ``depth_scale``: grid steps per stored unit.
    ``toward_camera``: whether the stored depth grows toward the camera; if not, its sign is changed. Samples that are
    not finite are background, and where the file holds no mask also those that are exactly 0. Raises InputError for a
    file that cannot be read, or that holds no depth map of plausible shape and size.
    """
    if not path.is_file():
        raise InputError("no such depth map", where=path)
    samples, mask = _read_samples(path)
    depth = _as_numbers(samples, path)
    if depth.ndim != 2 or min(depth.shape) < 2:
        raise InputError(
            "a depth map", got=f"an array of shape {depth.shape}", expected="two dimensions of 2 or more", where=path
        )
    if mask is None:
        mask = np.isfinite(depth) & (depth != 0)
    if mask.shape != depth.shape:
        raise InputError("mask and depth differ in shape", got=f"{mask.shape} and {depth.shape}", where=path)
    mask = mask & np.isfinite(depth)
    if mask.sum() < 16:
        raise InputError(
            "a depth map with too few valid samples", got=int(mask.sum()), expected="16 or more", where=path
        )
    depth = np.where(mask, depth, 0.0) * (depth_scale if toward_camera else -depth_scale)
    if np.abs(depth[mask]).max() > 1e6 * max(depth.shape):
        raise InputError(
            "depth in grid steps", got=f"{np.abs(depth[mask]).max():.3g}", expected="a sane size", where=path
        )
    return DepthGrid(_fill(depth, mask), mask)


def _read_samples(path: Path) -> tuple[np.ndarray, np.ndarray | None]:
    suffix = path.suffix.lower()
    try:
        require_size(path)
        if suffix == ".npz":
            with np.load(path, allow_pickle=False) as file:
                if "depth" not in file:
                    raise InputError("no array 'depth'", got=f"arrays {', '.join(file.files)}", where=path)
                return file["depth"], file["mask"].astype(bool) if "mask" in file else None
        if suffix == ".npy":
            return np.load(path, allow_pickle=False), None
        if suffix == ".exr":
            return _read_exr_depth(path)
        if suffix in (".png", ".tif", ".tiff"):
            return _read_picture_depth(path)
        text = path.read_text()
        if not text.strip():
            raise ValueError("an empty file")
        return np.loadtxt(text.replace(",", " ").splitlines(), ndmin=2), None
    except InputError:
        raise
    except (OSError, ValueError, EOFError, KeyError, SyntaxError) as error:
        raise InputError("not a readable depth map", got=f"{type(error).__name__}: {error}", where=path) from None
    except Exception as error:  # image and zip readers raise types of their own
        raise InputError("not a readable depth map", got=type(error).__name__, where=path) from None


def _as_numbers(samples: np.ndarray, path: Path) -> np.ndarray:
    if not isinstance(samples, np.ndarray) or samples.dtype.kind not in "fiub":
        got = samples.dtype if isinstance(samples, np.ndarray) else type(samples).__name__
        raise InputError("samples of a kind that is no depth", got=str(got), expected="real numbers", where=path)
    return samples.astype(float)


def _read_exr_depth(path: Path) -> tuple[np.ndarray, np.ndarray | None]:
    import OpenEXR

    with silence(), OpenEXR.File(str(path), separate_channels=True) as file:
        channels = {name: np.array(c.pixels, dtype=float) for name, c in file.channels().items()}
    name = next((n for n in ("depth.Z", "Z", "depth", "Y", "R") if n in channels), None)
    if name is None:
        raise InputError(
            "no depth channel", got=f"channels {', '.join(channels)}", expected="depth.Z, Z, Y or R", where=path
        )
    return channels[name], channels["mask"] > 0.5 if "mask" in channels else None


def _read_picture_depth(path: Path) -> tuple[np.ndarray, np.ndarray | None]:
    """(stored depth (H, W) float64, None: such files hold no mask) of a PNG or TIFF file with one channel."""
    import imageio.v3 as imageio

    # tifffile would log a file that it cannot read. Its exception becomes an InputError in _read_samples.
    logging.getLogger("tifffile").setLevel(logging.CRITICAL)
    image = imageio.imread(path, plugin="pillow" if path.suffix.lower() == ".png" else "tifffile")
    if image.ndim == 3:
        # Channels are not averaged to one: Pillow reduces 16-bit RGB to 8 bits without a warning.
        raise InputError("a depth picture has one channel", got=f"{image.shape[2]} channels", where=path)
    return image.astype(float), None


def _fill(depth: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """``depth`` (H, W) with each sample off the mask replaced by the nearest on it, so that resampling has no jump."""
    nearest = ndimage.distance_transform_edt(~mask, return_distances=False, return_indices=True)
    return depth[tuple(nearest)]


def resample(grid: DepthGrid, shape: tuple[int, int], pixels_per_step: float) -> DepthGrid:
    """The grid resampled to ``shape`` (H, W), with the same centre and ``pixels_per_step`` new samples for an old one.

    The unit of depth stays the spacing of the original grid. Cubic spline interpolation, after a Gaussian blur against
    aliasing if there are fewer samples than before.
    """
    height, width = shape
    if (height, width) == grid.depth.shape and pixels_per_step == 1.0:
        return grid
    depth = grid.depth
    if pixels_per_step < 1.0:
        depth = ndimage.gaussian_filter(depth, 0.5 * np.sqrt(pixels_per_step**-2 - 1.0))
    rows = (np.arange(height) + 0.5 - height / 2) / pixels_per_step + grid.depth.shape[0] / 2 - 0.5
    cols = (np.arange(width) + 0.5 - width / 2) / pixels_per_step + grid.depth.shape[1] / 2 - 0.5
    at = np.meshgrid(rows, cols, indexing="ij")
    new = ndimage.map_coordinates(depth, at, order=3, mode="nearest")
    share = ndimage.map_coordinates(grid.mask.astype(float), at, order=1, mode="constant", cval=0.0)
    return DepthGrid(new, share > 0.5)


def depth_normals(depth: np.ndarray, mask: np.ndarray, step: float = 1.0) -> np.ndarray:
    """Unit normals (H, W, 3), camera frame, of a depth grid (H, W): centred differences, one-sided at the border.

    ``step``: spacing of the grid in units of its depth.
    """
    z_x = _masked_difference(depth, mask, axis=1) / step
    z_y = -_masked_difference(depth, mask, axis=0) / step  # row 0 at the top, y up
    normals = np.stack([-z_x, -z_y, np.ones_like(z_x)], axis=-1)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def _masked_difference(depth: np.ndarray, mask: np.ndarray, axis: int) -> np.ndarray:
    """Derivative of ``depth`` (H, W) by the index along ``axis``, from neighbours within the mask; 0 without any."""
    depth = np.moveaxis(depth, axis, 0)
    inside = np.moveaxis(mask, axis, 0)
    ahead, behind = np.zeros_like(depth), np.zeros_like(depth)
    has_ahead, has_behind = np.zeros_like(inside), np.zeros_like(inside)
    ahead[:-1] = depth[1:] - depth[:-1]
    behind[1:] = ahead[:-1]
    has_ahead[:-1] = inside[1:] & inside[:-1]
    has_behind[1:] = has_ahead[:-1]
    count = has_ahead.astype(int) + has_behind
    total = np.where(has_ahead, ahead, 0.0) + np.where(has_behind, behind, 0.0)
    return np.moveaxis(np.where(count > 0, total / np.maximum(count, 1), 0.0), 0, axis)


def depth_mesh(grid: DepthGrid, step: float) -> tuple[Mesh, np.ndarray]:
    """(mesh, number of the vertex of each sample (H, W) int32, −1 off the mask) of a depth grid.

    The mesh has a vertex at every sample in the mask, in the camera frame, in units of the grid's depth, with the
    middle of the grid on the optical axis. ``step`` is the grid's spacing in the same unit. Each cell of four samples
    is two triangles, cut along the diagonal from top right to bottom left; a cell with three samples is one triangle.
    """
    height, width = grid.mask.shape
    vertex = np.full(grid.mask.shape, -1, dtype=np.int32)
    vertex[grid.mask] = np.arange(grid.mask.sum(), dtype=np.int32)
    rows, cols = np.nonzero(grid.mask)
    x = (cols + 0.5 - width / 2) * step
    y = (height / 2 - rows - 0.5) * step
    vertices = np.stack([x, y, grid.depth[grid.mask]], axis=1)
    top_left, top_right = vertex[:-1, :-1], vertex[:-1, 1:]
    bottom_left, bottom_right = vertex[1:, :-1], vertex[1:, 1:]
    # The four possible triangles of a cell, counter-clockwise as seen from the camera: two for each diagonal. Those
    # along the other diagonal, the last two, are used where a sample at an end of the first diagonal is missing.
    corners = [
        (top_left, bottom_left, top_right),
        (top_right, bottom_left, bottom_right),
        (top_left, bottom_left, bottom_right),
        (top_left, bottom_right, top_right),
    ]
    triangles = [np.stack([c.ravel() for c in triangle], axis=1) for triangle in corners]
    complete = (np.stack([t.ravel() for t in (top_left, top_right, bottom_left, bottom_right)]) >= 0).all(axis=0)
    valid = [(t >= 0).all(axis=1) for t in triangles]
    chosen = [valid[0], valid[1], valid[2] & ~complete, valid[3] & ~complete]
    faces = np.concatenate([t[c] for t, c in zip(triangles, chosen, strict=True)])
    normals = depth_normals(grid.depth, grid.mask, step)[grid.mask]
    return Mesh(vertices, faces.astype(np.int32), normals, np.zeros(len(faces), np.int32)), vertex


# ---- meshes --------------------------------------------------------------------------------------------------------


def read_mesh(path: Path, *, rotation_deg: tuple[float, float, float], smooth_deg: float) -> Mesh:
    """Read a mesh file of any format of trimesh, rotate it, and move and scale it to fit in [-1, 1]² in x and y.

    ``rotation_deg``: about x, then y, then z. Faces that meet at an angle below ``smooth_deg`` have a smooth normal at
    their common edge; sharper edges stay creases. Camera frame. Raises InputError for a file that is not a mesh.
    """
    import trimesh

    if not path.is_file():
        raise InputError("no such mesh", where=path)
    try:
        with silence():
            loaded = load_mesh(path)
    except InputError:
        raise
    except Exception as error:  # trimesh's readers raise whatever their formats provoke
        raise InputError("not a readable mesh", got=f"{type(error).__name__}: {str(error)[:80]}", where=path) from None
    if not isinstance(loaded, trimesh.Trimesh) or len(loaded.faces) == 0:
        raise InputError("a mesh without triangles", where=path)
    if len(loaded.faces) > MOST_FACES:
        raise InputError("too large a mesh", got=f"{len(loaded.faces):,} faces", expected=f"{MOST_FACES:,}", where=path)
    if np.shape(loaded.vertices)[1:] != (3,) or np.shape(loaded.faces)[1:] != (3,):
        raise InputError("a mesh that is not of triangles in space", where=path)
    if not np.isfinite(loaded.vertices).all():
        raise InputError("a mesh with vertices that are not finite numbers", where=path)
    if loaded.faces.min() < 0 or loaded.faces.max() >= len(loaded.vertices):
        raise InputError("a mesh with triangles of vertices that it does not have", where=path)
    vertices, faces = _framed(np.asarray(loaded.vertices, float), np.asarray(loaded.faces), rotation_deg, path)
    try:
        merged = trimesh.Trimesh(vertices, faces, process=False)
        merged.merge_vertices()  # by an absolute tolerance, so only once the size is known
        merged.update_faces(merged.nondegenerate_faces())
    except (ArithmeticError, ValueError, IndexError) as error:
        raise InputError("a mesh that is much deeper than wide", got=type(error).__name__, where=path) from None
    if len(merged.faces) == 0:
        raise InputError("a mesh with degenerate triangles only", where=path)
    return split_creases(np.asarray(merged.vertices), np.asarray(merged.faces), smooth_deg)


def _framed(
    vertices: np.ndarray, faces: np.ndarray, rotation_deg: tuple[float, float, float], path: Path
) -> tuple[np.ndarray, np.ndarray]:
    """(vertices, faces): the vertices that faces use, rotated, and moved and scaled into [-1, 1]² in x and y."""
    used, faces = np.unique(faces, return_inverse=True)
    with np.errstate(over="ignore", invalid="ignore"):
        turned = vertices[used] @ rotation_matrix(rotation_deg).T
        moved = turned - (turned.max(axis=0) / 2 + turned.min(axis=0) / 2)
        extent = np.abs(moved[:, :2]).max()
        if not extent > 0:
            raise InputError("a mesh seen edge on, of no width", where=path)
        framed = moved / extent
    if not np.isfinite(framed).all():
        raise InputError("a mesh whose size is not a finite number", where=path)
    return framed, faces.reshape(-1, 3)


def split_creases(vertices: np.ndarray, faces: np.ndarray, smooth_deg: float) -> Mesh:
    """A mesh whose normals are smooth across edges below the angle ``smooth_deg`` and not across sharper ones.

    Each corner of a face gets the mean normal, weighted by area, of those faces around its vertex whose normal is
    within ``smooth_deg`` of the face's own. A vertex whose corners get different normals is split.
    """
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area_normals = np.cross(b - a, c - a)
    unit = area_normals / np.maximum(np.linalg.norm(area_normals, axis=1, keepdims=True), 1e-300)
    order = np.argsort(faces.ravel(), kind="stable")
    corner_vertex = faces.ravel()[order]
    start = np.searchsorted(corner_vertex, np.arange(len(vertices) + 1))
    limit = np.cos(np.radians(smooth_deg))
    corner_normals = np.zeros((faces.size, 3))
    # Corners around one vertex are compared pair by pair, all vertices of equal valence at once.
    valence = np.diff(start)
    for count in np.unique(valence[valence > 0]):
        corners = order[start[:-1][valence == count][:, None] + np.arange(count)]
        around = corners // 3
        alike = np.einsum("vik,vjk->vij", unit[around], unit[around]) >= limit
        alike |= np.eye(count, dtype=bool)
        corner_normals[corners] = np.einsum("vij,vjk->vik", alike, area_normals[around])
    length = np.linalg.norm(corner_normals, axis=1, keepdims=True)
    corner_normals = np.where(length > 0, corner_normals / np.maximum(length, 1e-300), np.repeat(unit, 3, axis=0))
    keys = np.concatenate([faces.reshape(-1, 1), np.round(corner_normals * 1e6).astype(np.int64)], axis=1)
    _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    new_faces = inverse.reshape(-1, 3).astype(np.int32)
    return Mesh(vertices[faces.ravel()[first]], new_faces, corner_normals[first], np.zeros(len(faces), np.int32))
