"""Rotations of the camera frame: from a vector, between two of them, and the convex/concave ambiguity.

``TWIN`` = diag(−1, −1, 1) turns a surface inside out: normals n and TWIN n are equally integrable in an orthographic
picture, so integrability alone cannot tell them apart (``recover.cues.convexity`` can).
"""

import numpy as np
from scipy.spatial.transform import Rotation

TWIN = np.diag([-1.0, -1.0, 1.0])


def rotation_by(vector: np.ndarray) -> np.ndarray:
    """The rotation matrix (3, 3) about ``vector`` (3,) by its length in radians."""
    return np.asarray(Rotation.from_rotvec(vector).as_matrix())


def rotation_angle(a: np.ndarray, b: np.ndarray) -> float:
    """Angle in radians, 0 … π, of the rotation a bᵀ between two orthogonal matrices (3, 3) of the same determinant."""
    return float(Rotation.from_matrix(a @ b.T).magnitude())


def turn_between(a: np.ndarray, b: np.ndarray) -> float:
    """Angle in radians between two orthogonal matrices (3, 3), ``TWIN`` b counting as b; π across a reflection.

    With the convex/concave ambiguity left open, this is how far two solutions for the rotation are apart.
    """
    if np.linalg.det(a) * np.linalg.det(b) < 0:
        return float(np.pi)
    return min(rotation_angle(a, b), rotation_angle(a, TWIN @ b))
