"""Wavefront OBJ: vertices and polygons of all its objects and groups. Its materials and normals are not used."""

from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.scenes.meshes.polygons import Polygons


def read_obj(path: Path) -> Polygons:
    """The polygons of an OBJ file. Raises InputError for a line that cannot be read.

    An index counts the file's vertices from 1. A negative one counts backwards from the line where it stands: −1 is the
    last vertex before it.
    """
    vertices: list[list[float]] = []
    corners: list[int] = []
    counts: list[int] = []
    text = path.read_text(encoding="utf-8", errors="replace").replace("\\\r\n", " ").replace("\\\n", " ")
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split("#", 1)[0].split()
        if not words or words[0] not in ("v", "f"):
            continue
        try:
            if words[0] == "v":
                x, y, z = words[1:4]
                vertices.append([float(x), float(y), float(z)])
                continue
            face = [int(word.split("/", 1)[0]) for word in words[1:]]
        except ValueError:
            raise InputError("not a readable mesh", got=line[:60], where=f"{path}:{number}") from None
        if 0 in face or min(face, default=1) < -len(vertices):
            raise InputError("a face of vertices that are not there", got=line[:60], where=f"{path}:{number}")
        corners += [index - 1 if index > 0 else len(vertices) + index for index in face]
        counts.append(len(face))
    return Polygons(np.array(vertices, float).reshape(-1, 3), np.array(corners, np.int64), np.array(counts, np.int64))
