"""Which pixels of a chosen shell see every light, and not only lie on it: a probability for each.

Half of those that a cut on means of neighbours accepts may miss a light by less than noise, and of a rough surface it
leaves out half of those that see all. What tells: pixels that face the same way miss the same lights wherever they are
in the picture, so that on a pure part of the shell their distances scatter by the noise and no more; and so do those of
neighbours, most of which are on the shell too. A logistic regression weighs these, fitted to pixels of random scenes by
`benchmarks/recover_all_lit.py`; all of it is in units of the noise, of shares and of angles, not of one picture.
"""

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from recover.polish import signed_distance
from recover.root import symmetric_root
from recover.sphere import fibonacci

LIKELY = 0.5  # probability from which a pixel is taken to see every light
REACH = 4.5  # standard deviations of the distance: beyond, a pixel is not on the shell
DIRECTIONS, ALIKE = 800, np.radians(4.0)  # normals that are told apart, and the Gaussian under which they are alike
CALM, LEAST_REACH = 0.035, 0.5  # radians, to which a direction is to be known; pixels, a Gaussian worth averaging under
EVIDENCE = {  # and what each weighs
    "scatter of those that face alike": -2.116,
    "share in the core of those that face alike": 1.401,
    "share on the shell of those that face alike": -1.091,
    "scatter of neighbours": -1.323,
    "mean distance of neighbours": -0.107,
    "share on the shell of nearest neighbours": 4.489,
    "share on the shell of neighbours farther off": -4.471,
    "share in the core of neighbours": 1.309,
    "share in the core of neighbours farther off": 0.605,
}
OFFSET = 4.531


def all_lit_probability(
    rgb: np.ndarray, usable: np.ndarray, core: np.ndarray, C: np.ndarray, *, noise: float
) -> np.ndarray:
    """Probability (H, W) that a pixel of ``rgb`` (H, W, 3) sees every light; 0 off the shell C (3, 3).

    ``usable`` (H, W), ``core`` (H, W) its pixels as far as they are known, ``noise`` the standard deviation of the
    distance to it, picture units.
    """
    on, seen = evidence(rgb, usable, core, C, noise=noise)
    probability = np.zeros(usable.shape)
    probability[on] = 1 / (1 + np.exp(-(seen @ np.array(list(EVIDENCE.values())) + OFFSET)))
    return probability


def evidence(
    rgb: np.ndarray, usable: np.ndarray, core: np.ndarray, C: np.ndarray, *, noise: float
) -> tuple[np.ndarray, np.ndarray]:
    """(pixels on the shell (H, W), what EVIDENCE names of each of them (P, 9), in that order)."""
    distance = np.zeros(usable.shape)
    distance[usable] = signed_distance(rgb[usable], C) / noise
    on = usable & (np.abs(distance) < REACH)
    distance[~on] = 0.0

    directions = fibonacci(DIRECTIONS)
    facing = np.zeros(usable.shape, int)
    facing[usable] = cKDTree(directions).query(_directions(rgb, usable, on, C, noise))[1]
    alike = np.exp((directions @ directions.T - 1) / ALIKE**2)

    def facing_alike(which: np.ndarray, value: np.ndarray | None = None) -> np.ndarray:
        weights = None if value is None else value[which]
        return (alike @ np.bincount(facing[which], weights, DIRECTIONS))[facing[on]]  # type: ignore[no-any-return]

    def about(image: np.ndarray, side: int) -> np.ndarray:
        return ndimage.uniform_filter(image, side, mode="constant")[on] * side**2  # type: ignore[no-any-return]

    on_alike, near = facing_alike(on), about(on.astype(float), 5)
    squared, whole, inside, own = distance**2, usable.astype(float), on.astype(float), (core & on).astype(float)
    seen = [
        np.sqrt(facing_alike(on, squared) / on_alike),
        facing_alike(core & on) / on_alike,
        on_alike / facing_alike(usable),
        np.sqrt(np.maximum(about(squared, 5), 0.0) / near),
        np.abs(about(distance, 5)) / np.sqrt(near),
        about(inside, 3) / about(whole, 3),
        about(inside, 9) / about(whole, 9),
        about(own, 5) / near,
        about(own, 9) / about(inside, 9),
    ]
    return on, np.stack(seen, axis=-1)


def _directions(rgb: np.ndarray, usable: np.ndarray, on: np.ndarray, C: np.ndarray, noise: float) -> np.ndarray:
    """C^{1/2}ρ (P, 3) of the ``usable`` pixels, unit; those ``on`` the shell averaged until they are known to CALM."""
    G = symmetric_root(C)
    N = rgb @ G
    spread = noise * np.linalg.norm(G) / np.sqrt(3)
    if (pixels := spread / (2 * np.sqrt(np.pi) * CALM)) > LEAST_REACH:
        weight = np.maximum(ndimage.gaussian_filter(on.astype(float), pixels), 1e-9)
        mean = ndimage.gaussian_filter(np.where(on[..., None], N, 0.0), (pixels, pixels, 0))
        N = np.where(on[..., None], mean / weight[..., None], N)
    N = N[usable]
    return N / np.linalg.norm(N, axis=1, keepdims=True)  # type: ignore[no-any-return]
