"""Three known normals fix everything: with ρ = F n at three pixels F follows, and every other normal from its colour.

M. H. Brill, "Photometric models in multispectral machine vision", SPIE 1453 (1991), the report's [12].
"""

import numpy as np

from huesphere.recover.status import RecoveryFailure

LEAST_VOLUME = 1e-3  # |det| of three unit vectors: below, they lie in a plane as far as any noise can tell


def matrix_from_known_normals(colours: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """F (3, 3), picture units, from the ``colours`` (K, 3) of K ≥ 3 pixels whose unit ``normals`` (K, 3) are known.

    Exact for three, least squares for more. All pixels must see the same lights. Raises RecoveryFailure:
    too-few-pixels; flat-surface where the normals, rank-deficient-colours where the colours, lie in a plane.
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

    Right where a pixel sees the lights that the known pixels see; NaN where it has no colour.
    """
    n = rgb @ np.linalg.inv(matrix_from_known_normals(colours, normals)).T
    length = np.linalg.norm(n, axis=-1, keepdims=True)
    return np.divide(n, length, out=np.full_like(n, np.nan), where=length > 0)
