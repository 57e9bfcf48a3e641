"""The colours of an object and the ellipsoid ρᵀCρ = 1 that a method fitted to them, as points and lines to draw.

It is the report's Fig. 1(c).
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from huesphere.recover.solution import Solution

CLOUD_POINTS = 1500  # most colours that are drawn


@dataclass(frozen=True)
class Ellipsoid:
    """A method's ellipsoid: the map of colours that makes it the unit sphere, and grid lines on that sphere."""

    to_sphere: np.ndarray  # (3, 3): ρ @ to_sphere has length 1 for ρ on the ellipsoid; columns from long to short axis
    wire: np.ndarray  # (P, 3) points of grid lines around the accepted colours; rows of NaN separate lines


def sample_colours(rgb: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return flat indices of at most ``CLOUD_POINTS`` evenly spaced object pixels with finite colour."""
    index = np.flatnonzero(mask & np.isfinite(rgb).all(axis=-1))
    return index[:: max(1, -(-len(index) // CLOUD_POINTS))]


def fitted_ellipsoid(rho: np.ndarray, on: np.ndarray, C: np.ndarray) -> Ellipsoid:
    """Return the ellipsoid of C (3, 3), with grid lines around the colours rho (N, 3) that are ``on`` it (N,)."""
    values, vectors = np.linalg.eigh(C)
    to_sphere = vectors * np.sqrt(values)
    if np.median((rho @ to_sphere)[:, 0]) < 0:
        to_sphere[:, 0] *= -1.0  # the longest axis points toward the colours
    unit = rho @ to_sphere
    return Ellipsoid(to_sphere, _cap(unit[on] if on.any() else unit))


def ellipsoid_matrix(solution: Solution | None) -> np.ndarray | None:
    """Return C (3, 3) of a method's solution, or None where there is none that is positive definite."""
    if solution is None or np.linalg.matrix_rank(solution.F) < 3:
        return None
    C = solution.C
    return C if np.isfinite(C).all() and np.linalg.eigvalsh(C)[0] > 0 else None


def _cap(unit: np.ndarray) -> np.ndarray:
    """Return parallels and meridians (P, 3) on the part of the unit sphere around the unit vectors (N, 3).

    Rows of NaN separate the lines.
    """
    pole = unit.mean(axis=0)
    pole /= max(float(np.linalg.norm(pole)), 1e-12)
    radius = min(np.arccos(np.clip(np.quantile(unit @ pole, 0.01), -1.0, 1.0)) + np.radians(8.0), np.pi)
    tangents = np.linalg.svd(pole[None])[2][1:]
    polar, azimuth = _grid()
    polar = (radius * polar)[:, None]
    return np.cos(polar) * pole + np.sin(polar) * (azimuth @ tangents)


@lru_cache(maxsize=1)
def _grid() -> tuple[np.ndarray, np.ndarray]:
    """Return points of six parallels and twelve meridians of a cap of radius 1; rows of NaN separate the lines.

    (polar angle (P,), (cos, sin) of the azimuth (P, 2)).
    """
    lines = [(np.full(61, k / 6), np.linspace(0.0, 2 * np.pi, 61)) for k in range(1, 7)]
    lines += [(np.linspace(0.0, 1.0, 16), np.full(16, k * np.pi / 6)) for k in range(12)]
    polar, azimuth = (np.concatenate([np.append(line[i], np.nan) for line in lines]) for i in (0, 1))
    return polar, np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
