"""Slopes of a surface: its normals, their derivatives, and centred differences on the pixel grid.

A slope is (z_x, z_y), depth toward the camera. In perspective it is that of the relief (``recover.geometry.rays``).
Frame: camera, x right, y up, z toward the camera, image row 0 at the top.
"""

import numpy as np

from huesphere.recover.geometry.rays import of_surface


def normals_of_slopes(slope: np.ndarray, ray: np.ndarray) -> np.ndarray:
    """Unit normals (P, 3) of slopes (P, 2) = (z_x, z_y) along rays (P, 2)."""
    return of_surface(np.stack([-slope[:, 0], -slope[:, 1], np.ones(len(slope))], axis=-1), ray)


def normals_by_slopes(slope: np.ndarray, ray: np.ndarray) -> np.ndarray:
    """Change (P, 3, 2) of the normal along rays (P, 2) by its slopes (P, 2)."""
    n = normals_of_slopes(slope, ray)
    length = np.linalg.norm(np.column_stack([slope, 1 - (ray * slope).sum(axis=1)]), axis=1)
    m = np.concatenate([np.broadcast_to(-np.eye(2), (len(slope), 2, 2)), -ray[:, None, :]], axis=1)
    return (m - n[:, :, None] * np.einsum("pi,pij->pj", n, m)[:, None, :]) / length[:, None, None]  # type: ignore[no-any-return]


def centred_differences(image: np.ndarray, inside: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(∂/∂x, ∂/∂y, where) of an image (H, W, …) by centred differences, y up, 0 where the stencil leaves ``inside``."""
    where = np.zeros_like(inside)
    core = inside[1:-1, 1:-1]
    where[1:-1, 1:-1] = core & inside[1:-1, 2:] & inside[1:-1, :-2] & inside[2:, 1:-1] & inside[:-2, 1:-1]
    dx, dy = np.zeros_like(image), np.zeros_like(image)
    dx[:, 1:-1] = (image[:, 2:] - image[:, :-2]) / 2
    dy[1:-1] = (image[:-2] - image[2:]) / 2
    dx[~where] = 0
    dy[~where] = 0
    return dx, dy, where
