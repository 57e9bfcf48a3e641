"""Reads an object of psmImages, the photographs of a course on computer vision that many programs are shown with.

S. Seitz, photometric stereo project, University of Washington. For an object such as ``gray``: gray.0.tga … of 8 bits
(or .png), gray.mask.tga, and lights.txt, in the folder or the one above it: the number of lights, then a line of three
numbers for each, x right, y up, z toward the camera. Without lights.txt the directions are not known. No normals are
published: for the balls ``gray`` and ``chrome`` they follow from the outline (shape.normals=sphere).
"""

import re
from functools import partial
from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.render.photographs import files
from huesphere.render.photographs.diligent import unit_rows
from huesphere.render.photographs.photograph_set import StoredSet

ENDINGS = "(?:tga|png|bmp|tiff?)"


def read_psm_images(folder: Path, name: str | None, encoding: str) -> StoredSet:
    """The set of the object ``name``, by default that of the folder's own name or the only one. Raises InputError."""
    name = name or _only_object(folder)
    pictures = files.numbered(folder, rf"{re.escape(name)}\.(\d{{1,4}})\.{ENDINGS}")
    if not pictures:
        raise InputError("no photographs", expected=f"{name}.0.tga, {name}.1.tga … or .png", where=folder)
    masks = [entry for entry in sorted(folder.iterdir()) if _is_mask(entry, name)]
    if not masks:
        raise InputError("no mask", expected=f"{name}.mask.tga or .png", where=folder)
    lights = next((p for p in (folder / "lights.txt", folder.parent / "lights.txt") if p.is_file()), None)
    directions = np.full((len(pictures), 3), np.nan)
    if lights is not None:
        directions = unit_rows(files.table(lights, 3, skip=1), lights)
        if len(directions) != len(pictures):
            got = f"{len(directions)} directions"
            raise InputError("a direction for each photograph", got=got, expected=str(len(pictures)), where=lights)
    inputs = [masks[0], *([lights] if lights else []), *pictures]
    read = partial(_read, pictures, encoding)
    return StoredSet("psm", directions, files.mask(masks[0]), None, tuple(inputs), read)


def _read(pictures: list[Path], encoding: str, number: int) -> tuple[np.ndarray, np.ndarray]:
    return files.photograph(pictures[number], np.ones(3), encoding)


def _is_mask(entry: Path, name: str) -> bool:
    stem, _, ending = entry.name.rpartition(".")
    return stem.lower() == f"{name}.mask".lower() and ending.lower() in ("tga", "png", "bmp", "tif", "tiff")


def objects_in(folder: Path) -> list[str]:
    """Names of the objects that have a mask in ``folder``."""
    stems = (entry.name.rpartition(".")[0] for entry in folder.iterdir() if entry.is_file())
    return sorted({stem.removesuffix(".mask") for stem in stems if stem.endswith(".mask") and stem != ".mask"})


def _only_object(folder: Path) -> str:
    """The object of the folder's own name, or the only one in it. Raises InputError."""
    known = objects_in(folder)
    if folder.name in known:
        return folder.name
    if len(known) != 1:
        raise InputError("shape.object: which one", got="none", expected=f"one of {', '.join(known)}", where=folder)
    return known[0]
