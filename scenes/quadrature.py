"""Points that cover the unit square evenly: the sampling pattern of all integrals in scenes and render."""

import numpy as np

GOLDEN = 0.6180339887498949  # fractional part of the golden ratio


def fibonacci_lattice(count: int) -> np.ndarray:
    """``count`` points (j + ½)/S, frac(j·golden ratio) in the unit square, shape (S, 2).

    Rotated modulo 1 by a random vector at each place of use (Cranley–Patterson), and mapped to the hemisphere by
    sin²θ = u, φ = 2πv, its error on interreflection falls like S^−0.76; random points give S^−0.5.
    """
    j = np.arange(count)
    return np.stack([(j + 0.5) / count, np.modf(j * GOLDEN)[0]], axis=1)
