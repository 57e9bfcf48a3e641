"""Crops, mirrors and turns samples, with all vectors of the camera frame: normals, lights, and the colour matrix.

A mirrored scene under mirrored lights gives the mirrored picture, and a turned one the turned picture, so these are
valid samples. With R the matrix of the mirroring or turning, normals and lights become R n, and F of colour = F n
becomes F Rᵀ. R leaves z as it is.
"""

from dataclasses import dataclass, replace

import numpy as np

from huesphere.eval.datasets.sample import Sample

POSITIONS = ("light_positions", "principal_point")  # vectors that start at the picture's middle


@dataclass(frozen=True)
class Symmetry:
    """First mirror left and right if ``mirrored``, then turn counter-clockwise by ``quarter_turns`` times 90°."""

    mirrored: bool = False
    quarter_turns: int = 0

    @property
    def matrix(self) -> np.ndarray:
        """R (3, 3), orthogonal, in the camera frame (x right, y up, z toward the camera)."""
        quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        mirror = np.diag([-1.0 if self.mirrored else 1.0, 1.0, 1.0])
        return np.linalg.matrix_power(quarter, self.quarter_turns % 4) @ mirror


def cropped(sample: Sample, top: int, left: int, size: tuple[int, int]) -> Sample:
    """The window of ``size`` (height, width) whose first pixel is (top, left), which lies within the picture.

    Positions are then from the middle of the window.
    """
    height, width = sample.images["mask"].shape
    across, up = left + size[1] / 2 - width / 2, height / 2 - top - size[0] / 2
    images = {name: image[top : top + size[0], left : left + size[1]] for name, image in sample.images.items()}
    moved = {
        name: sample.vectors[name] - np.array([across, up, 0], np.float32)
        for name in POSITIONS
        if name in sample.vectors
    }
    return replace(sample, images=images, vectors=sample.vectors | moved)


def transformed(sample: Sample, symmetry: Symmetry) -> Sample:
    """The sample mirrored and turned."""
    R = symmetry.matrix.astype(np.float32)

    def image(name: str, pixels: np.ndarray) -> np.ndarray:
        pixels = pixels[:, ::-1] if symmetry.mirrored else pixels
        pixels = np.rot90(pixels, symmetry.quarter_turns)
        return np.ascontiguousarray(pixels @ R.T if name == "normals" else pixels)

    return replace(
        sample,
        images={name: image(name, pixels) for name, pixels in sample.images.items()},
        vectors={name: vectors @ R.T for name, vectors in sample.vectors.items()},
    )
