"""A surface seen in perspective, as a relief over the picture: for slopes and depth the camera may be anywhere.

A pixel at (x, y), in pixels from the principal point, sees the point t (x/f, y/f, −1) of the surface. Seen so, the
relief Z = −f log t over the picture has the slopes Z_x = −n1 / (n·v) and Z_y = −n2 / (n·v), v = (−x/f, −y/f, 1) toward
the camera: those of the orthographic normal m = (n1, n2, n·v). So m takes the place of n wherever a slope is meant, and
nothing is approximate; far from the camera m = n and Z is the depth. The convex/concave twin diag(−1, −1, 1) n is not
integrable as n is: m changes otherwise.

A ray is (x/f, y/f); None stands for parallel ones. Frame: camera, x right, y up, z toward the camera, in pixels.
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
    """Depth f − t of the relief Z (H, W), pixels toward the camera: a pixel is its side on the object at depth 0.

    No picture tells the scale: Z = 0 is taken to be f pixels from the camera. The point itself is
    ((1 − depth/f) x, (1 − depth/f) y, depth).
    """
    return Z if focal_px is None else -focal_px * np.expm1(-Z / focal_px)


def height_of(Z: np.ndarray, focal_px: float | None) -> np.ndarray:
    """f²/t − f (H, W) of the relief Z: the map (x, y, f²/t) of space takes straight lines of sight to straight lines.

    So what hides what on the surface is what does on the height field.
    """
    return Z if focal_px is None else focal_px * np.expm1(Z / focal_px)
