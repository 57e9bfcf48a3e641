"""The pixels that truly lie on a shell, told by local means of the distance to it, and the ellipsoid fitted to them.

Where a surface turns away from a light its colours leave the ellipsoid gradually: a cut on each residual keeps a strip
of strangers along every terminator. On the shell the distance is noise and its mean over 5×5 pixels is five times
smaller; off the shell it is not. So the means cut the strip, and what they select does not hang on single noise values,
which the bias correction (``recover.ellipsoid.noise_bias``) needs.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from huesphere.recover.ellipsoid.distance import WINDOW, signed_distance
from huesphere.recover.ellipsoid.fit import Fit, fit_accepted
from huesphere.recover.robust_scale import mad_scale
from huesphere.recover.status import RecoveryFailure

MEAN_CUT = 3.0  # of the scale of the mean
PIXEL_CUT = 4.5  # of the scale of single distances: gross outliers only, or the fit would be biased
LOW_QUANTILE = 0.25  # of the distances, from which the scale comes: low, for the strip is in the upper ones
ROUNDS = 8
SETTLED = 1e-4  # relative change of C


@dataclass(frozen=True)
class Polished:
    """An ellipsoid and its own pixels."""

    fit: Fit
    region: np.ndarray  # (H, W) bool, the accepted pixels
    noise: float  # the white part of the distance to the ellipsoid, per channel, picture units
    misfit: float  # the part that neighbours share: model error, picture units
    unbiased: bool  # the noise's bias could be taken out
    rounds: int


def polish(rgb: np.ndarray, usable: np.ndarray, C: np.ndarray) -> Polished:
    """Refit C (3, 3) of the picture ``rgb`` (H, W, 3) on its own among the ``usable`` (H, W) pixels, until it stands.

    Raises RecoveryFailure: no-dominant-shell where no region is left, rank-deficient-colours, no-ellipsoid.
    """
    colours = rgb[usable]
    weight = ndimage.uniform_filter(usable.astype(np.float64), WINDOW)
    misfit = np.inf
    rounds = 0
    while rounds < ROUNDS:
        rounds += 1
        region, noise, misfit = _region(signed_distance(colours, C), usable, weight, misfit)
        if region.sum() < 50:
            raise RecoveryFailure("no-dominant-shell", "no region of the picture lies on one ellipsoid")
        accepted = region[usable]
        fit, unbiased = _fit(colours, accepted, noise)
        change = float(np.linalg.norm(fit.C - C) / np.linalg.norm(C))
        C = fit.C
        if change < SETTLED:
            break
    return Polished(fit, region, noise, misfit, unbiased, rounds)


def _region(
    distance: np.ndarray, usable: np.ndarray, weight: np.ndarray, before: float
) -> tuple[np.ndarray, float, float]:
    """(region (H, W), white scale, shared scale) from the distances of the usable pixels, in raster order.

    The shared scale never grows over the one ``before``: a fit that strays would else take in ever more strangers.
    """
    scale = _scale(distance)
    image = np.zeros(usable.shape)
    image[usable] = np.clip(distance, -6 * scale, 6 * scale)
    mean = ndimage.uniform_filter(image, WINDOW) / np.maximum(weight, 1e-9)
    # How far means scatter is measured and not taken from the noise: neighbours may share an error of the model.
    shared = min(before, max(_scale(mean[usable]), scale / WINDOW))
    expected = shared * np.sqrt(1 / np.maximum(weight, 1 / WINDOW**2))  # fewer pixels in the window, wider scatter
    region = ndimage.binary_opening(usable & (np.abs(mean) < MEAN_CUT * expected), np.ones((3, 3)))
    if not region.any():
        return region, scale, shared
    white = (image - mean)[region] * np.sqrt(WINDOW**2 / (WINDOW**2 - 1))
    noise = mad_scale(white)
    region &= np.abs(image) < PIXEL_CUT * np.hypot(noise, shared)
    return region, noise, shared


def _scale(values: np.ndarray) -> float:
    """Standard deviation of a Gaussian with the low quantile of |values| (0.3186 at a quarter)."""
    return float(np.quantile(np.abs(values), LOW_QUANTILE)) / 0.3186


def _fit(colours: np.ndarray, accepted: np.ndarray, noise: float) -> tuple[Fit, bool]:
    try:
        return fit_accepted(colours, accepted, noise=noise), True
    except RecoveryFailure:  # as much noise as colour in some direction: correcting leaves no ellipsoid
        return fit_accepted(colours, accepted), False
