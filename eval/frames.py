"""Frames of normal maps: where the axes of a map of another program point, as seen by the camera.

A frame is written as three letters, the directions of its +x, +y and +z: R or L (right, left), U or D (up, down), B or
F (back toward the camera, forward into the scene). Ours is RUB. ``NAMED`` has the frames of programs by name.
"""

import itertools
from dataclasses import dataclass

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.suggest import suggested
from huesphere.eval.align import TWIN

_DIRECTIONS = {
    "R": (1.0, 0.0, 0.0),
    "L": (-1.0, 0.0, 0.0),
    "U": (0.0, 1.0, 0.0),
    "D": (0.0, -1.0, 0.0),
    "B": (0.0, 0.0, 1.0),
    "F": (0.0, 0.0, -1.0),
}
_WORDS = {
    "R": "right",
    "L": "left",
    "U": "up",
    "D": "down",
    "B": "toward the camera",
    "F": "away from the camera",
}
NAMED = {
    "opengl": "RUB",
    "diligent": "RUB",  # Normal_gt.mat of DiLiGenT
    "blender": "RUB",  # the camera's own frame
    "directx": "RDB",  # normal maps whose green channel is down
    "opencv": "RDF",
    "colmap": "RDF",
    "open3d": "RDF",
    "pytorch3d": "LUF",
    "unity": "RUF",
    "unreal": "FRU",
}
AUTO = "auto"  # the frame in which a map agrees best with the truth


@dataclass(frozen=True)
class Frame:
    """The frame of a normal map."""

    axes: str  # three letters, such as "RUB"
    name: str  # as the user calls it

    @property
    def matrix(self) -> np.ndarray:
        """(3, 3) orthogonal, from vectors in this frame to vectors in ours: its columns are the axes of the frame."""
        return np.array([_DIRECTIONS[letter] for letter in self.axes]).T

    @property
    def left_handed(self) -> bool:
        """Whether x × y = −z."""
        return bool(np.linalg.det(self.matrix) < 0)

    @property
    def description(self) -> str:
        """The directions of its axes in words, and that it is left-handed if it is."""
        axes = ", ".join(f"{axis} {_WORDS[letter]}" for axis, letter in zip("xyz", self.axes, strict=True))
        return f"{axes}{'; left-handed' if self.left_handed else ''}"

    def to_camera(self, vectors: np.ndarray) -> np.ndarray:
        """``vectors`` (..., 3) of this frame in ours."""
        return vectors @ self.matrix.T


def _all_frames() -> tuple[Frame, ...]:
    """All 48 frames whose axes are those of the camera in any order and direction; ours is the first."""
    first_name = {axes: name for name, axes in reversed(NAMED.items())}
    axes = [
        "".join(letters)
        for pairs in itertools.permutations(("RL", "UD", "BF"))
        for letters in itertools.product(*pairs)
    ]
    return tuple(Frame(one, first_name.get(one, one)) for one in axes)


FRAMES = _all_frames()
OURS = FRAMES[0]


def twin_of(frame: Frame) -> Frame:
    """The frame in which a map in ``frame`` would show the other solution (−x, −y, z): hollow instead of bulging."""
    turned = TWIN @ frame.matrix
    return next(one for one in FRAMES if np.array_equal(one.matrix, turned))


def parse_frame(text: str, *, where: object = "--frame") -> Frame | None:
    """The frame with this name or these three letters; None for ``auto``. Raises InputError for anything else."""
    word = text.strip()
    if word.lower() == AUTO:
        return None
    if word.lower() in NAMED:
        return Frame(NAMED[word.lower()], word.lower())
    for frame in FRAMES:
        if frame.axes == word.upper():
            return frame
    expected = suggested(word, (*NAMED, AUTO), f"{', '.join((AUTO, *NAMED))}, or three letters such as RDF")
    raise InputError("no such frame of normals", got=word, expected=expected, where=where)
