"""What the two fits of light and depth over blocks of pixels share: ``bundle_adjustment`` and ``irradiance_map``.

Both have one depth at each corner of the blocks, and some unknowns x of the lights. A Gauss–Newton step solves
W δs + B δx = g, Bᵀ δs + H δx = h for the slopes s of the blocks and for x. W is 2×2 for each block, and δs must be the
slopes of a depth.
"""

from typing import NamedTuple

import numpy as np

from huesphere.recover.geometry.depth_grid import DepthGrid
from huesphere.recover.geometry.least_squares import Schedule

WHOLE_BLOCK = 0.95  # share of a block from which all of it counts as lit by all lights, or as seen
NEXT_TO_NOTHING = 1e-4  # weight of a block whose colour is not to be trusted: its slope is that of its neighbours
OF_DEPTH = 1e-2  # share of the damping that goes to depths
LEAST = 1e-7  # of the largest weight of a slope: holds slopes that no colour determines
DESCENT = Schedule(first_damping=1e-3, most_steps=25, trials=6, relative_gain=1e-3, least_raised=1e-2)

Equations = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # W, g, H, h, B, as above


class Eliminated(NamedTuple):
    """The equations of the lights alone, and what the slopes are then."""

    S: np.ndarray  # (K, K) Schur complement
    s: np.ndarray  # (K,) its right side
    own: np.ndarray  # (P, 2) step of the slopes with the lights held
    by_lights: np.ndarray  # (P, 2, K) derivative of that step by the lights' unknowns


def block_size(mask: np.ndarray, most: int) -> int:
    """Side of the blocks, pixels, with which about ``most`` of them cover ``mask`` (H, W)."""
    return max(1, int(np.ceil(np.sqrt(mask.sum() / most))))


def share_of_blocks(which: np.ndarray, mask: np.ndarray, block: int) -> np.ndarray:
    """The share of each block's pixels on the object (P,) that are in ``which`` (H, W)."""
    return DepthGrid((which & mask)[..., None].astype(float), mask, block).mean[:, 0]


def without_depth(cells: DepthGrid, equations: Equations, damping: float) -> Eliminated:
    """The equations with the depth eliminated; raises LinAlgError where they break down."""
    W, g, H, h, between = equations
    least = LEAST * float(W.max())
    factors = cells.factor(W[:, 0, 0] + least, W[:, 0, 1], W[:, 1, 1] + least, damping=damping * OF_DEPTH)
    moves = cells.solve(factors, np.concatenate([g[..., None], between], axis=-1))
    own, by_lights = moves[..., 0], moves[..., 1:]
    S = H - np.einsum("pdk,pdl->kl", between, by_lights, optimize=True)
    return Eliminated(S, h - np.einsum("pdk,pd->k", between, own), own, by_lights)
