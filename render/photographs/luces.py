"""Reads a folder of the LUCES data set: 52 near lights, a camera in perspective, normals as a picture.

R. Mecca, F. Logothetis, I. Budvytis, R. Cipolla, "LUCES: A dataset for near-field point light source photometric
stereo", BMVC 2021. The second line of led_params.txt is: number of pictures, rows, columns, focal length and optical
axis (column, row) in pixels, mean distance in mm; each further line a light: position in mm and axis in the frame of
the camera (x right, y down, z away from it), intensity (one number, or red, green, blue), anisotropy, 0. The pictures
are 01.png …; normals.png encodes (n + 1) / 2, x right, y up, z toward the camera.

The lights are near: the direction of a light is taken at the mean distance on the optical axis, and the pictures keep
the fall-off of the light over the object, which a method that expects distant lights has to bear.
"""

from functools import partial
from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.render.photographs import files
from huesphere.render.photographs.diligent import unit_rows
from huesphere.render.photographs.photograph_set import StoredSet

PARAMETERS = "led_params.txt"
IN_OUR_FRAME = np.array([1.0, -1.0, -1.0])  # from x right, y down, z away


def read_luces(folder: Path, encoding: str) -> StoredSet:
    """The set in ``folder``. Raises InputError."""
    path = folder / PARAMETERS
    lines = [line.split() for line in files.text(path).splitlines() if line.strip()]
    try:
        count, _, _, focal, column, row, distance = (float(word) for word in lines[1])
        lights = [[float(word) for word in line] for line in lines[2:]]
    except (IndexError, ValueError):
        raise InputError(
            "led_params.txt", expected="a header, a line of seven numbers, a line for each light", where=path
        ) from None
    if len(lights) != int(count) or any(len(light) not in (8, 9, 10, 11) for light in lights):
        raise InputError(
            "lines of lights", got=str(len(lights)), expected=f"{int(count)} of 8 to 11 numbers", where=path
        )
    if not (focal > 0 and distance > 0):
        raise InputError("focal length and mean distance", got=f"{focal}, {distance}", expected="above 0", where=path)
    intensities = np.array([light[6:9] if len(light) >= 10 else [light[6]] * 3 for light in lights])
    if intensities.min() <= 0:
        raise InputError("an intensity of 0 or less", where=path)
    toward = (np.array([light[:3] for light in lights]) - [0.0, 0.0, distance]) * IN_OUR_FRAME
    pictures = [folder / f"{number + 1:02d}.png" for number in range(len(lights))]
    inside = files.mask(folder / "mask.png")
    normals_path = folder / "normals.png"
    normals = files.normals_of_picture(normals_path) if normals_path.exists() else None
    if normals is not None and normals.shape[:2] != inside.shape:
        raise InputError("normals of another size than the mask", where=normals_path)
    inputs = [path, folder / "mask.png", *([normals_path] if normals is not None else []), *pictures]
    return StoredSet(
        "luces",
        unit_rows(toward, path),
        inside,
        None if normals is None else _at_length_1(normals),
        tuple(inputs),
        partial(_read, pictures, intensities, encoding),
        focal,
        (column, row),
    )


def _at_length_1(normals: np.ndarray) -> np.ndarray:
    """``normals`` (H, W, 3) at length 1, which 8 or 16 bits round; 0 where there is none."""
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.where(length > 0.5, normals / np.where(length > 0.5, length, 1.0), 0.0)


def _read(pictures: list[Path], intensities: np.ndarray, encoding: str, number: int) -> tuple[np.ndarray, np.ndarray]:
    return files.photograph(pictures[number], intensities[number], encoding)
