"""What passes between the steps of a method: the ellipsoid with its pixels, the rotation, and both together."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from huesphere.recover.cues.silhouette import SilhouetteRotation
from huesphere.recover.ellipsoid.fit import Fit
from huesphere.recover.geometry.root import symmetric_root
from huesphere.recover.geometry.rotations import TWIN

Notes = dict[str, Any]  # diagnostics of a run, JSON-able: steps write into it, and nothing reads it


@dataclass(frozen=True)
class FittedEllipsoid:
    """An ellipsoid ρᵀCρ = 1 and the pixels taken to lie on it."""

    fit: Fit
    inlier: np.ndarray  # (H, W) bool
    noise: float  # standard deviation of the distance to it, picture units
    ambient: np.ndarray = field(default_factory=lambda: np.zeros(3))  # (3,) its centre, picture units: report 3.6
    near: np.ndarray | None = None  # (H, W) bool, pixels near enough to it to vote on convex or concave; None: inlier
    free_of_edge: bool = False  # pixels along its edge that belong to other ellipsoids have been told one by one
    silhouette: SilhouetteRotation | None = None  # what the outline says of the rotation, if it was asked

    @property
    def root(self) -> np.ndarray:
        """Ĝ (3, 3), symmetric, ĜᵀĜ = C (report 2.1)."""
        return symmetric_root(self.fit.C)

    def rotated_normals(self, rgb: np.ndarray) -> np.ndarray:
        """N = Ĝ(ρ − ambient) (H, W, 3) of colours (H, W, 3). Eq. (11)"""
        return (rgb - self.ambient) @ self.root.T


@dataclass(frozen=True)
class FittedRotation:
    """The rotation that takes rotated normals N to the camera frame, n ∝ matrix · stretch · N. Eq. (12)"""

    matrix: np.ndarray  # (3, 3) orthogonal, of Ĝρ with Ĝ of positive determinant
    covariance: np.ndarray  # (3, 3) radians², of a small rotation of the camera frame
    converged: bool
    stretch: np.ndarray = field(default_factory=lambda: np.eye(3))  # (3, 3) symmetric: a correction of Ĝ
    other: "FittedRotation | None" = None  # the convex/concave twin; None: TWIN · matrix, and all else as here
    other_ratio: float = 1.0  # how many times more curl or misfit the twin has

    def twin(self) -> "FittedRotation":
        """The rotation of the surface turned inside out."""
        turned = replace(self, matrix=TWIN @ self.matrix, covariance=TWIN @ self.covariance @ TWIN)
        return turned if self.other is None else self.other

    def normals(self, N: np.ndarray, where: np.ndarray) -> np.ndarray:
        """Unit normals (H, W, 3) of rotated normals (H, W, 3), NaN off ``where`` (H, W). Eq. (12)"""
        N = N @ self.stretch
        n = np.full(N.shape, np.nan)
        np.divide(N @ self.matrix.T, np.linalg.norm(N, axis=-1)[..., None], out=n, where=where[..., None])
        return n


@dataclass(frozen=True)
class Oriented:
    """An ellipsoid and the rotation of its root, convex or concave decided."""

    ellipsoid: FittedEllipsoid
    rotation: FittedRotation

    @property
    def F(self) -> np.ndarray:
        """(3, 3) ρ = F n + ambient. Eq. (6)"""
        return np.linalg.inv(self.rotation.matrix @ self.rotation.stretch @ self.ellipsoid.root)


def finite_or_none(value: float) -> float | None:
    """``value``, or None where JSON has no number for it."""
    return value if np.isfinite(value) else None
