"""Normals of a picture by a rig: the direction of F(x)⁻¹ρ at each pixel, with its stated error."""

from dataclasses import dataclass

import numpy as np

from huesphere.recover.rig.markers import interpolated
from huesphere.recover.rig.model import RigModel

MEAN_OF_RMS = np.sqrt(np.pi) / 2  # mean over RMS of an angle whose two components are Gaussian (Rayleigh)


@dataclass(frozen=True)
class RigNormals:
    """Normals of one picture."""

    normals: np.ndarray  # (H, W, 3) float32, unit
    length: np.ndarray  # (H, W) float32 |F⁻¹ρ|: brightness over that of the calibration


def normals_of(rho: np.ndarray, inverse: np.ndarray, known: np.ndarray) -> RigNormals:
    """Normals of ρ (H, W, 3) by F⁻¹ (3, 3, H, W); those of pixels that are not ``known`` (H, W) are interpolated."""
    b = np.empty(rho.shape, np.float32)
    for i in range(3):
        b[..., i] = inverse[i, 0] * rho[..., 0] + inverse[i, 1] * rho[..., 1] + inverse[i, 2] * rho[..., 2]
    length = np.sqrt(b[..., 0] ** 2 + b[..., 1] ** 2 + b[..., 2] ** 2)
    b /= np.maximum(length, np.float32(1e-12))[..., None]
    if known.all():
        return RigNormals(b, length)
    n = interpolated(b, known)
    size = np.sqrt(n[..., 0] ** 2 + n[..., 1] ** 2 + n[..., 2] ** 2)
    far = size < 1e-6  # no known pixel is near
    n[far] = (0.0, 0.0, 1.0)
    size[far] = 1
    n /= size[..., None]
    return RigNormals(n, length)


def stated_error_deg(rig: RigModel, found: RigNormals, inverse: np.ndarray, noise: float) -> np.ndarray:
    """(H, W) expected angular error in degrees: that of the model, by tilt, and that of ``noise`` in ρ.

    Noise of deviation σ in each channel moves the unit normal by σ |(I − n nᵀ) F⁻¹| / |F⁻¹ρ| (Frobenius norm). The
    model's error is that of balls left out of the calibration; the noise that is in it is counted once.
    """
    tilt = np.degrees(np.arccos(np.clip(found.normals[..., 2], -1, 1)))
    along = np.einsum("hwi,ijhw->hwj", found.normals, inverse)
    across = np.maximum((inverse**2).sum(axis=(0, 1)) - (along**2).sum(axis=-1), 0)
    gain = np.degrees(np.sqrt(across)) / np.maximum(found.length, 1e-6)
    excess = max(noise**2 - rig.noise**2, 0.0)
    rms = np.sqrt(rig.error_deg[0] ** 2 + (rig.error_deg[1] * tilt) ** 2 + excess * gain**2)
    return (MEAN_OF_RMS * np.minimum(rms, 90.0)).astype(np.float32)  # type: ignore[no-any-return]
