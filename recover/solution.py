"""The matrix F of the pixels that see every light, with what is known of it: what stages take and return.

ρ = F n + ambient (report Eq. 6, and 3.6 for the ambient term). Everything else is derived from F, so that it cannot
disagree: the ellipsoid C = (F Fᵀ)⁻¹ (Eq. 8) and the rotation R with n = R Ĝ ρ, Ĝ the symmetric root of C (Eqs. 11, 12).
"""

from dataclasses import dataclass, field, replace

import numpy as np

from huesphere.recover.geometry.root import symmetric_root
from huesphere.recover.geometry.rotations import TWIN


@dataclass(frozen=True)
class Convexity:
    """Which of the two solutions was taken, a surface or the same surface turned inside out, and by what evidence."""

    flipped: bool = False  # the solution that was found first was replaced by its twin
    margin: float = 0.0  # 0 (no evidence) … 1 (all the evidence is for the one that was taken)
    evidence: str = "none: taken as convex"  # "silhouette", "perspective", "interreflection", "calibration" …
    turn: np.ndarray = field(default_factory=lambda: TWIN)  # (3, 3) that takes normals to those of the other solution

    def flip(self, margin: float, evidence: str) -> "Convexity":
        """The choice of the other solution, for the reason given."""
        return Convexity(not self.flipped, margin, evidence, self.turn.T)


@dataclass(frozen=True)
class Solution:
    """F with its noise and covariance, and the pixels that it holds for. Camera frame, picture units."""

    F: np.ndarray  # (3, 3) ρ = F n + ambient
    inlier: np.ndarray  # (H, W) bool, pixels taken to see every light
    noise: float  # standard deviation of a channel: the larger of the fit's and the camera's
    rotation_covariance: np.ndarray  # (3, 3) radians², of a small rotation of the camera frame
    fit_noise: float = 0.0  # standard deviation of the distance of the inliers to the ellipsoid
    convexity: Convexity = field(default_factory=Convexity)
    by_silhouette: bool = False  # the object's silhouette took part in fixing the rotation
    ambient: np.ndarray = field(default_factory=lambda: np.zeros(3))  # (3,) the ellipsoid's centre: report 3.6

    @property
    def C(self) -> np.ndarray:
        """(3, 3) of the ellipsoid ρᵀCρ = 1, (F Fᵀ)⁻¹. Eq. (8)"""
        inverse = np.linalg.inv(self.F)
        return inverse.T @ inverse

    @property
    def rotation(self) -> np.ndarray:
        """(3, 3) orthogonal R with n = R Ĝ ρ, Ĝ the symmetric root of C. Eqs. (11), (12)"""
        return np.linalg.inv(symmetric_root(self.C) @ self.F)

    @property
    def reflection(self) -> bool:
        """Whether R reflects: the sign of det F, which the order of the lights around the object decides."""
        return bool(np.linalg.det(self.F) < 0)

    @property
    def condition(self) -> float:
        """cond(F): by how much the recovery multiplies relative noise, at most."""
        return float(np.linalg.cond(self.F))

    @property
    def rotation_stderr_deg(self) -> float:
        """Standard error of the rotation, degrees."""
        return float(np.degrees(np.sqrt(np.trace(self.rotation_covariance))))

    def other(self, margin: float, evidence: str) -> "Solution":
        """The convex/concave twin: the same surface turned inside out, taken for the reason given."""
        turn = self.convexity.turn
        return replace(
            self,
            F=self.F @ turn.T,
            rotation_covariance=turn @ self.rotation_covariance @ turn.T,
            convexity=self.convexity.flip(margin, evidence),
        )
