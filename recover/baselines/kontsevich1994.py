"""Rotation by random steps down the integrability integral (Eq. 13), and regions grown to a tolerance.

L. L. Kontsevich, A. P. Petrov & I. S. Vergelskaya, "Reconstruction of shape from shading in color images", JOSA A 11
(1994), the report's [9]: the method that its closed form was to replace. As told in the report; the paper's own step
sizes and tolerances are not in it and are ours. Frame as in ``recover.rotation.closed_form``.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from huesphere.recover.ellipsoid.distance import signed_distance
from huesphere.recover.ellipsoid.fit import Fit, fit_accepted, least_squares
from huesphere.recover.geometry.rotations import rotation_by
from huesphere.recover.robust_scale import mad_scale
from huesphere.recover.status import RecoveryFailure

STARTS = 12  # random rotations, of which the best is walked from
STEPS = 1500  # random steps tried
FIRST_STEP, LAST_STEP = 0.8, 1e-3  # radians, standard deviation of a step at the start and at the end
SETTLED = np.radians(2.0)  # the walk's last third may turn the rotation by this much
FEWEST_ACCEPTED = 8  # steps down, or the walk has not walked
FACING = 0.95  # share of normals that must face the camera: the integral would else fall by losing pixels
FLATTEST_N3 = 0.1  # slopes of normals more edge on than this stand as if at it
MOST_PIXELS = 4000  # on which the integral is summed

SEED_SIDE = 9  # pixels, side of the squares that regions grow from
SEEDS = 64
TOLERANCE = 3.0  # of the seed's own noise: a neighbour this near to the ellipsoid joins
GROWTH_ROUNDS = 60


@dataclass(frozen=True)
class Descent:
    """Where the random walk ended."""

    rotation: np.ndarray  # (3, 3) Rᵀ, det +1
    integral: float  # Eq. (13) there, mean over the pixels
    accepted: int  # steps that went down
    settled: bool  # the last third of the walk turned it by less than SETTLED, and it did walk


def random_descent(N: np.ndarray, inside: np.ndarray, *, seed: int = 0, steps: int = STEPS) -> Descent:
    """The rotation at the end of a random walk that only goes down Eq. (13), from N (H, W, 3) ``inside`` (H, W).

    Raises RecoveryFailure: too-scattered.
    """
    around = N.reshape(-1, 3)[_stencil(inside)]
    rng = np.random.default_rng(seed)
    starts = [rotation_by(rng.normal(size=3) * 2) for _ in range(STARTS)]
    values = [integrability_integral(around, start) for start in starts]
    rotation, value = starts[int(np.argmin(values))], min(values)
    accepted, late = 0, rotation
    for step in range(steps):
        size = FIRST_STEP * (LAST_STEP / FIRST_STEP) ** (step / steps)
        trial = rotation_by(size * rng.normal(size=3)) @ rotation
        trial_value = integrability_integral(around, trial)
        if trial_value < value:
            rotation, value, accepted = trial, trial_value, accepted + 1
        late = rotation if step == 2 * steps // 3 else late
    turned = np.arccos(np.clip((np.trace(late @ rotation.T) - 1) / 2, -1, 1))
    settled = bool(np.isfinite(value) and turned < SETTLED and accepted >= FEWEST_ACCEPTED)
    return Descent(rotation, value, accepted, settled)


def integrability_integral(around: np.ndarray, rotation: np.ndarray) -> float:
    """Mean of [(n1/n3)_y − (n2/n3)_x]² over pixels, by centred differences, of n = rotation · N. Eq. (13)

    ``around`` (P, 4, 3) holds N at each pixel's right, left, upper and lower neighbour. Infinite where too many normals
    would face away.
    """
    n = around @ rotation.T
    if (n[..., 2] > 0).mean() < FACING:
        return float("inf")
    steep = np.maximum(n[..., 2], FLATTEST_N3)
    right, left, up, down = 0, 1, 2, 3
    a, b = n[..., 0] / steep, n[..., 1] / steep
    curl = (a[:, up] - a[:, down] - b[:, right] + b[:, left]) / 2
    return float(curl @ curl) / len(curl)


def grow_region(rgb: np.ndarray, usable: np.ndarray) -> tuple[Fit, np.ndarray]:
    """(ellipsoid, region (H, W)) of the largest region grown: small squares of the picture, outward to a tolerance.

    A square's own ellipsoid is fitted, neighbours within TOLERANCE of its noise join, and it is fitted anew. Raises
    RecoveryFailure (no-dominant-shell) if no square grows.
    """
    best, best_C = np.zeros_like(usable), None
    for row, column in _seeds(usable):
        if best[row, column]:
            continue
        region, C = _grown_from(rgb, usable, row, column)
        if region.sum() > best.sum():
            best, best_C = region, C
    if best_C is None:
        raise RecoveryFailure("no-dominant-shell", "no region grew from any square of the picture")
    return fit_accepted(rgb[usable], best[usable]), best


def _grown_from(rgb: np.ndarray, usable: np.ndarray, row: int, column: int) -> tuple[np.ndarray, np.ndarray | None]:
    region = np.zeros_like(usable)
    half = SEED_SIDE // 2
    region[row - half : row + half + 1, column - half : column + half + 1] = True
    region &= usable
    C, tolerance = None, 0.0
    for _ in range(GROWTH_ROUNDS):
        try:
            C = least_squares(rgb[region])
        except RecoveryFailure:
            return np.zeros_like(usable), None
        noise = mad_scale(signed_distance(rgb[region], C))
        tolerance = tolerance or max(TOLERANCE * noise, 1e-7 * float(rgb[region].max()))
        ring = ndimage.binary_dilation(region, iterations=2) & usable
        joined = np.zeros_like(usable)
        joined[ring] = np.abs(signed_distance(rgb[ring], C)) < tolerance
        joined = _piece_at(joined, region)
        if joined.sum() <= region.sum():
            break
        region = joined
    return region, C


def _piece_at(joined: np.ndarray, region: np.ndarray) -> np.ndarray:
    """The connected piece of ``joined`` that holds most of ``region``."""
    labels = ndimage.label(joined)[0]
    counts = np.bincount(labels[region], minlength=1)
    counts[0] = 0
    return labels == int(np.argmax(counts)) if counts.any() else np.zeros_like(joined)


def _seeds(usable: np.ndarray) -> np.ndarray:
    """Middles (K, 2) of squares that lie whole within ``usable``, on an even grid."""
    whole = np.argwhere(ndimage.binary_erosion(usable, np.ones((SEED_SIDE, SEED_SIDE))))
    stride = max(SEED_SIDE, int(np.sqrt(len(whole) / SEEDS)))
    on_grid = (whole % stride == whole[len(whole) // 2] % stride).all(axis=1) if len(whole) else np.zeros(0, bool)
    return whole[on_grid]


def _stencil(inside: np.ndarray) -> np.ndarray:
    """(P, 4) flat numbers of the right, left, upper and lower neighbours of pixels that have all four."""
    cross = ndimage.binary_erosion(inside, ndimage.generate_binary_structure(2, 1))
    rows, columns = np.nonzero(cross)
    if not len(rows):
        raise RecoveryFailure("too-scattered", "no accepted pixel has its four neighbours accepted")
    every = max(1, len(rows) // MOST_PIXELS)
    at, width = (rows * inside.shape[1] + columns)[::every], inside.shape[1]
    return np.stack([at + 1, at - 1, at - width, at + width], axis=-1)
