"""Light from a surface patch as a dot product (report 2.5), f = n · l, and where that is no longer true.

The form factor f is the integral of cosθ₁ cosθ₂ / (π d²) over the patch. d is the distance of a point of the patch and
d̂ the direction to it, θ₁ the angle of d̂ to the normal n at the receiving point, θ₂ that to the patch's normal. With
cosθ₁ = n · d̂ the normal can be taken out of the integral: l = ∫ d̂ cosθ₂ / (π d²) dA. That holds while the whole patch
is above the horizon of n. For a polygon l has a closed form (Lambert 1760), Σ γ_k e_k / 2π, where γ_k is the angle that
edge k subtends at the point and e_k the unit normal of the plane through the edge and the point.
"""

from dataclasses import dataclass

import numpy as np

CELLS = 400  # of a patch along either side, for the midpoint rule


@dataclass(frozen=True)
class Patch:
    """A parallelogram corner + s u + t v, 0 ≤ s, t ≤ 1, that emits light to the side of u × v."""

    corner: np.ndarray  # (3,)
    u: np.ndarray  # (3,)
    v: np.ndarray  # (3,)

    @property
    def corners(self) -> np.ndarray:
        """The four corners (4, 3) in order around the patch."""
        return np.stack([self.corner, self.corner + self.u, self.corner + self.u + self.v, self.corner + self.v])


def dot_product_vector(patch: Patch) -> np.ndarray:
    """l (3,) at the origin, by Lambert's formula: f = n · l wherever the whole patch is above n's horizon."""
    corners = patch.corners / np.linalg.norm(patch.corners, axis=1, keepdims=True)
    total = np.zeros(3)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        cross = np.cross(a, b)
        total += np.arctan2(np.linalg.norm(cross), a @ b) * cross / np.linalg.norm(cross)
    emits_toward_origin = np.cross(patch.u, patch.v) @ patch.corner < 0
    points_to_patch = total @ patch.corners.mean(axis=0) > 0
    return (total if emits_toward_origin == points_to_patch else -total) / (2 * np.pi)


def form_factor(patch: Patch, normal: np.ndarray) -> float:
    """f of a small area at the origin with unit ``normal`` (3,), by the midpoint rule with CELLS × CELLS points.

    Negative cosines count as zero, so parts of the patch below the horizon are left out.
    """
    middle = (np.arange(CELLS) + 0.5) / CELLS
    s, t = np.meshgrid(middle, middle, indexing="ij")
    y = patch.corner + s[..., None] * patch.u + t[..., None] * patch.v
    cross = np.cross(patch.u, patch.v)
    area = float(np.linalg.norm(cross))
    square = np.sum(y * y, axis=-1)
    d = y / np.sqrt(square)[..., None]
    cos1, cos2 = np.maximum(d @ normal, 0), np.maximum(-(d @ cross) / area, 0)
    return float(np.sum(cos1 * cos2 / (np.pi * square)) * area / CELLS**2)


def above_horizon(patch: Patch, normal: np.ndarray) -> bool:
    """Whether the whole patch is above the horizon of a small area at the origin with ``normal`` (3,)."""
    return bool((patch.corners @ normal).min() >= 0)
