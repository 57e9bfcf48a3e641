"""A calibrated rig for loops: normals and depth of each frame, with everything that does not change computed once."""

from pathlib import Path
from typing import Any

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.recover.rig.markers import dark_spots
from huesphere.recover.rig.model import RigModel, read_rig
from huesphere.recover.rig.normals import RigNormals, normals_of
from huesphere.recover.rig.poisson import depth_of_slopes
from huesphere.scenes.encoding import decode_srgb

DARKEST = 1e-3  # of full scale: least light of a reference picture, and of a pixel that has a normal
FLATTEST = 0.05  # least n3 that a slope is taken from


class Rig:
    """A calibrated rig: ``Rig.load("rig.json", reference)``, then ``normals(frame)`` and ``depth(frame)`` in a loop.

    Frames are (H, W, 3): uint8 in the encoding of the calibration's pictures, or floats of linear light. The
    ``reference`` is such a frame of the empty rig, and needed where the calibration divided by one.

    >>> from huesphere.recover.rig.model import RigModel
    >>> F = np.array([[[0.5, 0.0, 0.6], [-0.25, 0.43, 0.6], [-0.25, -0.43, 0.6]]])
    >>> rig = Rig(RigModel(F, (8, 6), False, 1.0, (1.0, 0.0), 0.0, 0.1, False, "linear", "2000-01-01"))
    >>> frame = np.broadcast_to(F[0] @ [0.0, 0.6, 0.8], (6, 8, 3))
    >>> np.round(rig.normals(frame)[0, 0].astype(float), 3).tolist()
    [0.0, 0.6, 0.8]
    >>> bool(np.allclose(np.diff(rig.depth(frame), axis=0), 0.75, atol=1e-4))
    True
    """

    def __init__(self, model: RigModel, reference: Any = None) -> None:
        """Raises InputError for a reference that is missing, not wanted, or of another size."""
        self.model = model
        self._decoded = decode_srgb(np.arange(256) / 255) if model.encoding == "srgb" else np.arange(256) / 255
        self._decoded = self._decoded.astype(np.float32)
        if model.divided and reference is None:
            raise InputError("a rig that divides by a reference", got="none", expected="a picture of the empty rig")
        if reference is not None and not model.divided:
            got, expected = "a reference picture", "none: the rig was calibrated without one"
            raise InputError("a rig that does not divide by a reference", got=got, expected=expected)
        self._gain: np.ndarray | None = None
        self._marked: np.ndarray | None = None
        if reference is not None:
            light = self._light(reference, "reference")
            self._gain = 1 / np.maximum(light, np.float32(DARKEST))
            self._marked = dark_spots(light) if model.markers else None
        self.inverse = np.ascontiguousarray(np.moveaxis(np.linalg.inv(model.matrices()), (2, 3), (0, 1)), np.float32)

    @classmethod
    def load(cls, path: str | Path, reference: Any = None) -> "Rig":
        """The rig of a file rig.json. Raises InputError."""
        return cls(read_rig(Path(path)), reference)

    @property
    def mm_per_px(self) -> float | None:
        """Millimetres a pixel; None if no ball of known size was photographed."""
        return self.model.mm_per_px

    def normals(self, frame: Any) -> np.ndarray:
        """Unit normals (H, W, 3) float32, camera frame, of a frame; markers are interpolated. Raises InputError."""
        return self.found(frame)[0].normals

    def depth(self, frame: Any) -> np.ndarray:
        """Depth (H, W) float32 in pixels toward the camera, mean 0, of a frame. Raises InputError."""
        return depth_of_normals(self.normals(frame))

    def found(self, frame: Any) -> tuple[RigNormals, np.ndarray, np.ndarray]:
        """(normals, pixels (H, W) whose colour gave one, ρ (H, W, 3)) of a frame. Raises InputError."""
        light = self._light(frame, "frame")
        known = np.maximum(np.maximum(light[..., 0], light[..., 1]), light[..., 2]) > DARKEST
        if self._marked is not None:
            known &= ~(self._marked | dark_spots(light))
        rho = light if self._gain is None else light * self._gain
        return normals_of(rho, self.inverse, known), known, rho

    def _light(self, frame: Any, name: str) -> np.ndarray:
        """Linear light (H, W, 3) float32 of a frame. Raises InputError."""
        frame = np.asarray(frame)
        width, height = self.model.size
        if frame.shape != (height, width, 3):
            got = f"{frame.shape[1]}×{frame.shape[0]} pixels" if frame.ndim == 3 else f"an array of shape {frame.shape}"
            raise InputError(
                f"a {name} of another size than the rig's", got=got, expected=f"{width}×{height} in colour"
            )
        if frame.dtype == np.uint8:
            return np.take(self._decoded, frame)
        if frame.dtype.kind != "f":
            raise InputError(f"a {name}", got=f"samples of {frame.dtype}", expected="uint8, or floats of linear light")
        return np.nan_to_num(frame.astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)


def depth_of_normals(normals: np.ndarray) -> np.ndarray:
    """Depth (H, W) in pixels, mean 0, of normals (H, W, 3) that are known everywhere."""
    n3 = np.maximum(normals[..., 2], np.float32(FLATTEST))
    return depth_of_slopes(-normals[..., 0] / n3, -normals[..., 1] / n3)
