"""Reads a folder of the DiLiGenT benchmark, or one that `evaluate --export diligent` wrote.

B. Shi et al., "A benchmark dataset and evaluation for non-Lambertian and uncalibrated photometric stereo", CVPR 2016
and IEEE TPAMI 41(2), 2019. For each light a 16-bit linear picture; filenames.txt lists them, light_directions.txt and
light_intensities.txt have a line of three numbers for each, in the camera frame (x right, y up, z toward the camera).
"""

from functools import partial
from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.render.photographs import files
from huesphere.render.photographs.photograph_set import StoredSet

NAMES, DIRECTIONS, INTENSITIES = "filenames.txt", "light_directions.txt", "light_intensities.txt"


def read_diligent(folder: Path, encoding: str) -> StoredSet:
    """The set in ``folder``. The normals are those of Normal_gt.mat, or of normal.txt without it. Raises InputError."""
    pictures = [folder / name for name in files.names(folder / NAMES)]
    directions = files.table(folder / DIRECTIONS, 3)
    intensities = files.table(folder / INTENSITIES, 3)
    for found, name in ((directions, DIRECTIONS), (intensities, INTENSITIES)):
        if len(found) != len(pictures):
            got = f"{len(found)} lines"
            raise InputError("a line for each picture", got=got, expected=str(len(pictures)), where=folder / name)
    if intensities.min() <= 0:
        raise InputError("an intensity of 0 or less", where=folder / INTENSITIES)
    inside = files.mask(folder / "mask.png")
    normals, path = _normals(folder, inside.shape)
    inputs = [*(folder / n for n in (NAMES, DIRECTIONS, INTENSITIES, "mask.png")), *([path] if path else []), *pictures]
    return StoredSet(
        "diligent",
        unit_rows(directions, folder / DIRECTIONS),
        inside,
        normals,
        tuple(inputs),
        partial(_read, pictures, intensities, encoding),
    )


def _read(pictures: list[Path], intensities: np.ndarray, encoding: str, number: int) -> tuple[np.ndarray, np.ndarray]:
    return files.photograph(pictures[number], intensities[number], encoding)


def _normals(folder: Path, shape: tuple[int, ...]) -> tuple[np.ndarray | None, Path | None]:
    height, width = shape[:2]
    matlab, text = folder / "Normal_gt.mat", folder / "normal.txt"
    if matlab.exists():
        return files.normals_of_mat(matlab, (height, width)), matlab
    if text.exists():
        rows = files.table(text, 3)
        if len(rows) != height * width:
            raise InputError("normals", got=f"{len(rows)} lines", expected=str(height * width), where=text)
        return rows.reshape(height, width, 3), text
    return None, None


def unit_rows(directions: np.ndarray, path: Path) -> np.ndarray:
    """``directions`` (L, 3) at length 1. Raises InputError for one of length 0."""
    length = np.linalg.norm(directions, axis=1, keepdims=True)
    if length.min() < 1e-9:
        raise InputError("a direction of length 0", where=path)
    return np.asarray(directions / length)
