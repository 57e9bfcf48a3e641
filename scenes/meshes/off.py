"""OFF files in text: vertices, then polygons as their number of corners and the corners, counted from 0."""

from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.scenes.meshes.polygons import Polygons


def read_off(path: Path) -> Polygons:
    """The polygons of an OFF file; normals and colours of COFF, NOFF and the like are not used. Raises InputError."""
    lines = [line.split("#", 1)[0].split() for line in path.read_text(encoding="utf-8", errors="replace").splitlines()]
    lines = [words for words in lines if words]
    head = lines[0][0].upper() if lines else ""
    if not head.endswith("OFF") or "4" in head or "N" in head.replace("NOFF", "OFF") or "BINARY" in lines[0]:
        raise InputError("not an OFF file in text", got=head[:20], where=path)
    lines[0] = lines[0][1:]
    if not lines[0]:
        del lines[0]
    try:
        vertex_count, face_count = (int(word) for word in lines[0][:2])
        points, faces = lines[1 : 1 + vertex_count], lines[1 + vertex_count : 1 + vertex_count + face_count]
        if min(vertex_count, face_count) < 0 or len(faces) < face_count:
            raise ValueError("fewer lines than its header says")
        # Of STOFF and the like only the first numbers of a line are the position.
        vertices = np.array([[float(word) for word in words[:3]] for words in points]).reshape(-1, 3)
        counts = np.array([int(words[0]) for words in faces], dtype=np.int64)
        rings = [[int(word) for word in words[1 : 1 + int(words[0])]] for words in faces]
        if [len(ring) for ring in rings] != counts.tolist():
            raise ValueError("a face with fewer corners than it says")
    except (ValueError, IndexError) as error:
        raise InputError("not a readable mesh", got=str(error)[:80], where=path) from None
    return Polygons(vertices, np.array([index for ring in rings for index in ring], dtype=np.int64), counts)
