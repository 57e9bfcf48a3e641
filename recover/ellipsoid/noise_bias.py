"""Normal equations of the ellipsoid without the bias that the camera's noise gives them.

Noise enters the design matrix M squared, so plain least squares is biased however many pixels there are: under natural
lights the bias turns normals by a degree at noise 1e-3. The sums in the normal equations have a known expectation under
Gaussian noise. Subtracting what noise adds to it makes the fit consistent: A. Kukush, I. Markovsky & S. Van Huffel,
"Consistent estimation in an implicit quadratic measurement error model", Computational Statistics & Data Analysis 47
(2004).
"""

import numpy as np

from huesphere.recover.geometry.quadratic import FACTOR, MONOMIALS


def without_noise(gram: np.ndarray, right: np.ndarray, count: int, V: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(MᵀM (6, 6), Mᵀ1 (6,)) with the expectation that noise adds to them subtracted.

    ``gram``, ``right``: the sums over ``count`` noisy colours, in any units; V (3, 3): covariance of the noise of a
    colour, in the square of these units. With y = x + e, e ~ N(0, V): E y_i y_j = x_i x_j + V_ij, and to a product of
    four Isserlis' theorem adds V times the second moments over the six pairs, and V V over the three pairings. The
    choice of the colours must not depend on their residuals, or the expectation is another.
    """
    i, j = (np.array(index) for index in zip(*MONOMIALS))
    second = np.zeros((3, 3))
    second[i, j] = second[j, i] = right / FACTOR / count - V[i, j]
    i, j, k, l = i[:, None], j[:, None], i[None], j[None]
    pairs = (
        V[i, j] * second[k, l] + V[k, l] * second[i, j]
        + V[i, k] * second[j, l] + V[j, l] * second[i, k]
        + V[i, l] * second[j, k] + V[j, k] * second[i, l]
    )  # fmt: skip
    pairings = V[i, j] * V[k, l] + V[i, k] * V[j, l] + V[i, l] * V[j, k]
    rows, columns = (np.array(index) for index in zip(*MONOMIALS))
    return gram - count * FACTOR[:, None] * FACTOR * (pairs + pairings), right - count * FACTOR * V[rows, columns]
