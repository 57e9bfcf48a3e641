"""Normals of a picture by a rig: the direction of F(x)⁻¹ρ at each pixel, with its stated error."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from huesphere.recover.rig.extrapolation import growth
from huesphere.recover.rig.markers import interpolated
from huesphere.recover.rig.model import RigModel, positions

MEAN_OF_RMS = np.sqrt(np.pi) / 2  # mean over RMS of an angle whose two components are Gaussian (Rayleigh)


@dataclass(frozen=True)
class RigNormals:
    """Normals of one picture."""

    normals: np.ndarray  # (H, W, 3) float32, unit
    length: np.ndarray  # (H, W) float32 |F⁻¹ρ|: brightness over that of the calibration


def normals_of(rho: np.ndarray, inverse: np.ndarray, known: np.ndarray) -> RigNormals:
    """Normals of ρ (H, W, 3) by F⁻¹ (3, 3, H, W); those of pixels that are not ``known`` (H, W) are interpolated."""
    normals, length = np.empty(rho.shape, np.float32), np.empty(known.shape, np.float32)
    _directions(np.ascontiguousarray(rho, np.float32), inverse, normals, length)
    if not known.all():
        n = interpolated(normals, known)
        _unit(n)
        normals = n
    return RigNormals(normals, length)


@njit(cache=True)  # type: ignore[untyped-decorator]
def _unit(n: np.ndarray) -> None:
    """Make the vectors (H, W, 3) unit vectors in place; those of no length become (0, 0, 1)."""
    for i in range(n.shape[0]):
        for j in range(n.shape[1]):
            size = np.sqrt(n[i, j, 0] ** 2 + n[i, j, 1] ** 2 + n[i, j, 2] ** 2)
            if size > 1e-9:
                n[i, j, 0] /= size
                n[i, j, 1] /= size
                n[i, j, 2] /= size
            else:
                n[i, j, 0], n[i, j, 1], n[i, j, 2] = 0.0, 0.0, 1.0


@njit(cache=True)  # type: ignore[untyped-decorator]
def _directions(rho: np.ndarray, inverse: np.ndarray, normals: np.ndarray, length: np.ndarray) -> None:
    """Write the direction and the length of F⁻¹ρ; a pixel without light gets (0, 0, 1)."""
    for i in range(rho.shape[0]):
        for j in range(rho.shape[1]):
            r, g, b = rho[i, j, 0], rho[i, j, 1], rho[i, j, 2]
            x = inverse[0, 0, i, j] * r + inverse[0, 1, i, j] * g + inverse[0, 2, i, j] * b
            y = inverse[1, 0, i, j] * r + inverse[1, 1, i, j] * g + inverse[1, 2, i, j] * b
            z = inverse[2, 0, i, j] * r + inverse[2, 1, i, j] * g + inverse[2, 2, i, j] * b
            normals[i, j, 0], normals[i, j, 1], normals[i, j, 2] = x, y, z
            length[i, j] = np.sqrt(x * x + y * y + z * z)
    _unit(normals)


def stated_error_deg(rig: RigModel, found: RigNormals, inverse: np.ndarray, noise: float) -> np.ndarray:
    """(H, W) expected angular error in degrees: that of the model, by tilt, and that of ``noise`` in ρ.

    Noise of deviation σ in each channel moves the unit normal by σ |(I − n nᵀ) F⁻¹| / |F⁻¹ρ| (Frobenius norm). The
    model's error is that of balls left out of the calibration, and grows far from all balls
    (``recover.rig.extrapolation``); the noise that is in it is counted once.
    """
    tilt = np.degrees(np.arccos(np.clip(found.normals[..., 2], -1, 1)))
    along = np.einsum("hwi,ijhw->hwj", found.normals, inverse)
    across = np.maximum((inverse**2).sum(axis=(0, 1)) - (along**2).sum(axis=-1), 0)
    gain = np.degrees(np.sqrt(across)) / np.maximum(found.length, 1e-6)
    excess = max(noise**2 - rig.noise**2, 0.0)
    far = growth(rig.places, rig.order, positions(rig.size))
    rms = np.sqrt(far**2 * (rig.error_deg[0] ** 2 + (rig.error_deg[1] * tilt) ** 2) + excess * gain**2)
    return (MEAN_OF_RMS * np.minimum(rms, 90.0)).astype(np.float32)  # type: ignore[no-any-return]
