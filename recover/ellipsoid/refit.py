"""The pixels that truly lie on an ellipsoid, by local means of the distance to it, and the ellipsoid refitted to them.

Where a surface turns away from a light its colours leave the ellipsoid gradually: a cut on each residual keeps a strip
of outliers along every terminator. On the ellipsoid the distance is independent noise, and its mean over a window of
5×5 pixels is five times smaller; in the strip the mean is not. So the means reject the strip, and the choice of pixels
hardly depends on single noise values, as the bias correction (``recover.ellipsoid.noise_bias``) requires.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.special import ndtri

from huesphere.recover.ellipsoid.distance import signed_distance
from huesphere.recover.ellipsoid.fit import Fit, fit_accepted
from huesphere.recover.ellipsoid.parameters import ELLIPSOID
from huesphere.recover.pixels.parameters import PIXELS
from huesphere.recover.robust_scale import mad_scale
from huesphere.recover.status import RecoveryFailure

# Rounds of inlier selection and refitting end below this change (relative change of C (Frobenius norm)).
REFIT_TOLERANCE = 1e-4

MOST_ROUNDS = 8  # end of a refit that goes to and fro between two sets of pixels


@dataclass(frozen=True)
class Refit:
    """An ellipsoid and its own pixels."""

    fit: Fit
    inlier: np.ndarray  # (H, W) bool, the accepted pixels
    noise: float  # independent part of the distance to the ellipsoid, standard deviation, picture units
    correlated: float  # spatially correlated part: error of the model, standard deviation, picture units
    unbiased: bool  # the noise's bias could be subtracted
    rounds: int


def refit_inliers(rgb: np.ndarray, usable: np.ndarray, C: np.ndarray) -> Refit:
    """C (3, 3) refitted to its own among the ``usable`` (H, W) pixels of ``rgb`` (H, W, 3), until it converges.

    Picture units. Raises RecoveryFailure: no-dominant-shell where too few pixels are left, rank-deficient-colours,
    no-ellipsoid.
    """
    colours = rgb[usable]
    weight = ndimage.uniform_filter(usable.astype(np.float64), ELLIPSOID.averaging_window_px)
    correlated = np.inf
    rounds = 0
    while rounds < MOST_ROUNDS:
        rounds += 1
        inlier, noise, correlated = _inliers(signed_distance(colours, C), usable, weight, correlated)
        if inlier.sum() < PIXELS.fewest_pixels:
            raise RecoveryFailure("no-dominant-shell", "no region of the picture lies on one ellipsoid")
        fit, unbiased = _fit(colours, inlier[usable], noise)
        change = float(np.linalg.norm(fit.C - C) / np.linalg.norm(C))
        C = fit.C
        if change < REFIT_TOLERANCE:
            break
    return Refit(fit, inlier, noise, correlated, unbiased, rounds)


def _inliers(
    distance: np.ndarray, usable: np.ndarray, weight: np.ndarray, before: float
) -> tuple[np.ndarray, float, float]:
    """(inliers (H, W), independent scale, correlated scale) from the distances of the usable pixels, in raster order.

    ``weight`` (H, W): usable share of each window. The correlated scale never grows beyond the one ``before``:
    otherwise a fit that drifts away would accept ever more outliers.
    """
    side = ELLIPSOID.averaging_window_px
    scale = _scale(distance)
    image = np.zeros(usable.shape)
    image[usable] = np.clip(distance, -ELLIPSOID.refit_clip * scale, ELLIPSOID.refit_clip * scale)
    mean = ndimage.uniform_filter(image, side) / np.maximum(weight, 1e-9)
    # The scatter of the means is measured, not computed from the noise: neighbours may share an error of the model.
    correlated = min(before, max(_scale(mean[usable]), scale / side))
    expected = correlated * np.sqrt(1 / np.maximum(weight, 1 / side**2))  # fewer pixels in the window, wider scatter
    inlier = ndimage.binary_opening(usable & (np.abs(mean) < ELLIPSOID.window_mean_cut * expected), np.ones((3, 3)))
    if not inlier.any():
        return inlier, scale, correlated
    noise = mad_scale((image - mean)[inlier] * np.sqrt(side**2 / (side**2 - 1)))
    inlier &= np.abs(image) < ELLIPSOID.single_distance_cut * np.hypot(noise, correlated)
    return inlier, noise, correlated


def _scale(values: np.ndarray) -> float:
    """Standard deviation of the Gaussian that has the low quantile of |values|."""
    quantile = ELLIPSOID.scale_quantile
    of_unit_gaussian = round(float(ndtri((1 + quantile) / 2)), 4)  # four digits, with which the results were tabulated
    return float(np.quantile(np.abs(values), quantile)) / of_unit_gaussian


def _fit(colours: np.ndarray, accepted: np.ndarray, noise: float) -> tuple[Fit, bool]:
    """(fit over the accepted, whether the noise's bias was subtracted)."""
    try:
        return fit_accepted(colours, accepted, noise=noise), True
    except RecoveryFailure:  # as much noise as colour in some direction: without its bias no ellipsoid is left
        return fit_accepted(colours, accepted), False
