"""Rotation by random steps down the integrability integral (Eq. 13), and regions grown to a tolerance.

L. L. Kontsevich, A. P. Petrov & I. S. Vergelskaya, "Reconstruction of shape from shading in color images", JOSA A 11
(1994), the report's [9]: the method that the report's closed form was to replace. Implemented as the report describes
it, which gives neither step sizes nor tolerances: those are this project's. Frame as in
``recover.rotation.closed_form``.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from huesphere.recover.baselines.parameters import BASELINES
from huesphere.recover.ellipsoid.distance import signed_distance
from huesphere.recover.ellipsoid.fit import Fit, fit_accepted, least_squares
from huesphere.recover.geometry.rotations import rotation_by
from huesphere.recover.robust_scale import mad_scale
from huesphere.recover.status import RecoveryFailure

WALK_STEPS = 1500  # Random steps that are tried for the rotation.

MOST_LATE_TURN_DEG = 2.0  # The walk has converged if its last third turns the rotation by less (degrees).

STARTS = 12  # random rotations, of which the best starts the walk: bounds the work
FEWEST_ACCEPTED = 8  # steps: with fewer the walk has not begun, and says nothing of convergence
LEAST_FACING = 0.95  # share of normals that must face the camera: the integral would else fall by losing pixels
STEEPEST_N3 = 0.1  # normals more edge on than this have the slope of one at it: slopes grow without bound
MOST_PIXELS = 4000  # on which the integral is summed: bounds the work
SEEDS = 64  # squares that regions grow from, about so many: bounds the work
GROWTH_ROUNDS = 60  # of one region, at most


@dataclass(frozen=True)
class Descent:
    """Where the random walk ended."""

    rotation: np.ndarray  # (3, 3) Rᵀ, det +1
    integral: float  # Eq. (13) there, mean over the pixels
    accepted: int  # steps that lowered the integral
    converged: bool  # the last third of the walk hardly turned the rotation, and enough steps were accepted


def random_descent(N: np.ndarray, inside: np.ndarray, *, seed: int = 0, steps: int | None = None) -> Descent:
    """The rotation at the end of a random walk whose accepted steps all lower the integral of Eq. (13).

    ``N`` (H, W, 3): unit normals up to a rotation, of the pixels ``inside`` (H, W). ``steps``: None for the parameter
    ``walk_steps``. Raises RecoveryFailure: too-scattered.
    """
    steps = WALK_STEPS if steps is None else steps
    first, last = BASELINES.step_deviations_rad
    around = N.reshape(-1, 3)[_stencil(inside)]
    rng = np.random.default_rng(seed)
    starts = [rotation_by(rng.normal(size=3) * 2) for _ in range(STARTS)]
    values = [integrability_integral(around, start) for start in starts]
    rotation, value = starts[int(np.argmin(values))], min(values)
    accepted, late = 0, rotation
    for step in range(steps):
        size = first * (last / first) ** (step / steps)
        trial = rotation_by(size * rng.normal(size=3)) @ rotation
        trial_value = integrability_integral(around, trial)
        if trial_value < value:
            rotation, value, accepted = trial, trial_value, accepted + 1
        late = rotation if step == 2 * steps // 3 else late
    turned = np.arccos(np.clip((np.trace(late @ rotation.T) - 1) / 2, -1, 1))
    still = turned < np.radians(MOST_LATE_TURN_DEG)
    return Descent(rotation, value, accepted, bool(np.isfinite(value) and still and accepted >= FEWEST_ACCEPTED))


def integrability_integral(around: np.ndarray, rotation: np.ndarray) -> float:
    """Mean of [(n1/n3)_y − (n2/n3)_x]² over pixels, by centred differences, of n = rotation · N. Eq. (13)

    ``around`` (P, 4, 3) holds N at each pixel's right, left, upper and lower neighbour. Infinite where too many normals
    would face away.
    """
    n = around @ rotation.T
    if (n[..., 2] > 0).mean() < LEAST_FACING:
        return float("inf")
    steep = np.maximum(n[..., 2], STEEPEST_N3)
    right, left, up, down = 0, 1, 2, 3
    a, b = n[..., 0] / steep, n[..., 1] / steep
    curl = (a[:, up] - a[:, down] - b[:, right] + b[:, left]) / 2
    return float(curl @ curl) / len(curl)


def grow_region(rgb: np.ndarray, usable: np.ndarray) -> tuple[Fit, np.ndarray]:
    """(ellipsoid, region (H, W)) of the largest region grown from small squares of the picture, to a tolerance.

    ``rgb`` (H, W, 3): picture units; ``usable`` (H, W). The ellipsoid of a square is fitted, neighbours near to it by
    the square's own noise join, and it is fitted anew, until none joins. Raises RecoveryFailure (no-dominant-shell) if
    no square grows.
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
    """(region (H, W), C (3, 3) of its ellipsoid) grown from the square about a pixel; (empty, None): it has none."""
    region = np.zeros_like(usable)
    half = BASELINES.seed_side_px // 2
    region[row - half : row + half + 1, column - half : column + half + 1] = True
    region &= usable
    C, tolerance = None, 0.0
    for _ in range(GROWTH_ROUNDS):
        try:
            C = least_squares(rgb[region])
        except RecoveryFailure:
            return np.zeros_like(usable), None
        noise = mad_scale(signed_distance(rgb[region], C))
        tolerance = tolerance or max(BASELINES.region_tolerance * noise, 1e-7 * float(rgb[region].max()))
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
    side = BASELINES.seed_side_px
    whole = np.argwhere(ndimage.binary_erosion(usable, np.ones((side, side))))
    stride = max(side, int(np.sqrt(len(whole) / SEEDS)))
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
