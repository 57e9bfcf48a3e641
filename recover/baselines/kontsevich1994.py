"""The method of Kontsevich, Petrov and Vergelskaya: a region grown from a seed, and the rotation by random steps.

The rotation minimises the integrability integral (Eq. 13). L. L. Kontsevich, A. P. Petrov & I. S. Vergelskaya,
"Reconstruction of shape from shading in color images", JOSA A 11 (1994), the report's [9], is the method that the
report's closed form was to replace. It is implemented from the report's description, which gives neither step sizes nor
tolerances; these are this project's.
Frame: camera, x right, y up, z toward the camera, image row 0 at the top.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from huesphere.recover.baselines.parameters import BASELINES
from huesphere.recover.ellipsoid.distance import signed_distance
from huesphere.recover.ellipsoid.fit import Fit, fit_accepted, least_squares
from huesphere.recover.geometry.rotations import rotation_angle, rotation_by
from huesphere.recover.robust_scale import mad_scale
from huesphere.recover.status import RecoveryFailure

WALK_STEPS = 1500  # Random steps that are tried for the rotation.

MOST_LATE_TURN_DEG = 2.0  # The walk has converged if its last third turns the rotation by less (degrees).

STARTS = 12  # random rotations, the best of which is the start of the walk
FEWEST_ACCEPTED = 8  # accepted steps, below which the walk does not count as converged
LEAST_FACING = 0.95  # share of normals that must face the camera, or the integral could fall by losing pixels
STEEPEST_N3 = 0.1  # smaller n3 are taken for this, because slopes grow without bound
MOST_PIXELS = 4000  # number of pixels over which the integral is summed
SEEDS = 64  # number, about, of squares from which regions are grown
GROWTH_ROUNDS = 60  # most rounds of growth of one region


@dataclass(frozen=True)
class Descent:
    """The end of the random walk."""

    rotation: np.ndarray  # (3, 3) Rᵀ, det +1
    integral: float  # Eq. (13) at ``rotation``, mean over the pixels
    accepted: int  # number of steps that lowered the integral
    converged: bool  # whether enough steps were accepted and the last third of them hardly changed the rotation


def random_descent(N: np.ndarray, inside: np.ndarray, *, seed: int = 0, steps: int | None = None) -> Descent:
    """The rotation at the end of a random walk whose accepted steps all lower the integral of Eq. (13).

    ``N`` (H, W, 3): unit normals up to a rotation, of the pixels ``inside`` (H, W). ``steps``: None for
    WALK_STEPS. Raises RecoveryFailure: too-scattered.
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
    still = rotation_angle(late, rotation) < np.radians(MOST_LATE_TURN_DEG)
    return Descent(rotation, value, accepted, bool(np.isfinite(value) and still and accepted >= FEWEST_ACCEPTED))


def integrability_integral(around: np.ndarray, rotation: np.ndarray) -> float:
    """Mean of [(n1/n3)_y − (n2/n3)_x]² over pixels, by centred differences, of n = rotation · N. Eq. (13)

    ``around`` (P, 4, 3) holds N at each pixel's right, left, upper and lower neighbour. Infinite if less than
    LEAST_FACING of the normals face the camera: without that the integral could fall by turning pixels away.
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
    """(ellipsoid, region (H, W) bool) of the largest region that can be grown from a small square of the picture.

    ``rgb`` (H, W, 3): picture units; ``usable`` (H, W) bool. Raises RecoveryFailure (no-dominant-shell) if no square
    has an ellipsoid. See ``_grown_from``.
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
    """(region (H, W) bool, C (3, 3) of its ellipsoid), grown from the square with its middle at ``row``, ``column``.

    In each round an ellipsoid is fitted to the region by least squares, and neighbouring pixels join whose colours are
    within a tolerance of the ellipsoid, until no more join. The tolerance is a multiple of the scatter of the first
    square about its own ellipsoid. If a fit is no ellipsoid the result is (empty region, None).
    """
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
        if tolerance == 0.0:  # the first round
            noise = mad_scale(signed_distance(rgb[region], C))
            tolerance = max(BASELINES.region_tolerance * noise, 1e-7 * float(rgb[region].max()))
        ring = ndimage.binary_dilation(region, iterations=2) & usable
        joined = np.zeros_like(usable)
        joined[ring] = np.abs(signed_distance(rgb[ring], C)) < tolerance
        joined = _component_at(joined, region)
        if joined.sum() <= region.sum():
            break
        region = joined
    return region, C


def _component_at(joined: np.ndarray, region: np.ndarray) -> np.ndarray:
    """The connected component of ``joined`` (H, W) bool that contains most of ``region`` (H, W) bool."""
    labels = ndimage.label(joined)[0]
    counts = np.bincount(labels[region], minlength=1)
    counts[0] = 0
    return labels == int(np.argmax(counts)) if counts.any() else np.zeros_like(joined)


def _seeds(usable: np.ndarray) -> np.ndarray:
    """Middles (K, 2), row and column, of squares that lie completely within ``usable``, on a regular grid."""
    side = BASELINES.seed_side_px
    whole = np.argwhere(ndimage.binary_erosion(usable, np.ones((side, side))))
    stride = max(side, int(np.sqrt(len(whole) / SEEDS)))
    on_grid = (whole % stride == whole[len(whole) // 2] % stride).all(axis=1) if len(whole) else np.zeros(0, bool)
    return whole[on_grid]


def _stencil(inside: np.ndarray) -> np.ndarray:
    """(P, 4) flat indices of the right, left, upper and lower neighbours, for pixels whose neighbours are all inside.

    Raises RecoveryFailure: too-scattered.
    """
    cross = ndimage.binary_erosion(inside, ndimage.generate_binary_structure(2, 1))
    rows, columns = np.nonzero(cross)
    if not len(rows):
        raise RecoveryFailure("too-scattered", "no accepted pixel has its four neighbours accepted")
    every = max(1, len(rows) // MOST_PIXELS)
    at, width = (rows * inside.shape[1] + columns)[::every], inside.shape[1]
    return np.stack([at + 1, at - 1, at - width, at + width], axis=-1)
