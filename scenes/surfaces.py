"""Surfaces as meshes with smooth normals: depth on a grid, and triangles with creases."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from huesphere.scenes.mesh import Mesh, area_normals


@dataclass(frozen=True)
class DepthGrid:
    """Depth toward the camera on a square grid, in grid steps; row 0 at the top."""

    depth: np.ndarray  # (H, W) float64; off the mask a smooth continuation without meaning
    mask: np.ndarray  # (H, W) bool


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


def split_creases(
    vertices: np.ndarray,
    faces: np.ndarray,
    smooth_deg: float,
    uv: np.ndarray | None = None,
    colour: np.ndarray | None = None,
) -> Mesh:
    """A mesh whose normals are smooth across edges below the angle ``smooth_deg`` and not across sharper ones.

    Each corner of a face gets the mean normal, weighted by area, of those faces around its vertex whose normal is
    within ``smooth_deg`` of the face's own. A vertex whose corners get different normals is split; so is one whose
    corners have different texture coordinates ``uv`` (F, 3, 2) or colours ``colour`` (F, 3, 3), where they are given.
    """
    facets = area_normals(vertices, faces)
    unit = facets / np.maximum(np.linalg.norm(facets, axis=1, keepdims=True), 1e-300)
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
        corner_normals[corners] = np.einsum("vij,vjk->vik", alike, facets[around])
    length = np.linalg.norm(corner_normals, axis=1, keepdims=True)
    corner_normals = np.where(length > 0, corner_normals / np.maximum(length, 1e-300), np.repeat(unit, 3, axis=0))
    attributes = [None if a is None else a.reshape(len(corner_normals), -1) for a in (uv, colour)]
    parts = [corner_normals * 1e6, *(a * 1e6 for a in attributes if a is not None)]
    keys = np.concatenate([faces.reshape(-1, 1), *(np.round(part).astype(np.int64) for part in parts)], axis=1)
    _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    new_faces = inverse.reshape(-1, 3).astype(np.int32)
    return Mesh(
        vertices[faces.ravel()[first]],
        new_faces,
        corner_normals[first],
        np.zeros(len(faces), np.int32),
        *(None if a is None else a[first] for a in attributes),
    )
