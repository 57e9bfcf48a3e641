"""Photometric stereo with three grey pictures under three unknown lights: grey levels in place of colour channels.

R. J. Woodham, Y. Iwahori & R. A. Barman, "Photometric stereo: Lambertian reflectance and light sources with unknown
direction and strength", UBC TR-91-18 (1991), the report's [1]. The three grey levels of a pixel are linear in the
normal, so they lie on an ellipsoid, from which the normals follow up to an orthogonal matrix. The paper has no method
to determine that matrix.
"""

import numpy as np

from huesphere.recover.ellipsoid.fit import Fit, least_median_of_squares, reweighted
from huesphere.recover.geometry.root import symmetric_root
from huesphere.recover.status import RecoveryFailure

FEWEST_PIXELS = 50  # least number of pixels for the fit of an ellipsoid, which has six unknowns


def normals_up_to_rotation(pictures: np.ndarray, lit: np.ndarray) -> tuple[np.ndarray, Fit]:
    """(N (H, W, 3), ellipsoid fit) from linear ``pictures`` (3, H, W), one under each light.

    ``lit`` (H, W) bool: the pixels that all three lights reach. N = Ĝ g / |Ĝ g| for the grey levels g (3,) of a pixel,
    Eq. (11) with g in place of ρ; NaN off ``lit`` and where g is an outlier of the ellipsoid. The true normals, camera
    frame, are O N with one unknown orthogonal matrix O (3, 3) for all pixels. ``render.layers`` gives such pictures:
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
