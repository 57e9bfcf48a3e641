"""Pixels that lie on a shell to within noise and yet miss a light, told by all of them together.

A pixel that misses light (b, a) is off the shell by (c·n)(a·n), c = F⁻¹b: where the light is faint, or c lies along the
surface of the shell, by less than noise, and no cut on single pixels or on means of a few finds it. But there are
thousands of them, and C takes up what they are off by: of a shell a quarter of whose pixels are such strangers it is
four standard errors wrong, and what rotation makes that C's normals a surface is wrong by ten degrees. All of them
have normals beyond one great circle, a·n < 0. So for directions a all over the sphere, the squared distances are
regressed on C's six numbers and the c of a light there; where c explains more than chance, its pixels are left out.
No rotation need be known, for N = C^{1/2}ρ is turned as a whole.
"""

import numpy as np
from scipy import ndimage

from huesphere.recover.ellipsoid.fit import fit_accepted
from huesphere.recover.geometry.quadratic import design
from huesphere.recover.geometry.root import symmetric_root
from huesphere.recover.geometry.sphere import fibonacci
from huesphere.recover.status import RecoveryFailure

DIRECTIONS, AT_ONCE = 400, 40  # so few at a time that they stay in the cache
BEYOND = 0.02, 0.6  # share of the pixels that may be beyond a great circle
CHANCE = 30.0  # of χ² with the 3 freedoms of c, the largest over all directions
MOST = 8  # lights
LEAST_KEPT = 0.35  # share of the pixels
CALM, REACH = 1.0, 8  # pixels: normals are those of means under a Gaussian, and how far it can reach
LEAST = 1e-6  # weight of the neighbours
WILD = 5.0  # standard deviations that a distance counts at most
SAMPLE = 10_000  # pixels


def without_faint(
    rgb: np.ndarray, core: np.ndarray, C: np.ndarray, *, noise: float, grain: float
) -> tuple[np.ndarray, np.ndarray, int]:
    """(C (3, 3), its pixels (H, W), lights found missing) of the shell C with the pixels ``core`` (H, W).

    ``rgb`` (H, W, 3) is the picture, ``noise`` the standard deviation of the distance to the shell, ``grain`` that of a
    channel, whose bias is taken out of the fit: picture units.
    """
    least = LEAST_KEPT * core.sum()
    for found in range(MOST):
        beyond = _beyond(rgb @ symmetric_root(C), core, noise**2 * C)
        if beyond is None or core.sum() - beyond.sum() < least:
            return C, core, found
        kept = core & ~beyond
        try:
            C = fit_accepted(rgb[kept], np.ones(int(kept.sum()), bool), noise=grain).C
        except RecoveryFailure:
            return C, core, found
        core = kept
    return C, core, MOST


def _beyond(N: np.ndarray, core: np.ndarray, V: np.ndarray) -> np.ndarray | None:
    """Those of the pixels ``core`` (H, W) that miss the most certain light; None where none is.

    ``N`` (H, W, 3) has noise of covariance ``V`` (3, 3).
    """
    # The neighbours' mean without the pixel itself: its noise would be both in its direction and in its distance.
    own = ndimage.gaussian_filter(np.eye(1, 2 * REACH + 1, REACH)[0], CALM)[REACH] ** 2
    weight = ndimage.gaussian_filter(core.astype(float), CALM)[core] - own
    n = ndimage.gaussian_filter(np.where(core[..., None], N, 0.0), (CALM, CALM, 0))[core] - own * N[core]
    n /= np.maximum(weight, LEAST)[:, None]
    n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), LEAST)
    some = slice(None, None, -(-len(n) // SAMPLE))
    # Of (|N|² − 1) / 2: where N is noisy along the shell its square is, more than the distance to it.
    sigma = np.sqrt(np.einsum("pi,ij,pj->p", n[some], V, n[some]) + 0.5 * np.trace(V @ V))
    off = ((N[core][some] ** 2).sum(axis=1) - 1 - np.trace(V)) / 2
    a = fibonacci(DIRECTIONS)
    gain = _gains(n[some], np.clip(off / sigma, -WILD, WILD), sigma, a)
    best = int(np.argmax(gain))
    if gain[best] < CHANCE:
        return None
    out = np.zeros(core.shape, bool)
    out[core] = n @ a[best] < 0
    return out


def _gains(n: np.ndarray, off: np.ndarray, sigma: np.ndarray, a: np.ndarray) -> np.ndarray:
    """χ² (K,) that a missing light in each direction a (K, 3) takes from the distances ``off`` (P,), C fitted with it.

    ``n`` (P, 3) unit, ``off`` in units of ``sigma`` (P,). 0 where too few or too many pixels are beyond. The long sums
    are of single precision, in half the time: χ² is good to 1e-5 of itself.
    """
    by_C = np.linalg.qr(design(n) / sigma[:, None])[0]
    left = off - by_C @ (by_C.T @ off)
    by_c = n * (np.median(sigma) / sigma)[:, None]  # of any scale
    products = (by_c[:, :, None] * by_c[:, None, :]).reshape(-1, 9).astype(np.float32)
    crossed = (by_C[:, :, None] * by_c[:, None, :]).reshape(-1, 18)
    first = np.column_stack([by_c * left[:, None], crossed]).astype(np.float32)
    gain, n, a = np.zeros(len(a)), n.astype(np.float32), a.astype(np.float32)
    for few in range(0, len(a), AT_ONCE):
        depth = np.minimum(n @ a[few : few + AT_ONCE].T, 0.0)  # (P, A)
        share = (depth < 0).mean(axis=0)
        asked = np.flatnonzero((share > BEYOND[0]) & (share < BEYOND[1]))
        if not len(asked):
            continue
        depth = depth[:, asked]
        sums = (depth.T @ first).astype(np.float64)
        right, shared = sums[:, :3], sums[:, 3:].reshape(-1, 6, 3)
        gram = ((depth * depth).T @ products).astype(np.float64).reshape(-1, 3, 3)
        gram -= np.einsum("aki,akj->aij", shared, shared)
        gram += 1e-6 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        gain[few + asked] = np.einsum("ai,ai->a", right, np.linalg.solve(gram, right[..., None])[..., 0])
    return gain * len(n) / max(float((off**2).sum()), float(len(n)))
