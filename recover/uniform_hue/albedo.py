"""What a matrix G makes of the albedo: a = |Gρ|, whose logarithm should spread little, and mostly not change nearby.

Surfaces have few albedos, or albedos that differ little; a wrong G adds shading to the albedo. Two residuals follow,
both of log a: its distance from its mean, and its differences between places a few pixels apart, which are 0 but at
the borders of patches and in texture. Their scales are free: what matters is which G makes them small.
"""

import numpy as np
from scipy import ndimage

STEP_PX = 4  # between two places: more than the reach of the means, less than most patches
MEAN_PX = 3  # side of the squares of pixels whose mean colour is compared: lessens the noise threefold


def neighbouring_colours(rgb: np.ndarray, inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean colours (E, 3) of pairs of places STEP_PX apart in a row or a column, both wholly ``inside`` (H, W)."""
    whole = ndimage.binary_erosion(inside, np.ones((MEAN_PX, MEAN_PX)))
    mean = ndimage.uniform_filter(np.where(inside[..., None], rgb, 0.0), (MEAN_PX, MEAN_PX, 0))
    found: list[list[np.ndarray]] = [[], []]
    for one, other in ((np.s_[:, :-STEP_PX], np.s_[:, STEP_PX:]), (np.s_[:-STEP_PX], np.s_[STEP_PX:])):
        both = whole[one] & whole[other]
        found[0].append(mean[one][both])
        found[1].append(mean[other][both])
    return np.concatenate(found[0]), np.concatenate(found[1])


def log_albedo(colours: np.ndarray, G: np.ndarray, shading: float) -> tuple[np.ndarray, np.ndarray]:
    """(log |Gρ| − s n3² (P,), its derivative (P, 10) by the elements of G in rows and by s) of colours ρ (P, 3).

    s is the ``shading``: the part of brightness that depends on the normal although it is not albedo, as of surfaces
    that are not quite matte. A surface that is taken to be too deep by the factor 1 + s has just that shading for
    albedo.
    """
    found = colours @ G.T
    squared = np.maximum((found * found).sum(axis=1), 1e-300)[:, None]
    frontal = found[:, 2:] ** 2 / squared
    by_found = found / squared
    by_found = by_found * (1 + 2 * shading * frontal) - 2 * shading * frontal * _third(found)
    slope = (by_found[:, :, None] * colours[:, None, :]).reshape(len(colours), 9)
    return 0.5 * np.log(squared[:, 0]) - shading * frontal[:, 0], np.column_stack([slope, -frontal])


def _third(found: np.ndarray) -> np.ndarray:
    """(0, 0, 1/found3) (P, 3)."""
    third = np.where(np.abs(found[:, 2]) > 1e-12, found[:, 2], 1e-12)
    return np.column_stack([np.zeros((len(found), 2)), 1 / third])
