"""The geometry of the camera, which is on the z axis and looks along −z: orthographic or perspective."""

from dataclasses import dataclass

import numpy as np

from huesphere.configs import schema
from huesphere.scenes.mesh import Mesh

MARGIN = 1.04  # height of the picture over that of the object, with automatic framing


@dataclass(frozen=True)
class View:
    """The camera's geometry. Row 0 is at the top; pixel centres are at half-integers, in pixels."""

    width: int
    height: int
    pixel_size: float  # side of a pixel on the object, scene units (perspective: at z = reference)
    front: float  # z at which orthographic rays start: in front of the object, inside a room if there is one
    eye: float | None = None  # perspective: z of the centre of projection; None: orthographic
    reference: float = 0.0  # perspective: the z at which the pixel size holds

    @property
    def focal_px(self) -> float | None:
        """Focal length in pixels; None for an orthographic camera."""
        return None if self.eye is None else (self.eye - self.reference) / self.pixel_size

    def rays(self, rows: np.ndarray, cols: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(origins, unit directions), (n, 3) each, of the rays through the points (rows, cols), (n,) each, in pixels.

        Camera frame, scene units.
        """
        x = (np.asarray(cols) - self.width / 2) * self.pixel_size
        y = (self.height / 2 - np.asarray(rows)) * self.pixel_size
        if self.eye is None:
            origins = np.stack([x, y, np.full_like(x, self.front)], axis=-1)
            return origins, np.broadcast_to(np.array([0.0, 0.0, -1.0]), origins.shape)
        directions = np.stack([x, y, np.full_like(x, self.reference - self.eye)], axis=-1)
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        return np.broadcast_to(np.array([0.0, 0.0, self.eye]), directions.shape), directions


def frame_mesh(mesh: Mesh, camera: schema.Camera, view_height: float | None = None) -> View:
    """The view of a config's ``camera`` that shows all of ``mesh``, or the height that the config or caller gives."""
    width, height = camera.resolution
    near = mesh.vertices[:, 2].max()
    if camera.view_height != "auto":
        view_height = camera.view_height
    if view_height is None:
        reach = np.abs(mesh.vertices[:, :2]).max(axis=0)
        view_height = 2 * MARGIN * max(reach[1], reach[0] * height / width)
    pixel_size = view_height / height
    if camera.projection == "orthographic":
        return View(width, height, pixel_size, front=near + pixel_size)
    # The height is measured in the plane through the object's foremost point, so that the object is not cut off.
    eye = near + view_height / 2 / np.tan(np.radians(camera.field_of_view) / 2)
    return View(width, height, pixel_size, front=near, eye=float(eye), reference=float(near))
