"""Which normals join those of the all-lit pixels without a jump.

A pixel that misses some lights gets its normal by the lights that are left, and a wrong label or a light that does not
exist gives a wrong normal that may explain the colour exactly. But the surface goes on where a shadow begins: from
pixel to pixel its normals turn about as little as they do among the pixels that see every light. So normals that are
reached from those of the all-lit pixels by small turns are confirmed, and patches of normals that are nowhere joined
to them are not (source: this project, research log).
"""

import numpy as np

from huesphere.recover.geometry.neighbours import components, edges_within
from huesphere.recover.geometry.tangent_uncertainty import DEG
from huesphere.recover.trust.without_result import FEWEST

USUAL_QUANTILE = 0.9  # of the turns between neighbouring all-lit pixels
OVER_USUAL = 2.0  # turns up to this many times as large are no jump
LEAST_JUMP_DEG, MOST_JUMP_DEG = 3.0, 25.0  # bounds of the turn that is a jump
LEAST_ALL_LIT_SHARE = 0.05  # of a patch of joined pixels: with a smaller share, all-lit ones may be in it by chance


def joined_to(all_lit: np.ndarray, normals: np.ndarray, given: np.ndarray) -> np.ndarray:
    """Pixels (H, W) of ``given`` whose normals join those of the ``all_lit`` (H, W) ones by steps without a jump.

    ``normals`` (H, W, 3): unit vectors, where ``given``. Neighbours are the four next pixels. Without FEWEST all-lit
    pixels nothing can be told, and all of ``given`` is returned.
    """
    lit = all_lit & given
    if lit.sum() < FEWEST:
        return given.copy()
    edges, unit, is_lit = edges_within(given), normals[given], lit[given]
    turn = np.arccos(np.clip((unit[edges.i] * unit[edges.j]).sum(axis=-1), -1, 1)) * DEG
    both_lit = is_lit[edges.i] & is_lit[edges.j]
    if not both_lit.any():
        return given.copy()
    jump = np.clip(OVER_USUAL * np.quantile(turn[both_lit], USUAL_QUANTILE), LEAST_JUMP_DEG, MOST_JUMP_DEG)
    patch = components(edges, len(unit), turn <= jump)
    pixels, of_them_lit = np.bincount(patch), np.bincount(patch, weights=is_lit)
    joined = given.copy()
    joined[given] = is_lit | (of_them_lit >= np.maximum(LEAST_ALL_LIT_SHARE * pixels, 1))[patch]
    return joined
