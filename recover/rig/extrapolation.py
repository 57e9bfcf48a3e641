"""How much less F(x) is known far from the balls than at the balls that were left out of the calibration.

The variance of a linear regression on (1, x, y) grows with the leverage h(u) = t(u)ᵀ M⁻¹ t(u) of a position u,
t = (1, x, y), M the mean of t tᵀ over the pixels of the balls (D. A. Belsley, E. Kuh and R. E. Welsch, "Regression
Diagnostics", 1980, section 2.1). A rig's stated error was measured at balls that were left out, each at its leverage by
the others. Where a position has more than these (their median), the RMS error is taken to grow with √h; with h where F
is quadratic.
"""

from collections.abc import Sequence

import numpy as np

Place = tuple[
    float, float, float
]  # x, y, radius of a ball; positions and lengths as of ``recover.rig.model.positions``

FEWEST_PLACES = 3  # fewer do not show how F depends on position at all


def growth(places: Sequence[Place], order: int, position: np.ndarray) -> np.ndarray:
    """Factor (...) ≥ 1 of the RMS error at ``position`` (..., 2) by an F of ``order``; 1 for fewer than three balls.

    >>> places = [(-0.5, -0.4, 0.1), (0.5, -0.4, 0.1), (-0.5, 0.4, 0.1), (0.5, 0.4, 0.1), (0.0, 0.0, 0.1)]
    >>> np.round(growth(places, 1, np.array([[0.0, 0.0], [0.5, 0.4], [2.0, 0.0]])), 2).tolist()
    [1.0, 1.0, 1.51]
    """
    if len(places) < FEWEST_PLACES:
        return np.ones(position.shape[:-1])
    balls = np.array(places, float)
    left_out = [leverage(np.delete(balls, number, axis=0), ball[None, :2])[0] for number, ball in enumerate(balls)]
    relative = leverage(balls, position) / float(np.median(left_out))
    return np.asarray(np.maximum(relative, 1.0) ** (max(order, 1) / 2))


def leverage(balls: np.ndarray, position: np.ndarray) -> np.ndarray:
    """h (...) at ``position`` (..., 2) of balls (B, 3): x, y, radius. A disc of radius r has the variance r²/4."""
    t = np.column_stack([np.ones(len(balls)), balls[:, :2]])
    M = t.T @ t / len(balls) + np.diag([0.0, 1.0, 1.0]) * np.mean(balls[:, 2] ** 2) / 4
    at = np.concatenate([np.ones((*position.shape[:-1], 1)), position], axis=-1)
    return np.asarray(np.einsum("...i,ij,...j->...", at, np.linalg.inv(M), at))
