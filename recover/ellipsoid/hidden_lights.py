"""Inliers that miss a light by less than noise, found by a statistical test on all of them together.

A pixel that misses light (b, a), of colour b and direction a, is off the ellipsoid by (c·n)(a·n), c = F⁻¹b. Where the
light is faint, or c lies along the surface of the ellipsoid, that is less than the noise, and no cut on single pixels
or on means of a few finds it. But there are thousands of such pixels, and they bias C: where they are a quarter of the
inliers C is four standard errors wrong, and the rotation under which that C's normals are integrable is wrong by ten
degrees. All pixels that miss a light have normals beyond one great circle, a·n < 0. So, for directions a all over the
sphere, the distances are regressed on C's six elements and on the c of a light there. Where c explains more than chance
does, the pixels beyond its great circle are left out and C is fitted again. The rotation need not be known, because N =
C^{1/2}ρ are normals up to one rotation. Source: this project (research log, "The rotation of robust").
"""

import numpy as np
from scipy import ndimage

from huesphere.recover.ellipsoid.fit import fit_accepted
from huesphere.recover.ellipsoid.parameters import ELLIPSOID
from huesphere.recover.geometry.quadratic import design
from huesphere.recover.geometry.root import symmetric_root
from huesphere.recover.geometry.sphere import fibonacci
from huesphere.recover.status import RecoveryFailure

HIDDEN_LEAST_KEPT = 0.35  # No light is believed whose pixels would leave fewer inliers (share of the inliers).

DIRECTIONS = 400  # directions a that are tested, 10° apart: a finer grid takes longer and finds the same lights
AT_ONCE = 40  # directions in one matrix product: so few that it stays in the cache
MOST_LIGHTS = 8  # hidden lights that are looked for, more than pictures have
SAMPLED_PIXELS = 10_000  # pixels of the regression: size of the work
TINY = 1e-6  # guard against division by zero


def without_hidden_lights(
    rgb: np.ndarray, inlier: np.ndarray, C: np.ndarray, *, noise: float, channel_noise: float
) -> tuple[np.ndarray, np.ndarray, int]:
    """(C (3, 3) refitted, remaining inliers (H, W), number of hidden lights found) of the ellipsoid C.

    ``rgb`` (H, W, 3) picture units, ``inlier`` (H, W) the pixels of C, ``noise`` the standard deviation of the distance
    to the ellipsoid, ``channel_noise`` that of a channel, whose bias is subtracted in the fit: picture units.
    """
    least = HIDDEN_LEAST_KEPT * inlier.sum()
    for found in range(MOST_LIGHTS):
        missing = _pixels_missing_a_light(rgb @ symmetric_root(C), inlier, noise**2 * C)
        if missing is None or inlier.sum() - missing.sum() < least:
            return C, inlier, found
        kept = inlier & ~missing
        try:
            C = fit_accepted(rgb[kept], np.ones(int(kept.sum()), bool), noise=channel_noise).C
        except RecoveryFailure:
            return C, inlier, found
        inlier = kept
    return C, inlier, MOST_LIGHTS


def _pixels_missing_a_light(N: np.ndarray, inlier: np.ndarray, V: np.ndarray) -> np.ndarray | None:
    """Those of the pixels ``inlier`` (H, W) that miss the most significant hidden light; None if none is significant.

    ``N`` (H, W, 3), normals up to a rotation, has noise of covariance ``V`` (3, 3).
    """
    n = _smoothed_directions(N, inlier)
    some = slice(None, None, -(-len(n) // SAMPLED_PIXELS))
    # Standard deviation of (|N|² − 1) / 2. The second term is the square of noise along the ellipsoid.
    sigma = np.sqrt(np.einsum("pi,ij,pj->p", n[some], V, n[some]) + 0.5 * np.trace(V @ V))
    off = ((N[inlier][some] ** 2).sum(axis=1) - 1 - np.trace(V)) / 2
    a = fibonacci(DIRECTIONS)
    clip = ELLIPSOID.hidden_distance_clip
    gain = _gains(n[some], np.clip(off / sigma, -clip, clip), sigma, a)
    best = int(np.argmax(gain))
    if gain[best] < ELLIPSOID.hidden_chi_square:
        return None
    out = np.zeros(inlier.shape, bool)
    out[inlier] = n @ a[best] < 0
    return out


def _smoothed_directions(N: np.ndarray, inlier: np.ndarray) -> np.ndarray:
    """Unit mean of the N (H, W, 3) of each inlier's neighbours, (P, 3), without the inlier's own.

    A pixel's own noise would be in its direction as well as in its distance, and correlate them.
    """
    blur = ELLIPSOID.hidden_smoothing_px
    radius = int(np.ceil(8 * blur))
    own = ndimage.gaussian_filter(np.eye(1, 2 * radius + 1, radius)[0], blur)[radius] ** 2  # weight of the pixel itself
    weight = ndimage.gaussian_filter(inlier.astype(float), blur)[inlier] - own
    n = ndimage.gaussian_filter(np.where(inlier[..., None], N, 0.0), (blur, blur, 0))[inlier] - own * N[inlier]
    n /= np.maximum(weight, TINY)[:, None]
    n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), TINY)
    return n  # type: ignore[no-any-return]


def _gains(n: np.ndarray, off: np.ndarray, sigma: np.ndarray, a: np.ndarray) -> np.ndarray:
    """χ² (K,) by which a missing light in each direction a (K, 3) improves the fit of ``off`` (P,), C fitted with it.

    ``n`` (P, 3) unit; ``off``, the distances, in units of their standard deviation ``sigma`` (P,). 0 where too few or
    too many pixels are beyond the great circle. Long sums are in single precision, which takes half the time and keeps
    χ² to a relative error of 1e-5.
    """
    by_C = np.linalg.qr(design(n) / sigma[:, None])[0]
    without_C = off - by_C @ (by_C.T @ off)
    by_c = n * (np.median(sigma) / sigma)[:, None]  # of any scale
    products = (by_c[:, :, None] * by_c[:, None, :]).reshape(-1, 9).astype(np.float32)
    crossed = (by_C[:, :, None] * by_c[:, None, :]).reshape(-1, 18)
    first = np.column_stack([by_c * without_C[:, None], crossed]).astype(np.float32)
    gain, n, a = np.zeros(len(a)), n.astype(np.float32), a.astype(np.float32)
    for start in range(0, len(a), AT_ONCE):
        depth = np.minimum(n @ a[start : start + AT_ONCE].T, 0.0)  # (P, A): a·n beyond the great circle
        share = (depth < 0).mean(axis=0)
        tested = np.flatnonzero((share > ELLIPSOID.hidden_least_share) & (share < ELLIPSOID.hidden_most_share))
        if not len(tested):
            continue
        depth = depth[:, tested]
        sums = (depth.T @ first).astype(np.float64)
        right, cross = sums[:, :3], sums[:, 3:].reshape(-1, 6, 3)
        gram = ((depth * depth).T @ products).astype(np.float64).reshape(-1, 3, 3)
        gram -= np.einsum("aki,akj->aij", cross, cross)
        gram += TINY * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        gain[start + tested] = np.einsum("ai,ai->a", right, np.linalg.solve(gram, right[..., None])[..., 0])
    return gain * len(n) / max(float((off**2).sum()), float(len(n)))
