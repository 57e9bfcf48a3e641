"""Which pixels of a chosen shell see every light, and not only lie on it: a probability for each.

Half of those that a cut on means of neighbours accepts may miss a light by less than noise, and of a rough surface it
leaves out half of those that see all. What tells: pixels that face the same way miss the same lights wherever they are
in the picture, so that on a pure part of the shell their distances scatter by the noise and no more; and so do those of
neighbours, most of which are on the shell too. A logistic regression weighs these, fitted to pixels of random scenes by
`benchmarks/recover_all_lit.py`; all of it is in units of the noise, of shares and of angles, not of one picture.
"""

from functools import cache

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from huesphere.recover.ellipsoid.distance import signed_distance
from huesphere.recover.geometry.root import symmetric_root
from huesphere.recover.geometry.sphere import fibonacci

LIKELY = 0.5  # probability from which a pixel is taken to see every light
LOOKS, LEAST_LIKELY = 2, 0.3  # looks at which pixels do; how many they must be, of the core
REACH = 4.5  # standard deviations of the distance: beyond, a pixel is not on the shell
DIRECTIONS, ALIKE = 800, np.radians(4.0)  # normals that are told apart, and the Gaussian under which they are alike
CALM, LEAST_REACH = 0.035, 0.5  # radians, to which a direction is to be known; pixels, a Gaussian worth averaging under
EVIDENCE = {  # and what each weighs
    "scatter of those that face alike": -2.116,
    "share on the shell of those that face alike": -1.091,
    "scatter of neighbours": -1.323,
    "mean distance of neighbours": -0.107,
    "share on the shell of nearest neighbours": 4.489,
    "share on the shell of neighbours farther off": -4.471,
    "share in the core of those that face alike": 1.401,
    "share in the core of neighbours": 1.309,
    "share in the core of neighbours farther off": 0.605,
}
OFFSET = 4.531


def all_lit_pixels(
    rgb: np.ndarray, usable: np.ndarray, C: np.ndarray, core: np.ndarray, *, noise: float
) -> tuple[np.ndarray, float]:
    """(pixels (H, W) that see every light, their mean probability), from the ``core`` (H, W) by looks at all on C.

    As for ``OnShell``; the core itself, with probability 0, where too few are likely.
    """
    shell, probability = OnShell(rgb, usable, C, noise=noise), np.zeros(usable.shape)
    for _ in range(LOOKS):
        new = shell.probability(core)
        if (new > LIKELY).sum() < LEAST_LIKELY * core.sum():
            break
        core, probability = new > LIKELY, new
    return core, float(probability[core].mean())


class OnShell:
    """The pixels on a shell C (3, 3) of the picture ``rgb`` (H, W, 3), and how likely each of them sees every light.

    ``usable`` (H, W), ``noise`` the standard deviation of the distance to C, picture units. What does not hang on the
    core is made once.
    """

    def __init__(self, rgb: np.ndarray, usable: np.ndarray, C: np.ndarray, *, noise: float) -> None:
        distance = np.zeros(usable.shape)
        distance[usable] = signed_distance(rgb[usable], C) / noise
        self.on = usable & (np.abs(distance) < REACH)  # (H, W)
        distance[~self.on] = 0.0

        nearest, self._alike = _told_apart()
        self._facing = np.zeros(usable.shape, int)
        self._facing[usable] = nearest.query(_directions(rgb, usable, self.on, C, noise))[1]

        squared, whole, inside = distance**2, usable.astype(float), self.on.astype(float)
        self._on_alike, self._near, self._farther = (
            self._facing_alike(self.on),
            self._about(inside, 5),
            self._about(inside, 9),
        )
        self._of_all = [
            np.sqrt(self._facing_alike(self.on, squared) / self._on_alike),
            self._on_alike / self._facing_alike(usable),
            np.sqrt(np.maximum(self._about(squared, 5), 0.0) / self._near),
            np.abs(self._about(distance, 5)) / np.sqrt(self._near),
            self._about(inside, 3) / self._about(whole, 3),
            self._farther / self._about(whole, 9),
        ]

    def evidence(self, core: np.ndarray) -> np.ndarray:
        """What EVIDENCE names of each pixel on the shell (P, 9), in that order; ``core`` (H, W): its own, so far."""
        own = core & self.on
        image = own.astype(float)
        of_core = [
            self._facing_alike(own) / self._on_alike,
            self._about(image, 5) / self._near,
            self._about(image, 9) / self._farther,
        ]
        return np.stack([*self._of_all, *of_core], axis=-1)

    def probability(self, core: np.ndarray) -> np.ndarray:
        """Probability (H, W) that a pixel sees every light; 0 off the shell. ``core`` as for ``evidence``."""
        probability = np.zeros(self.on.shape)
        score = self.evidence(core) @ np.array(list(EVIDENCE.values())) + OFFSET
        probability[self.on] = 1 / (1 + np.exp(-score))
        return probability

    def _facing_alike(self, which: np.ndarray, value: np.ndarray | None = None) -> np.ndarray:
        weights = None if value is None else value[which]
        return (self._alike @ np.bincount(self._facing[which], weights, DIRECTIONS))[self._facing[self.on]]  # type: ignore[no-any-return]

    def _about(self, image: np.ndarray, side: int) -> np.ndarray:
        return ndimage.uniform_filter(image, side, mode="constant")[self.on] * side**2  # type: ignore[no-any-return]


@cache
def _told_apart() -> tuple[cKDTree, np.ndarray]:
    """(search for the nearest of the DIRECTIONS, how much each two of them are alike (D, D))."""
    directions = fibonacci(DIRECTIONS)
    return cKDTree(directions), np.exp((directions @ directions.T - 1) / ALIKE**2)


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
