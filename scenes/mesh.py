"""The triangle mesh, which the shapes of all kinds are turned into for the renderer."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Mesh:
    """Triangles with smooth normals at their vertices. At a crease each side has vertices of its own.

    Camera frame (x right, y up, z toward the camera), scene units. The corners of a face are counter-clockwise as seen
    from outside.
    """

    vertices: np.ndarray  # (V, 3) float64
    faces: np.ndarray  # (F, 3) int32
    normals: np.ndarray  # (V, 3) float64, unit, outward: those of the smooth surface, not of the facets
    material: np.ndarray  # (F,) int32, index of the face's reflectance
    # What a file or a grid gives at vertices for maps of reflectance; None if it gives none, or no map needs it.
    uv: np.ndarray | None = None  # (V, 2) texture coordinates, v = 1 at the top of the picture
    colour: np.ndarray | None = None  # (V, 3) linear R, G, B, full scale 1


def area_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The outward normal (F, 3) of each of the ``faces`` (F, 3), as long as twice its area; ``vertices`` (V, 3)."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)
