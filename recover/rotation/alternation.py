"""The alternation r3 ↔ (r1, r2) that the report proposed and did not try (section 3.5): Eq. (13) by its numerator only.

Without n3⁴ in the denominator the integrand is the square of a function that is linear in r3 for fixed r1 and r2, so
the integral is least at an eigenvector. On normals without noise it converges in 4 to 40 rounds, from errors of 22° and
33° of the closed form to less than 0.1°. Where noise makes neighbouring normals differ as much as the surface does it
fails: the numerator is then small wherever n3 is small. Figures in docs/recover/rotation.md.
Frame: camera, x right, y up, z toward the camera, image row 0 at the top.
"""

from dataclasses import dataclass

import numpy as np

from huesphere.recover.geometry.rotations import TWIN, rotation_angle
from huesphere.recover.geometry.slopes import centred_differences
from huesphere.recover.rotation.closed_form import best_angle, rotation_at
from huesphere.recover.rotation.parameters import ROTATION
from huesphere.recover.status import RecoveryFailure

MOST_ROUNDS = 50  # of r3 and (r1, r2) in turn


@dataclass(frozen=True)
class Alternation:
    """The rotation at which the alternation converged, or was stopped."""

    rotation: np.ndarray  # (3, 3) Rᵀ, rows r1 r2 r3, det +1
    rounds: int
    converged: bool
    turned: float  # radians, between the start and the end
    numerator: tuple[float, float]  # mean square of the numerator at the start and at the end


def numerator_terms(N: np.ndarray, inside: np.ndarray, r1: np.ndarray, r2: np.ndarray) -> np.ndarray:
    """v (P, 3) such that n3² [−(n1/n3)_y + (n2/n3)_x] = r3 · v, for N (H, W, 3). Report 3.5

    At the P pixels that are ``inside`` (H, W) with their four neighbours.

    v = N_y (r1·N) − N (r1·N_y) + N (r2·N_x) − N_x (r2·N).
    """
    N_x, N_y, where = centred_differences(N, inside)
    N, N_x, N_y = N[where], N_x[where], N_y[where]
    return N_y * (N @ r1)[:, None] - N * (N_y @ r1)[:, None] + N * (N_x @ r2)[:, None] - N_x * (N @ r2)[:, None]


def alternate(N: np.ndarray, inside: np.ndarray, start: np.ndarray) -> Alternation:
    """Compute in turns r3, the eigenvector of Σ v vᵀ of the least eigenvalue, and r1, r2 orthogonal to it by Eq. (18).

    N (H, W, 3) are rotated normals, ``inside`` (H, W) bool, ``start`` is the first Rᵀ (3, 3). Raises RecoveryFailure:
    too-scattered.
    """
    rotation, converged, done = start, False, 0
    first = _mean_square(N, inside, start)
    while done < MOST_ROUNDS and not converged:
        done += 1
        v = numerator_terms(N, inside, rotation[0], rotation[1])
        if not len(v):
            raise RecoveryFailure("too-scattered", "no accepted pixel has its four neighbours accepted")
        r3 = np.linalg.eigh(v.T @ v)[1][:, 0]
        r3 = r3 if (N[inside] @ r3 > 0).mean() >= 0.5 else -r3
        u1 = rotation[0] - (rotation[0] @ r3) * r3
        u1 = u1 if np.linalg.norm(u1) > 1e-6 else np.cross(r3, np.roll(r3, 1))
        u1 /= np.linalg.norm(u1)
        both = (best_angle(N, inside, r3, u) for u in (u1, np.cross(r3, u1)))
        moved = rotation_at(min(both, key=lambda angle: angle.integral), r3)
        if np.trace(moved @ rotation.T) < np.trace(TWIN @ moved @ rotation.T):
            moved = TWIN @ moved  # neither step decides between the twins: take the nearer one
        converged = rotation_angle(moved, rotation) < ROTATION.round_tolerance_rad
        rotation = moved
    return Alternation(
        rotation, done, converged, rotation_angle(rotation, start), (first, _mean_square(N, inside, rotation))
    )


def _mean_square(N: np.ndarray, inside: np.ndarray, rotation: np.ndarray) -> float:
    """Mean over the pixels of the square of the numerator r3 · v of Eq. (13)."""
    return float(np.mean((numerator_terms(N, inside, rotation[0], rotation[1]) @ rotation[2]) ** 2))
