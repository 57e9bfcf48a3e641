"""A triangle mesh in the camera frame: the one form in which every shape reaches the renderer."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Mesh:
    """Triangles with smooth normals at their vertices. Creases have a vertex on each side, one per normal.

    Camera frame (x right, y up, z toward the camera), any unit of length; faces counter-clockwise from outside.
    """

    vertices: np.ndarray  # (V, 3) float64
    faces: np.ndarray  # (F, 3) int32
    normals: np.ndarray  # (V, 3) float64, unit, outward: the surface's own, not the facets'
    material: np.ndarray  # (F,) int32, index of the face's reflectance
