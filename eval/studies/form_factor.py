"""Light from a surface patch as a dot product (report 2.5): f = n · l, and where it ends.

With f the integral of cosθ₁ cosθ₂ / π d² over the patch, and cosθ₁ = n · d̂, the normal comes out in front:
l = ∫ d̂ cosθ₂ / π d² dA. For a polygon l is known in closed form (Lambert 1760): Σ γ_k e_k / 2π, γ_k
the angle that edge k subtends and e_k the unit normal of the plane through it and the point.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Patch:
    """A parallelogram corner + s u + t v, 0 ≤ s, t ≤ 1; it shines toward u × v."""

    corner: np.ndarray
    u: np.ndarray
    v: np.ndarray

    @property
    def corners(self) -> np.ndarray:
        return np.stack([self.corner, self.corner + self.u, self.corner + self.u + self.v, self.corner + self.v])


def dot_product_vector(patch: Patch) -> np.ndarray:
    """l (3,) at the origin, by Lambert's formula: f = n · l wherever the whole patch is above n's horizon."""
    corners = patch.corners / np.linalg.norm(patch.corners, axis=1, keepdims=True)
    total = np.zeros(3)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        across = np.cross(a, b)
        total += np.arctan2(np.linalg.norm(across), a @ b) * across / np.linalg.norm(across)
    facing = np.cross(patch.u, patch.v) @ patch.corner < 0
    return (total if facing == (total @ patch.corners.mean(axis=0) > 0) else -total) / (2 * np.pi)


def form_factor(patch: Patch, normal: np.ndarray, *, cells: int = 400) -> float:
    """f of a small area at the origin with ``normal`` by the midpoint rule over the patch, both cosines cut at zero."""
    middle = (np.arange(cells) + 0.5) / cells
    s, t = np.meshgrid(middle, middle, indexing="ij")
    y = patch.corner + s[..., None] * patch.u + t[..., None] * patch.v
    across = np.cross(patch.u, patch.v)
    area = float(np.linalg.norm(across))
    square = np.sum(y * y, axis=-1)
    d = y / np.sqrt(square)[..., None]
    here, there = np.maximum(d @ normal, 0), np.maximum(-(d @ across) / area, 0)
    return float(np.sum(here * there / (np.pi * square)) * area / cells**2)


def above_horizon(patch: Patch, normal: np.ndarray) -> bool:
    """Whether all of the patch is above the horizon of ``normal``."""
    return bool((patch.corners @ normal).min() >= 0)
