"""The unit normal whose colour is nearest to the one seen: least squares on the sphere, for any F, even singular.

Normalising F⁻¹ρ spends one of the three measurements on a length that is known to be 1. Here n = argmin |ρ − F n| over
|n| = 1: with FᵀF = V diag(w) Vᵀ and g = VᵀFᵀρ, n = V g / (w + λ) for the λ > −w_min at which |n| = 1, found by Newton's
method on 1/|n(λ)| = 1, which is nearly straight (Moré & Sorensen 1983, the trust-region subproblem). Compiled.
"""

from collections.abc import Callable

import numba
import numpy as np

MOST_STEPS = 25
NEAR_STEPS = 4


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def nearest_normals(rho: np.ndarray, F: np.ndarray, n: np.ndarray, distance: np.ndarray) -> None:
    """n (P, 3) and distance (P,), both in place: the nearest point F n of the ellipsoid to each colour ρ (P, 3)."""
    w, V = np.linalg.eigh(F.T @ F)
    FV = F @ V
    g, y = np.empty(3), np.empty(3)
    least = -w[0] + 1e-12 * w[2]
    for p in range(len(rho)):
        low = least  # λ is never below |g_k| − w_k, where one component alone has length 1
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
            # 1/|n| is concave in λ: from the left steps stay there, from the right one goes to the left, or to the end.
            moved = max(low, shift - (1 - length) * square / slope)
            if moved == shift:
                break
            shift = moved
        square = 0.0
        for k in range(3):
            y[k] = g[k] / (w[k] + shift)
            square += y[k] * y[k]
        if square < 1 - 1e-9:  # no λ reaches length 1: a singular F, along whose null direction the rest goes unseen
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


def fibonacci(count: int) -> np.ndarray:
    """Directions (count, 3), evenly over the sphere, from z = 1 to z = −1 along a spiral of golden angles."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    return np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=-1)


def on_sphere(rho: np.ndarray, F: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n (P, 3), |ρ − F n| (P,)) for colours ρ (P, 3)."""
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
    """Unit normals (P, 3) whose colours are near ``rho`` (P, 3) by noise ``sigma``, and near ``start`` (P, 3).

    ``colour_of`` tells of normals (P, 3) the colours (P, 3) and their change by the normal (P, 3, 3); ``known_deg`` is
    the standard deviation of the start. By Gauss–Newton.
    """
    n, known = start, np.radians(known_deg)
    for _ in range(NEAR_STEPS):
        colour, change = colour_of(n)
        across = np.eye(3) - n[:, :, None] * n[:, None, :]
        J = change @ across
        A = np.einsum("pci,pcj->pij", J, J) / sigma**2 + np.eye(3) / known**2
        pull = np.einsum("pci,pc->pi", J, rho - colour) / sigma**2
        pull += np.einsum("pij,pj->pi", across, start - n) / known**2
        n = n + np.einsum("pij,pj->pi", across, np.linalg.solve(A, pull[..., None])[..., 0])
        n = n / np.linalg.norm(n, axis=1, keepdims=True)
    return n
