"""F(x) of a rig from pixels whose normals are known: linear least squares, then least angles.

The linear fit minimises |ρ − F(x) n|² (report Eq. 6, F a polynomial of position). The normal that a picture gives is
the direction of F⁻¹ρ, so the fit is refined by Gauss–Newton on the angle between that and the known normal, with a
weight that falls off for outliers (Geman and McClure 1985). Angles do not determine the scale of F: a small share
of the linear fit's squared residual is added to the sum, which does. Few balls determine badly how F depends on
position; so the squares of the coefficients of those terms are added too, with a weight that grows with the misfit of
F, and terms that nothing in the pictures supports become 0.
"""

from dataclasses import dataclass

import numpy as np

from huesphere.recover.rig.model import matrices_at, terms
from huesphere.recover.robust_scale import mad_scale

STEPS = 8  # of Gauss–Newton
STEP_ENDS = 1e-4  # relative change of F at which they end
COLOUR_SHARE = 0.1  # factor of the residual (F n − ρ) / (root mean square of ρ) beside that of the direction
# Weight of the squared coefficients of the terms that depend on position, over the median square angle; chosen on ten
# pictures of pressed balls.
PENALTY = 0.1
OUTLIERS_FROM = 3.0  # robust standard deviations of the angle at which the weight is a quarter


@dataclass(frozen=True)
class Samples:
    """Pixels of calibration pictures whose normals are known."""

    rho: np.ndarray  # (N, 3) linear light, or its quotient by the reference
    normals: np.ndarray  # (N, 3) unit, camera frame
    position: np.ndarray  # (N, 2) as of ``recover.rig.model.positions``
    # (N,) int: number of the ball, or of the sector of the only ball, whose pixels are left out together; −1: the flat
    # sheet, which is never left out
    group: np.ndarray
    weight: np.ndarray  # (N,) of the squared residual

    def only(self, chosen: np.ndarray) -> "Samples":
        """The samples that are ``chosen`` (N,) bool."""
        return Samples(*(values[chosen] for values in vars(self).values()))


def joined(parts: list[Samples]) -> Samples:
    """Samples of several pictures as one set."""
    return Samples(*(np.concatenate([getattr(part, name) for part in parts]) for name in Samples.__annotations__))


def fit_matrices(samples: Samples, count: int) -> np.ndarray:
    """Coefficients (T, 3, 3) of F(x) of ``count`` terms. Raises LinAlgError where the samples do not determine it."""
    coefficients = _linear(samples, count)
    basis = terms(samples.position, count)
    scale = float(np.sqrt(np.mean(samples.rho**2)))
    for _ in range(STEPS):
        step = _step(samples, coefficients, basis, scale)
        coefficients = coefficients + step
        if np.abs(step).max() < STEP_ENDS * np.abs(coefficients).max():
            break
    if not np.isfinite(coefficients).all():
        raise np.linalg.LinAlgError("the fit of F diverged")
    return coefficients


def _step(samples: Samples, coefficients: np.ndarray, basis: np.ndarray, scale: float) -> np.ndarray:
    """The Gauss–Newton step (T, 3, 3) of the coefficients; ``basis`` (N, T): the polynomial's terms.

    d(F⁻¹ρ) = −F⁻¹ dF F⁻¹ρ, of which only the part across the unit vector u counts: M dF u with M = −(I − u uᵀ) F⁻¹.
    The Jacobian of a pixel is M ⊗ (basis ⊗ u), so its normal equations are sums of products of small factors.
    """
    F = matrices_at(coefficients, samples.position)
    inverse = np.linalg.inv(F)
    b = np.einsum("nij,nj->ni", inverse, samples.rho)
    u = b / np.linalg.norm(b, axis=1, keepdims=True)
    residual = u - samples.normals
    angle = np.linalg.norm(residual, axis=1)
    cut = OUTLIERS_FROM * max(mad_scale(angle), 1e-6)
    weight = samples.weight / (1 + (angle / cut) ** 2) ** 2
    M = u[:, :, None] * np.einsum("ni,nij->nj", u, inverse)[:, None, :] - inverse
    colour = (np.einsum("nij,nj->ni", F, samples.normals) - samples.rho) / scale
    size = 9 * basis.shape[1]
    A, g = np.zeros((size, size)), np.zeros(size)
    for own, along, left, share in (
        (M, u, residual, weight),
        (np.broadcast_to(np.eye(3) / scale, M.shape), samples.normals, colour, COLOUR_SHARE**2 * weight),
    ):
        q = (basis[:, :, None] * along[:, None, :]).reshape(len(u), -1)  # (N, 3T): term t, component j
        K = np.einsum("nai,nak->nik", own, own).reshape(len(u), 9)
        pairs = (share[:, None] * K).T @ (q[:, :, None] * q[:, None, :]).reshape(len(u), -1)
        width = q.shape[1]
        A += pairs.reshape(3, 3, width, width).transpose(0, 2, 1, 3).reshape(size, size)
        g += (np.einsum("nai,na->ni", own, left).T @ (share[:, None] * q)).ravel()
    penalty = np.zeros((3, basis.shape[1], 3))
    penalty[:, 1:] = PENALTY * float(np.median(angle**2)) / scale**2
    A[np.diag_indices(size)] += penalty.ravel()
    g += (penalty * coefficients.transpose(1, 0, 2)).ravel()
    step = np.linalg.lstsq(A, -g, rcond=1e-12)[0].reshape(3, basis.shape[1], 3)
    return step.transpose(1, 0, 2)


def normals_of(coefficients: np.ndarray, samples: Samples) -> np.ndarray:
    """Unit normals (N, 3) by F(x): the direction of F⁻¹ρ."""
    b = np.linalg.solve(matrices_at(coefficients, samples.position), samples.rho[..., None])[..., 0]
    return np.asarray(b / np.linalg.norm(b, axis=1, keepdims=True))


def angles_deg(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angles in degrees between unit vectors (N, 3)."""
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(axis=-1)))


def _linear(samples: Samples, count: int) -> np.ndarray:
    """Coefficients by linear least squares on colours. Raises LinAlgError where they are not determined."""
    basis = terms(samples.position, count)
    A = (samples.normals[:, :, None] * basis[:, None, :]).reshape(len(basis), -1)
    root = np.sqrt(samples.weight)[:, None]
    found, _, rank, _ = np.linalg.lstsq(root * A, root * samples.rho, rcond=1e-9)
    if rank < A.shape[1]:
        raise np.linalg.LinAlgError(f"normals and positions determine {rank} of {A.shape[1]} numbers of each channel")
    return np.ascontiguousarray(found.reshape(3, count, 3).transpose(1, 2, 0))
