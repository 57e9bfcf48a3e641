"""Which lights each pixel misses, as far as the lights found so far explain it: the regions that a search starts from.

A pixel that misses the lights of a set S has the colour F_S n, F_S = F − Σ_S b aᵀ. Any set may occur, and with nine
lights there are 512 of them; but next to a pixel that misses S lies, mostly, one that misses one light more or less.
So sets are tried that differ by one light from a set that occurs, beginning with the empty one and with all pairs.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from huesphere.recover.geometry.sphere import on_sphere
from huesphere.recover.lights.model import Light, without

FEWEST_PIXELS = 8  # pixels that a set must explain to occur: fewer may be chance
MOST_SETS = 300  # bounds the work
FACING_SLACK = 0.03  # cosine: a light that a pixel sees may be so far behind it, for the errors of both
COST_OF_MISSED = 0.05  # tolerances: breaks ties, of two sets that explain a colour as well the smaller is taken
FLATTEST = 1e-4  # second over first singular value of F_S: of a flatter one every colour of a line fits some normal


@dataclass
class ShadowRegions:
    """The set of lights that each pixel (P,) misses, its normal under the others, and how well it is explained.

    Grows with the lights: ``add`` is to be called for each light in turn.
    """

    rho: np.ndarray  # (P, 3) colours, picture units
    F: np.ndarray  # (3, 3)
    tolerance: float  # distance, picture units, within which a colour is explained
    lights: tuple[Light, ...]
    sets: list[tuple[int, ...]]  # that occur, the numbers of their lights in ascending order; the empty one first
    label: np.ndarray  # (P,) number of the pixel's set; −1: no set explains it
    normals: np.ndarray  # (P, 3) unit
    cost: np.ndarray  # (P,) of the label: distance in tolerances, and a little for each missed light
    distance: np.ndarray  # (P,) to the nearest ellipsoid of a set that is possible there, picture units

    @staticmethod
    def of_core(rho: np.ndarray, inlier: np.ndarray, F: np.ndarray, tolerance: float) -> "ShadowRegions":
        """The regions before any light is known. ``inlier`` (P,): pixels that are taken to see every light."""
        normals, distance = on_sphere(rho, F)
        label = np.where(inlier | (distance < tolerance), 0, -1)
        cost = np.where(inlier, 0.0, distance / tolerance)
        return ShadowRegions(rho, F, tolerance, (), [()], label, normals, cost, distance)

    @property
    def unexplained(self) -> np.ndarray:
        """Pixels (P,) that no set explains."""
        return self.label < 0  # type: ignore[no-any-return]

    def with_lights(self, lights: tuple[Light, ...], inlier: np.ndarray) -> "ShadowRegions":
        """The regions by other ``lights`` of the same picture."""
        out = ShadowRegions.of_core(self.rho, inlier, self.F, self.tolerance)
        for light in lights:
            out.add(light, inlier)
        return out

    def add(self, light: Light, inlier: np.ndarray) -> None:
        """Label the pixels that are not inliers (``inlier`` (P,)) anew, with one more light."""
        self.lights = (*self.lights, light)
        newest = len(self.lights) - 1
        open_ = np.flatnonzero(~inlier)
        tried = set(self.sets)
        waiting = [tuple(sorted((*one, newest))) for one in self.sets]
        waiting += [(newest,)] + [tuple(sorted(pair)) for pair in combinations(range(len(self.lights)), 2)]
        while waiting and len(tried) < MOST_SETS:
            missed = waiting.pop(0)
            if missed in tried:
                continue
            tried.add(missed)
            if self._try(missed, open_) < FEWEST_PIXELS:
                continue
            every = range(len(self.lights))
            waiting += [tuple(sorted((*missed, j))) for j in every if j not in missed]
            waiting += [tuple(k for k in missed if k != j) for j in missed]

    def _try(self, missed: tuple[int, ...], open_: np.ndarray) -> int:
        """Give the ``open_`` pixels this set where it is the best so far; how many it explains best."""
        M = without(self.F, self.lights, missed)
        values = np.linalg.svd(M)[1]
        if values[1] < FLATTEST * np.linalg.norm(self.F):
            return 0
        n, distance = on_sphere(self.rho[open_], M)
        seen = [j for j in range(len(self.lights)) if j not in missed]
        toward = np.array([self.lights[j].direction for j in seen]).reshape(-1, 3)
        possible = (n @ toward.T > -FACING_SLACK).all(axis=1) & (n[:, 2] > -FACING_SLACK)
        self.distance[open_] = np.minimum(self.distance[open_], np.where(possible, distance, np.inf))
        cost = distance / self.tolerance + COST_OF_MISSED * len(missed)
        better = possible & (distance < self.tolerance) & ((self.label[open_] < 0) | (cost < self.cost[open_]))
        if better.sum() < FEWEST_PIXELS:
            return int(better.sum())
        own = open_[better]
        self.sets.append(missed)
        self.label[own], self.normals[own], self.cost[own] = len(self.sets) - 1, n[better], cost[better]
        return len(own)


def sheets(rho: np.ndarray, M: np.ndarray, n: np.ndarray, tolerance: float) -> list[np.ndarray]:
    """The nearest normals ``n`` (P, 3) under M, and the same on either side of an ellipsoid that is nearly flat.

    Where the mirrored normal has the colour ``rho`` (P, 3) to within the ``tolerance`` too, the colour does not tell
    which of the two it is; those of a small smooth region are mostly on one side.
    """
    across = np.linalg.svd(M)[2][2]
    component = n @ across
    mirrored = n - 2 * component[:, None] * across
    either = np.linalg.norm(rho - mirrored @ M.T, axis=1) < tolerance
    return [n] + [np.where((either & (np.sign(component) != side))[:, None], mirrored, n) for side in (1.0, -1.0)]
