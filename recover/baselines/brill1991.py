"""Normals from three that are known: with ρ = F n at three pixels F follows, and every other normal from its colour.

M. H. Brill, "Photometric models in multispectral machine vision", SPIE 1453 (1991), the report's [12].
"""

import numpy as np

from huesphere.recover.status import RecoveryFailure

LEAST_VOLUME = 1e-3  # product of singular values of the known normals: guards against normals in one plane


def matrix_from_known_normals(colours: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """F (3, 3), picture units, from the ``colours`` (K, 3) of K ≥ 3 pixels whose unit ``normals`` (K, 3) are known.

    Exact for three, least squares for more; F is in the frame of the normals. All pixels must see the same lights.
    Raises RecoveryFailure: too-few-pixels; flat-surface where the normals lie in a plane; rank-deficient-colours where
    the colours do.
    """
    if len(normals) < 3:
        raise RecoveryFailure("too-few-pixels", f"{len(normals)} known normals, three are needed")
    if np.prod(np.linalg.svd(normals)[1]) < LEAST_VOLUME:
        raise RecoveryFailure("flat-surface", "the known normals lie in a plane")
    F = np.linalg.lstsq(normals, colours)[0].T  # Eq. (6), one column of equations a channel
    scale = np.linalg.svd(F)[1]
    if not scale[2] > 1e-9 * scale[0]:
        raise RecoveryFailure("rank-deficient-colours", "the colours of the known normals lie in a plane")
    return F


def normals_by_known_normals(rgb: np.ndarray, colours: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Unit normals (..., 3) of the picture ``rgb`` (..., 3), n = Gρ / |Gρ| with G = F⁻¹. Eq. (7)

    ``colours`` and ``normals`` (K, 3): of the known pixels, as for ``matrix_from_known_normals``, which also says what
    is raised. Right where a pixel sees the lights that the known pixels see; NaN where its colour is black.
    """
    n = rgb @ np.linalg.inv(matrix_from_known_normals(colours, normals)).T
    length = np.linalg.norm(n, axis=-1, keepdims=True)
    return np.divide(n, length, out=np.full_like(n, np.nan), where=length > 0)
