"""Which normals join those of the all-lit pixels without a jump.

A pixel that misses some lights gets its normal by the lights that are left, and a wrong label or a light that does not
exist gives a wrong normal that may explain the colour exactly. But the surface goes on where a shadow begins: from
pixel to pixel its normals turn about as little as they do among the pixels that see every light. So normals that are
reached from those of the all-lit pixels by small turns are confirmed, and patches of normals that are nowhere joined
to them are not (source: this project, research log).
"""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from huesphere.recover.geometry.tangent_uncertainty import DEG
from huesphere.recover.trust.without_result import FEWEST

USUAL_QUANTILE = 0.9  # of the turns between neighbouring all-lit pixels
OVER_USUAL = 2.0  # turns up to this many times as large are no jump
LEAST_JUMP_DEG, MOST_JUMP_DEG = 3.0, 25.0  # bounds of the turn that is a jump
LEAST_ALL_LIT_SHARE = 0.05  # of a patch, for the all-lit pixels in it to be no chance


def joined_to(all_lit: np.ndarray, normals: np.ndarray, given: np.ndarray) -> np.ndarray:
    """Pixels (H, W) of ``given`` whose normals join those of the ``all_lit`` (H, W) ones by steps without a jump.

    ``normals`` (H, W, 3): unit vectors, where ``given``. Neighbours are the four next pixels. Without FEWEST all-lit
    pixels nothing can be told, and all of ``given`` is returned.
    """
    lit = all_lit & given
    if lit.sum() < FEWEST:
        return given.copy()
    number = np.full(given.shape, -1)
    number[given] = np.arange(int(given.sum()))
    pairs, turn = _neighbours(number, normals)
    is_lit = lit[given]
    both_lit = is_lit[pairs].all(axis=0)
    if not both_lit.any():
        return given.copy()
    jump = np.clip(OVER_USUAL * np.quantile(turn[both_lit], USUAL_QUANTILE), LEAST_JUMP_DEG, MOST_JUMP_DEG)
    i, j = pairs[:, turn <= jump]
    count = int(given.sum())
    _, patch = connected_components(coo_array((np.ones(len(i)), (i, j)), shape=(count, count)), directed=False)
    pixels, of_them_lit = np.bincount(patch), np.bincount(patch, weights=is_lit)
    joined = given.copy()
    joined[given] = is_lit | (of_them_lit >= np.maximum(LEAST_ALL_LIT_SHARE * pixels, 1))[patch]
    return joined


def _neighbours(number: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(pairs (2, E) of neighbouring pixels by their ``number`` (H, W), −1 where there is none; turns (E,), degrees)."""
    pairs, turns = [], []
    for one, other in (((..., slice(None, -1)), (..., slice(1, None))), ((slice(None, -1),), (slice(1, None),))):
        both = (number[one] >= 0) & (number[other] >= 0)
        pairs.append(np.stack([number[one][both], number[other][both]]))
        shifted = (normals[:, :-1], normals[:, 1:]) if one[0] is ... else (normals[:-1], normals[1:])
        turns.append(np.arccos(np.clip((shifted[0][both] * shifted[1][both]).sum(axis=-1), -1, 1)) * DEG)
    return np.concatenate(pairs, axis=1), np.concatenate(turns)
