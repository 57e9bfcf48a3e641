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
    """Derivatives (P, 3, 2) of the unit normals by the slopes (P, 2) from which they are made, along rays (P, 2)."""
    n = normals_of_slopes(slope, ray)
    length = np.linalg.norm(np.column_stack([slope, 1 - (ray * slope).sum(axis=1)]), axis=1)
    m = np.concatenate([np.broadcast_to(-np.eye(2), (len(slope), 2, 2)), -ray[:, None, :]], axis=1)
    return (m - n[:, :, None] * np.einsum("pi,pij->pj", n, m)[:, None, :]) / length[:, None, None]  # type: ignore[no-any-return]


def slopes_by_rotation(slope: np.ndarray, ray: np.ndarray | None) -> np.ndarray:
    """Change (P, 2, 3) of slopes (P, 2) = (p, q) by a small rotation ω of the surface about the camera's axes, radians.

    The normal changes by δn = ω × n. Where rays are parallel (``ray`` None) δp = ω1 pq − ω2 (1 + p²) − ω3 q and
    δq = ω1 (1 + q²) − ω2 pq + ω3 p. Along the ray (x, y), ``ray`` (P, 2), the normal is as (−p, −q, s) with
    s = 1 − xp − yq, and what it is divided by to give the relief's slopes, n·v, changes too.
    """
    p, q = slope.T
    x, y = (0.0, 0.0) if ray is None else ray.T
    s = 1 - x * p - y * q
    across = q - y * s, x * s - p, x * q - y * p  # relative change of n·v, negated
    by_p = p * across[0], p * across[1] - s, p * across[2] - q
    by_q = q * across[0] + s, q * across[1], q * across[2] + p
    return np.stack([*by_p, *by_q], axis=-1).reshape(-1, 2, 3)


def centred_differences(image: np.ndarray, inside: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Derivatives of an ``image`` (H, W, …) by centred differences, per pixel, x to the right and y up.

    Returns ∂/∂x and ∂/∂y, shaped as the image, and ``where`` (H, W) bool: pixels that are ``inside`` (H, W) together
    with their four neighbours. Both derivatives are 0 elsewhere.
    """
    where = np.zeros_like(inside)
    core = inside[1:-1, 1:-1]
    where[1:-1, 1:-1] = core & inside[1:-1, 2:] & inside[1:-1, :-2] & inside[2:, 1:-1] & inside[:-2, 1:-1]
    dx, dy = np.zeros_like(image), np.zeros_like(image)
    dx[:, 1:-1] = (image[:, 2:] - image[:, :-2]) / 2
    dy[1:-1] = (image[:-2] - image[2:]) / 2
    dx[~where] = 0
    dy[~where] = 0
    return dx, dy, where
