"""A surface seen in perspective, described by a relief over the picture: methods for parallel rays then apply to it.

A pixel at (x, y), in pixels from the principal point, sees the surface at the point t (x/f, y/f, −1), where t is the
distance from the camera along its axis and f the focal length. The *relief* Z = −f log t is a height over the picture.
Its slopes are Z_x = −n1 / (n·v) and Z_y = −n2 / (n·v), where n is the surface's normal and v = (−x/f, −y/f, 1) points
toward the camera. These are the slopes of a surface with the normal m = (n1, n2, n·v) under parallel rays. So m takes
the place of n wherever slopes are computed, exactly and without approximation; for a distant camera m tends to n, and Z
to the depth up to a constant. The convex/concave twin diag(−1, −1, 1) n is not integrable here where n is, because
n·v and so m change with it.

In the code a ray is (x/f, y/f), and None stands for parallel rays. Frame: camera, x right, y up, z toward the camera,
in pixels.
"""

import numpy as np

from huesphere.render.dataset import CameraInfo


def rays(camera: CameraInfo, shape: tuple[int, ...]) -> np.ndarray | None:
    """(x/f, y/f) (H, W, 2) of each pixel's centre; None for an orthographic camera, or one of unknown focal length."""
    if camera.projection == "orthographic" or not camera.focal_px:
        return None
    height, width = shape[:2]
    row, column = np.indices((height, width)) + 0.5
    return np.stack([column - width / 2, height / 2 - row], axis=-1) / camera.focal_px


def of_relief(n: np.ndarray, ray: np.ndarray | None) -> np.ndarray:
    """Normals m (…, 3) of the relief, not unit, from the surface's normals ``n`` (…, 3); m3 > 0 where it is visible."""
    if ray is None:
        return n
    m3 = facing_camera(n, ray)[..., None]
    return np.concatenate([np.broadcast_to(n[..., :2], (*m3.shape[:-1], 2)), m3], axis=-1)


def of_surface(m: np.ndarray, ray: np.ndarray | None) -> np.ndarray:
    """Unit normals n (…, 3) of the surface from normals ``m`` (…, 3) of the relief; ``m`` where rays are parallel."""
    if ray is None:
        return m
    n = np.concatenate([m[..., :2], m[..., 2:] + (ray * m[..., :2]).sum(axis=-1, keepdims=True)], axis=-1)
    return n / np.linalg.norm(n, axis=-1, keepdims=True)  # type: ignore[no-any-return]


def facing_camera(n: np.ndarray, ray: np.ndarray | None) -> np.ndarray:
    """n·v (…): positive where the surface of normal ``n`` (…, 3) is visible."""
    return n[..., 2] if ray is None else n[..., 2] - (ray * n[..., :2]).sum(axis=-1)  # type: ignore[no-any-return]


def depth_of(Z: np.ndarray, focal_px: float | None) -> np.ndarray:
    """Depth f − t (H, W), growing toward the camera, of the relief Z (H, W) = −f log(t/f); Z itself for parallel rays.

    Units are pixels, one being the side of a pixel on the object where the depth is 0. A picture does not determine the
    distance of the object, so Z = 0 is placed at the distance f, which is depth 0. The point that the pixel (x, y) sees
    is ((1 − depth/f) x, (1 − depth/f) y, depth). ``focal_px``: f in pixels, None for parallel rays.
    """
    return Z if focal_px is None else -focal_px * np.expm1(-Z / focal_px)


def height_of(Z: np.ndarray, focal_px: float | None) -> np.ndarray:
    """Height f²/t − f (H, W), pixels, of the relief Z (H, W), for finding cast shadows; Z itself for parallel rays.

    The map of space from a point to (x, y, f²/t) takes straight lines to straight lines. So one point of the surface
    hides another from a light exactly if the same is true on this height field over the picture.
    """
    return Z if focal_px is None else focal_px * np.expm1(Z / focal_px)
