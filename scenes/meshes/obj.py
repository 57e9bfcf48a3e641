"""Wavefront OBJ: vertices and polygons of all its objects and groups, texture coordinates and colours of vertices.

Its materials and normals are not used. Colours of vertices are three numbers after the coordinates, encoded as sRGB, as
programs write them that extend the format so.
"""

from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.scenes.encoding import decode_srgb
from huesphere.scenes.meshes.polygons import Polygons


def read_obj(path: Path) -> Polygons:
    """The polygons of an OBJ file. Raises InputError for a line that cannot be read.

    An index counts the file's vertices from 1. A negative one counts backwards from the line where it stands: −1 is the
    last vertex before it.
    """
    vertices: list[list[float]] = []
    places: list[list[float]] = []  # texture coordinates
    place_corners: list[int] = []  # −1: none
    colours: list[list[float]] = []
    corners: list[int] = []
    counts: list[int] = []
    text = path.read_text(encoding="utf-8", errors="replace").replace("\\\r\n", " ").replace("\\\n", " ")
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split("#", 1)[0].split()
        if not words or words[0] not in ("v", "vt", "f"):
            continue
        try:
            if words[0] == "v":
                x, y, z = words[1:4]
                vertices.append([float(x), float(y), float(z)])
                if len(words) >= 7:
                    colours.append([float(word) for word in words[4:7]])
                continue
            if words[0] == "vt":
                places.append([float(words[1]), float(words[2]) if len(words) > 2 else 0.0])
                continue
            parts = [word.split("/") for word in words[1:]]
            face = [int(part[0]) for part in parts]
            of_face = [int(part[1]) if len(part) > 1 and part[1] else 0 for part in parts]
        except (ValueError, IndexError):
            raise InputError("not a readable mesh", got=line[:60], where=f"{path}:{number}") from None
        if 0 in face or min(face, default=1) < -len(vertices):
            raise InputError("a face of vertices that are not there", got=line[:60], where=f"{path}:{number}")
        corners += [index - 1 if index > 0 else len(vertices) + index for index in face]
        place_corners += [index - 1 if index > 0 else len(places) + index if index < 0 else -1 for index in of_face]
        counts.append(len(face))
    at, uv = np.array(place_corners, np.int64), None
    if len(at) and at.min() >= 0 and at.max() < len(places):
        uv = np.array(places, float)[at]
    return Polygons(
        np.array(vertices, float).reshape(-1, 3),
        np.array(corners, np.int64),
        np.array(counts, np.int64),
        uv,
        decode_srgb(np.array(colours, float)) if colours and len(colours) == len(vertices) else None,
    )
