"""A light fitted to the pixels that miss it as exactly as their colours allow: damped least squares to noise level.

Under lights of similar colours the ellipsoid is flat, and a light can slide along a valley in which residuals hardly
change. Undamped steps with a fixed ridge stop there, degrees away. Here each unknown is scaled by its own derivative
(J. J. Moré, "The Levenberg–Marquardt algorithm", 1978), and the width of Cauchy's loss is narrowed tenfold from round
to round, down to the noise, so that pixels that miss other lights drop out by the way.
"""

import numba
import numpy as np

from huesphere.recover.geometry.sphere import nearest_normals
from huesphere.recover.lights.missed_light import add_equation, cofactors, matrix_without

NARROWING = 0.1  # by which the loss gets narrower from round to round
STEPS = 15  # of each round, at most
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-6, 1e-13, 1e3  # relative to the diagonal of H
MORE, LESS = 8.0, 0.2  # factors of the damping after a step that raised the loss, and after one that lowered it
LEAST_GAIN = 1e-4  # relative, of the cost, below which a round ends
FAR = 30.0  # widths: farther colours count in the loss, but not in the equations of a step


def polished(rho: np.ndarray, base: np.ndarray, start: np.ndarray, coarse: float, fine: float) -> np.ndarray:
    """The light (b, a) (6,) reached from ``start`` (6,), fitted to those colours ``rho`` (P, 3) that it explains.

    ``base`` (3, 3), picture units: the matrix that these pixels would have if they saw this light, so that their
    colours are (base − b aᵀ) n. The width of the loss shrinks from ``coarse`` to ``fine``, picture units.
    """
    return polished_beside(rho, base[None], np.array([0, len(rho)]), start, coarse, fine)


def polished_beside(
    rho: np.ndarray, bases: np.ndarray, ends: np.ndarray, start: np.ndarray, coarse: float, fine: float
) -> np.ndarray:
    """As ``polished``, for pixels that miss different other lights.

    Colours ``ends[g]`` to ``ends[g + 1]`` of ``rho`` (P, 3) would have the matrix ``bases[g]``, of (G, 3, 3), if they
    saw this light.
    """
    both = start.copy()
    width = max(coarse, fine)
    while True:
        _descend(rho, bases, ends, both, width)
        if width <= fine:
            return both
        width = max(fine, NARROWING * width)


def loss_beside(rho: np.ndarray, bases: np.ndarray, ends: np.ndarray, both: np.ndarray, width: float) -> float:
    """The mean over P colours of Cauchy's loss ln(1 + (d / ``width``)²) if they miss the light ``both`` (6,).

    d is the distance of a colour to the ellipsoid (base − b aᵀ) n, n a unit vector; d and ``width`` in picture units.
    The other arguments are those of ``polished_beside``.
    """
    return float(_equations(rho, bases, ends, both, width, np.empty((6, 6)), np.empty(6)))


def equations_beside(
    rho: np.ndarray, bases: np.ndarray, ends: np.ndarray, both: np.ndarray, width: float
) -> tuple[np.ndarray, np.ndarray]:
    """Gauss–Newton matrix (6, 6) and gradient (6,) of half the *sum* of the loss over the P colours, times ``width``².

    They are taken at the light ``both`` (6,). (``loss_beside`` is the mean.)
    """
    H, g = np.empty((6, 6)), np.empty(6)
    _equations(rho, bases, ends, both, width, H, g)
    return H, g


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _descend(rho: np.ndarray, bases: np.ndarray, ends: np.ndarray, both: np.ndarray, width: float) -> None:
    """Levenberg–Marquardt on Cauchy's loss of one width; ``both`` (6,) in place."""
    H, g, trial, A, right = np.empty((6, 6)), np.empty(6), np.empty(6), np.empty((6, 6)), np.empty(6)
    scale, other_H, other_g = np.empty(6), np.empty((6, 6)), np.empty(6)
    cost = _equations(rho, bases, ends, both, width, H, g)
    damping = FIRST_DAMPING
    for _ in range(STEPS):
        for x in range(6):
            scale[x] = 1 / np.sqrt(H[x, x]) if H[x, x] > 0 else 0.0
            right[x] = g[x] * scale[x]
        gained = -1.0
        while damping < MOST_DAMPING:
            for x in range(6):
                for y in range(6):
                    A[x, y] = H[x, y] * scale[x] * scale[y]
                A[x, x] = 1 + damping + LEAST_DAMPING if scale[x] > 0 else 1.0
            move = np.linalg.solve(A, right)
            for x in range(6):
                trial[x] = both[x] - move[x] * scale[x]
            size = np.sqrt(trial[3] ** 2 + trial[4] ** 2 + trial[5] ** 2)
            if size > 0 and np.isfinite(size):
                for x in range(3):
                    trial[3 + x] /= size
                    trial[x] *= size
                new = _equations(rho, bases, ends, trial, width, other_H, other_g)
                if new < cost:
                    gained = (cost - new) / cost
                    break
            damping *= MORE
        if gained < 0:
            return
        both[:], H[:], g[:], cost = trial, other_H, other_g, new
        damping = max(damping * LESS, LEAST_DAMPING)
        if gained < LEAST_GAIN:
            return


# More than seven parameters: it is called in the innermost loop, with plain arrays.
@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _equations(
    rho: np.ndarray,
    bases: np.ndarray,
    ends: np.ndarray,
    both: np.ndarray,
    width: float,
    H: np.ndarray,
    g: np.ndarray,
) -> float:
    """The mean of the loss over all colours. In place: H (6, 6) and g (6,) of half its sum, times ``width``²."""
    H[:], g[:] = 0.0, 0.0
    cost = 0.0
    for k in range(len(bases)):
        cost += _add(rho[ends[k] : ends[k + 1]], bases[k], both, width, H, g)
    for x in range(6):
        for y in range(x):
            H[y, x] = H[x, y]
    return cost / len(rho)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})  # type: ignore[untyped-decorator]
def _add(rho: np.ndarray, base: np.ndarray, both: np.ndarray, width: float, H: np.ndarray, g: np.ndarray) -> float:
    """Return Σ ln(1 + (d / ``width``)²) over the colours ``rho`` (P, 3), and add their weighted equations to H and g.

    d is the distance of a colour to the ellipsoid (base − b aᵀ) n. ``H`` (6, 6), its lower half, and ``g`` (6,) are
    changed in place by the equations of the P residuals. Colours farther than FAR widths count in the returned sum but
    not in H and g.
    """
    M, K, J = np.empty((3, 3)), np.empty((3, 3)), np.empty(6)
    n, distance = np.empty((len(rho), 3)), np.empty(len(rho))
    matrix_without(base, both, M)
    nearest_normals(rho, M, n, distance)
    cofactors(M, K)
    cost = 0.0
    for p in range(len(rho)):
        ratio = min(distance[p] / width, 1e6)
        cost += np.log1p(ratio * ratio)
        if ratio > FAR:
            continue
        n0, n1, n2 = n[p, 0], n[p, 1], n[p, 2]
        c0 = K[0, 0] * n0 + K[0, 1] * n1 + K[0, 2] * n2
        c1 = K[1, 0] * n0 + K[1, 1] * n1 + K[1, 2] * n2
        c2 = K[2, 0] * n0 + K[2, 1] * n1 + K[2, 2] * n2
        size = np.sqrt(c0 * c0 + c1 * c1 + c2 * c2)
        if size < 1e-14:
            continue
        c0, c1, c2 = c0 / size, c1 / size, c2 / size
        e0 = rho[p, 0] - (M[0, 0] * n0 + M[0, 1] * n1 + M[0, 2] * n2)
        e1 = rho[p, 1] - (M[1, 0] * n0 + M[1, 1] * n1 + M[1, 2] * n2)
        e2 = rho[p, 2] - (M[2, 0] * n0 + M[2, 1] * n1 + M[2, 2] * n2)
        r = c0 * e0 + c1 * e1 + c2 * e2
        lit, gain = both[3] * n0 + both[4] * n1 + both[5] * n2, c0 * both[0] + c1 * both[1] + c2 * both[2]
        J[0], J[1], J[2] = c0 * lit, c1 * lit, c2 * lit
        J[3], J[4], J[5] = n0 * gain, n1 * gain, n2 * gain
        add_equation(H, g, J, r, 1 / (1 + ratio * ratio))
    return cost
