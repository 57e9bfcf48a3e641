"""Rotations of the camera frame: from a vector, between two of them, and the convex/concave ambiguity.

``TWIN`` = diag(−1, −1, 1) turns a surface inside out: normals n and TWIN n are equally integrable in an orthographic
picture, so integrability alone cannot tell them apart (``recover.cues.convexity`` can).
"""

import numpy as np


def rotation_by(vector: np.ndarray) -> np.ndarray:
    """The rotation (3, 3) about ``vector`` (3,) by its length in radians (Rodrigues)."""
    x, y, z = vector
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = float(np.linalg.norm(vector))
    if angle < 1e-8:
        return np.eye(3) + K
    return np.eye(3) + np.sin(angle) / angle * K + (1 - np.cos(angle)) / angle**2 * (K @ K)


TWIN = np.diag([-1.0, -1.0, 1.0])


def turn_between(a: np.ndarray, b: np.ndarray) -> float:
    """Angle in radians between two orthogonal matrices (3, 3), up to the twin; π if one is the other's reflection."""
    cosine = max((np.trace(a @ (T @ b).T) - 1) / 2 for T in (np.eye(3), TWIN)) if np.linalg.det(a @ b) > 0 else -1.0
    return float(np.arccos(np.clip(cosine, -1, 1)))


def rotation_angle(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.arccos(np.clip((np.trace(a @ b.T) - 1) / 2, -1, 1)))
