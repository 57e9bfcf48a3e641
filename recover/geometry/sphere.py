"""The unit normal whose colour F n is nearest to a measured colour ρ: least squares on the sphere, F may be singular.

To normalise F⁻¹ρ would use one of the three measurements to determine a length that is known to be 1. Here
n = argmin |ρ − F n| over |n| = 1. With FᵀF = V diag(w) Vᵀ and g = VᵀFᵀρ the solution is n = V g / (w + λ), for the
λ > −w_min at which |n| = 1. That λ is found by Newton's method on 1/|n(λ)| = 1, whose left side is nearly linear in λ:
J. J. Moré & D. C. Sorensen, "Computing a trust region step", SIAM J. Sci. Stat. Comput. 4 (1983). Compiled.

Colours are linear and F is in the same units; normals are in the frame of F.
"""

from collections.abc import Callable

import numba
import numpy as np

MOST_STEPS = 25  # of Newton's method for λ
NEAR_STEPS = 4  # of Gauss–Newton in ``near_normals``


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def nearest_normals(rho: np.ndarray, F: np.ndarray, n: np.ndarray, distance: np.ndarray) -> None:
    """Write into ``n`` (P, 3) and ``distance`` (P,) the unit normal with F n nearest to ρ (P, 3), and |ρ − F n|."""
    w, V = np.linalg.eigh(F.T @ F)
    FV = F @ V
    g, y = np.empty(3), np.empty(3)
    least = -w[0] + 1e-12 * w[2]
    for p in range(len(rho)):
        low = least  # λ ≥ |g_k| − w_k for each k, or component k of n alone would be longer than 1
        for k in range(3):
            g[k] = FV[0, k] * rho[p, 0] + FV[1, k] * rho[p, 1] + FV[2, k] * rho[p, 2]
            low = max(low, abs(g[k]) - w[k])
        shift = max(low, 0.0)  # 0 for a colour on the ellipsoid itself
        for _ in range(MOST_STEPS):
            square, slope = 0.0, 0.0
            for k in range(3):
                inverse = 1 / (w[k] + shift)
                q = g[k] * inverse
                square += q * q
                slope += q * q * inverse
            length = np.sqrt(square)
            if abs(length - 1) < 1e-10 or slope == 0.0:
                break
            # 1/|n| is concave in λ: from the left of the root no step passes it; from the right one step leads to its
            # left, or to the lower limit of λ.
            moved = max(low, shift - (1 - length) * square / slope)
            if moved == shift:
                break
            shift = moved
        square = 0.0
        for k in range(3):
            y[k] = g[k] / (w[k] + shift)
            square += y[k] * y[k]
        if square < 1 - 1e-9:  # F is singular and |n| < 1 for all λ: the rest of n lies along the null direction of F
            y[0] = np.copysign(np.sqrt(1 - y[1] ** 2 - y[2] ** 2), y[0])
            square = 1.0
        length = np.sqrt(square) + 1e-300
        square = 0.0
        for i in range(3):
            n[p, i] = (V[i, 0] * y[0] + V[i, 1] * y[1] + V[i, 2] * y[2]) / length
        for i in range(3):
            e = rho[p, i] - (F[i, 0] * n[p, 0] + F[i, 1] * n[p, 1] + F[i, 2] * n[p, 2])
            square += e * e
        distance[p] = np.sqrt(square)


def unit(v: np.ndarray) -> np.ndarray:
    """The vectors v (…, 3) at length 1; zero vectors stay zero."""
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-300)  # type: ignore[no-any-return]


def across(directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors (K, 3) across each of the unit ``directions`` (K, 3), right-handed with it."""
    other = np.where(np.abs(directions[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = np.cross(directions, other)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(directions, first)


def fibonacci(count: int) -> np.ndarray:
    """``count`` unit vectors (count, 3) evenly over the sphere, from z = 1 to z = −1: the Fibonacci lattice."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    return np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=-1)


def on_sphere(rho: np.ndarray, F: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n (P, 3), |ρ − F n| (P,)) with the unit normals n that minimise |ρ − F n| for colours ρ (P, 3) and F (3, 3)."""
    n, distance = np.empty((len(rho), 3)), np.empty(len(rho))
    nearest_normals(np.ascontiguousarray(rho, dtype=np.float64), np.ascontiguousarray(F, dtype=np.float64), n, distance)
    return n, distance


def near_normals(
    rho: np.ndarray,
    colour_of: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    start: np.ndarray,
    sigma: float,
    known_deg: float,
) -> np.ndarray:
    """Most probable unit normals (P, 3) from colours ``rho`` (P, 3) and a prior estimate ``start`` (P, 3) of them.

    ``colour_of`` maps normals (P, 3) to (colours (P, 3), their derivatives by the normal (P, 3, 3)). ``sigma`` is the
    standard deviation of the noise of the colours, in their units, and ``known_deg`` that of ``start``, in degrees.
    NEAR_STEPS steps of Gauss–Newton in the tangent plane.
    """
    n, known = start, np.radians(known_deg)
    for _ in range(NEAR_STEPS):
        colour, change = colour_of(n)
        tangential = np.eye(3) - n[:, :, None] * n[:, None, :]  # projection onto the tangent plane of the sphere
        J = change @ tangential
        A = np.einsum("pci,pcj->pij", J, J) / sigma**2 + np.eye(3) / known**2
        right = np.einsum("pci,pc->pi", J, rho - colour) / sigma**2
        right += np.einsum("pij,pj->pi", tangential, start - n) / known**2
        n = n + np.einsum("pij,pj->pi", tangential, np.linalg.solve(A, right[..., None])[..., 0])
        n = n / np.linalg.norm(n, axis=1, keepdims=True)
    return n
