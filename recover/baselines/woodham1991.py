"""Three grey pictures under three unknown lights: the three grey levels of a pixel take the part of its colour.

R. J. Woodham, Y. Iwahori & R. A. Barman, "Photometric stereo: Lambertian reflectance and light sources with unknown
direction and strength", UBC TR-91-18 (1991), the report's [1]. Grey levels are linear in the normal, so they lie on an
ellipsoid, and the normals follow up to an orthogonal matrix; nothing in [1] fixes that one.
"""

import numpy as np

from huesphere.recover.ellipsoid.fit import Fit, least_median_of_squares, reweighted
from huesphere.recover.geometry.root import symmetric_root
from huesphere.recover.status import RecoveryFailure

FEWEST_PIXELS = 50  # an ellipsoid has six numbers: guards the fit against having next to nothing to go by


def normals_up_to_rotation(pictures: np.ndarray, lit: np.ndarray) -> tuple[np.ndarray, Fit]:
    """(N (H, W, 3), ellipsoid) from ``pictures`` (3, H, W), one for each light, over the pixels ``lit`` by all three.

    ``lit`` (H, W) bool. N = Ĝ g / |Ĝ g| for the grey levels g (Eq. (11) with g for ρ), NaN off ``lit`` and where g is
    not on the ellipsoid; the true normals are O N for one orthogonal O. ``render.layers`` gives such pictures:
    ``layers.images[lights, 0]``. Raises ValueError for pictures of another shape, and RecoveryFailure: too-few-pixels,
    rank-deficient-colours (lights in one plane), no-ellipsoid.
    """
    if pictures.shape != (3, *lit.shape):
        raise ValueError(f"pictures: got shape {pictures.shape}, expected {(3, *lit.shape)}")
    if lit.sum() < FEWEST_PIXELS:
        raise RecoveryFailure("too-few-pixels", f"{int(lit.sum())} pixels are lit by all three lights")
    grey = np.moveaxis(pictures, 0, -1)[lit].astype(np.float64)
    fit = reweighted(grey, least_median_of_squares(grey))
    N = np.full((*lit.shape, 3), np.nan)
    rotated = grey @ symmetric_root(fit.C).T
    N[lit] = np.where(fit.accepted[:, None], rotated / np.linalg.norm(rotated, axis=-1, keepdims=True), np.nan)
    return N, fit
