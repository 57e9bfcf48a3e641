"""Which pixels on a chosen ellipsoid see every light, and do not only lie on it: a probability for each pixel.

Half of the pixels that a cut on means of neighbours accepts may miss a light by less than noise, and on a rough surface
the cut rejects half of those that see every light. Two things tell more. Pixels with alike normals miss the same lights
wherever they are in the picture: where all of them see every light, their distances to the ellipsoid scatter by the
noise alone. And neighbours of a pixel that sees every light mostly do so too. A logistic regression weighs this
evidence; its weights are in ``membership_weights.json``, with the script that fitted them to random scenes. All
evidence is in units of the noise, of shares and of angles, so that it does not depend on one picture.
"""

from functools import cache

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from huesphere.recover.ellipsoid.distance import signed_distance
from huesphere.recover.ellipsoid.parameters import ELLIPSOID
from huesphere.recover.geometry.root import symmetric_root
from huesphere.recover.geometry.sphere import fibonacci
from huesphere.recover.parameters import learned

MEMBERSHIP_LEAST_SHARE = 0.3  # A pass that calls fewer pixels likely is discarded (share of the inliers before).

LIKELY = 0.5  # probability from which a pixel is taken to see every light: then that is more likely than not
DIRECTIONS = 800  # classes of normals, 7° apart, for the comparison of pixels with alike normals
LEAST_BLUR_PX = 0.5  # a narrower Gaussian leaves an image of pixels as it is


def all_lit_pixels(
    rgb: np.ndarray, usable: np.ndarray, C: np.ndarray, inlier: np.ndarray, *, noise: float
) -> tuple[np.ndarray, float]:
    """(pixels (H, W) that see every light, their mean probability), from the first guess ``inlier`` (H, W).

    Other arguments as for ``Membership``. The first guess itself, with probability 0, where too few pixels are likely.
    """
    membership, probability = Membership(rgb, usable, C, noise=noise), np.zeros(usable.shape)
    for _ in range(ELLIPSOID.membership_passes):
        new = membership.probability(inlier)
        if (new > LIKELY).sum() < MEMBERSHIP_LEAST_SHARE * inlier.sum():
            break
        inlier, probability = new > LIKELY, new
    return inlier, float(probability[inlier].mean())


class Membership:
    """The pixels that lie on an ellipsoid, and for each the probability that it sees every light.

    What does not depend on the inliers is computed once.
    """

    def __init__(self, rgb: np.ndarray, usable: np.ndarray, C: np.ndarray, *, noise: float) -> None:
        """Of the ``usable`` (H, W) pixels of ``rgb`` (H, W, 3) and the ellipsoid C (3, 3), picture units.

        ``noise``: standard deviation of the distance to C, picture units.
        """
        distance = np.zeros(usable.shape)
        distance[usable] = signed_distance(rgb[usable], C) / noise
        self.on = usable & (np.abs(distance) < ELLIPSOID.single_distance_cut)  # (H, W) lies on the ellipsoid
        distance[~self.on] = 0.0

        nearest, self._alike = _direction_classes(ELLIPSOID.alike_deg)
        self._class = np.zeros(usable.shape, int)  # (H, W) class of the direction of the normal
        self._class[usable] = nearest.query(_directions(rgb, usable, self.on, C, noise))[1]

        nearest_px, near_px, far_px = ELLIPSOID.membership_windows_px
        squared, whole, inside = distance**2, usable.astype(float), self.on.astype(float)
        self._on_alike = self._over_alike(self.on)
        self._on_near, self._on_far = self._over_window(inside, near_px), self._over_window(inside, far_px)
        self._evidence_without_inliers = [
            np.sqrt(self._over_alike(self.on, squared) / self._on_alike),
            self._on_alike / self._over_alike(usable),
            np.sqrt(np.maximum(self._over_window(squared, near_px), 0.0) / self._on_near),
            np.abs(self._over_window(distance, near_px)) / np.sqrt(self._on_near),
            self._over_window(inside, nearest_px) / self._over_window(whole, nearest_px),
            self._on_far / self._over_window(whole, far_px),
        ]

    def evidence(self, inlier: np.ndarray) -> np.ndarray:
        """The evidence that ``learned_weights`` names, in its order, for each pixel on the ellipsoid, (P, 9).

        ``inlier`` (H, W): the pixels that are taken to see every light so far.
        """
        own = inlier & self.on
        image = own.astype(float)
        _, near_px, far_px = ELLIPSOID.membership_windows_px
        of_inliers = [
            self._over_alike(own) / self._on_alike,
            self._over_window(image, near_px) / self._on_near,
            self._over_window(image, far_px) / self._on_far,
        ]
        return np.stack([*self._evidence_without_inliers, *of_inliers], axis=-1)

    def probability(self, inlier: np.ndarray) -> np.ndarray:
        """Probability (H, W) that a pixel sees every light; 0 off the ellipsoid. ``inlier`` as for ``evidence``."""
        weights, offset = learned_weights()
        probability = np.zeros(self.on.shape)
        score = self.evidence(inlier) @ np.array(list(weights.values())) + offset
        probability[self.on] = 1 / (1 + np.exp(-score))
        return probability

    def _over_alike(self, which: np.ndarray, value: np.ndarray | None = None) -> np.ndarray:
        """Sum (P,) of ``value`` (H, W), or of 1, over the pixels ``which`` with normals alike to each pixel's."""
        weights = None if value is None else value[which]
        return (self._alike @ np.bincount(self._class[which], weights, DIRECTIONS))[self._class[self.on]]  # type: ignore[no-any-return]

    def _over_window(self, image: np.ndarray, side: int) -> np.ndarray:
        """Sum (P,) of ``image`` (H, W) over the square about each pixel on the ellipsoid."""
        return ndimage.uniform_filter(image, side, mode="constant")[self.on] * side**2  # type: ignore[no-any-return]


def learned_weights() -> tuple[dict[str, float], float]:
    """(weight of each piece of evidence, offset) of the logistic regression."""
    found = learned("ellipsoid/membership_weights.json")
    return found["weights"], found["offset"]


@cache
def _direction_classes(width_deg: float) -> tuple[cKDTree, np.ndarray]:
    """(search for the class of a direction, (D, D) how alike each two classes are under a kernel of that width)."""
    directions = fibonacci(DIRECTIONS)
    return cKDTree(directions), np.exp((directions @ directions.T - 1) / np.radians(width_deg) ** 2)


def _directions(rgb: np.ndarray, usable: np.ndarray, on: np.ndarray, C: np.ndarray, noise: float) -> np.ndarray:
    """Unit C^{1/2}ρ (P, 3) of the ``usable`` pixels: normals up to one rotation.

    Pixels ``on`` (H, W) the ellipsoid are averaged over neighbours until the direction is known to
    ``direction_noise_rad``.
    """
    G = symmetric_root(C)
    N = rgb @ G
    spread = noise * np.linalg.norm(G) / np.sqrt(3)
    blur = spread / (2 * np.sqrt(np.pi) * ELLIPSOID.direction_noise_rad)  # pixels: of the Gaussian that is needed
    if blur > LEAST_BLUR_PX:
        weight = np.maximum(ndimage.gaussian_filter(on.astype(float), blur), 1e-9)
        mean = ndimage.gaussian_filter(np.where(on[..., None], N, 0.0), (blur, blur, 0))
        N = np.where(on[..., None], mean / weight[..., None], N)
    N = N[usable]
    return N / np.linalg.norm(N, axis=1, keepdims=True)  # type: ignore[no-any-return]
