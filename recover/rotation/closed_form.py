"""The report's closed form for the rotation (sections 3.1–3.4): r3 from the smoothness eigenproblem, then the angle α.

Frame: camera, x right, y up, z toward the camera, image row 0 at the top. ``N`` is an image (H, W, 3) of rotated
normals Ĝρ (Eq. 11) and ``inside`` (H, W) where they count; derivatives are taken where the whole stencil is inside.
"""

from dataclasses import dataclass

import numpy as np

from huesphere.recover.geometry.slopes import centred_differences
from huesphere.recover.status import RecoveryFailure

BACKGROUND_ROUNDS = 50  # most fixed-point steps of the background's normal


@dataclass(frozen=True)
class Angle:
    """The angle α of r1 in the plane orthogonal to r3, measured from one choice of u1 (report 3.4)."""

    u1: np.ndarray  # (3,)
    u2: np.ndarray  # (3,), r3 × u1
    alpha: float  # radians, 0 … π/2
    integral: float  # Eq. (18) at ``alpha``, mean over the pixels
    squares: tuple[float, float, float]  # means of A², AB, B² of ``best_angle``
    abc: tuple[float, float, float]  # the coefficients of Eq. (19)

    def integral_at(self, alpha: np.ndarray) -> np.ndarray:
        """Eq. (18) at ``alpha`` in radians, mean over the pixels: the quantity that the chosen α minimises."""
        AA, AB, BB = self.squares
        return AA * np.cos(alpha) ** 2 + 2 * AB * np.cos(alpha) * np.sin(alpha) + BB * np.sin(alpha) ** 2

    def condition(self, alpha: np.ndarray) -> np.ndarray:
        """The left side of Eq. (19), a sin²α + b sin α cos α + c, at ``alpha`` in radians: the report's Fig. 1(f)."""
        a, b, c = self.abc
        return a * np.sin(alpha) ** 2 + b * np.sin(alpha) * np.cos(alpha) + c


@dataclass(frozen=True)
class Attitude:
    """A rotation from the closed form: n = Rᵀ N."""

    rotation: np.ndarray  # (3, 3) Rᵀ, rows r1 r2 r3, det +1
    negative_share: float  # of the pixels inside, those with n3 < 0: the validity test of report 3.3
    eigenvalues: np.ndarray  # (3,) of S, ascending
    eigenvectors: np.ndarray  # (3, 3), columns
    angles: tuple[Angle, Angle]  # one for each choice of u1
    chosen: int  # index in ``angles`` of the one that ``rotation`` is made with

    @property
    def integral(self) -> float:
        """Eq. (18) at the chosen angle, mean over the pixels."""
        return self.angles[self.chosen].integral


def smoothness_matrix(N: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """S (3, 3) of Eq. (17), S_kj = mean over the pixels of (N_x)_k (N_x)_j + (N_y)_k (N_y)_j (defined below Eq. 16).

    The report has the sum; the mean has the same eigenvectors. Raises RecoveryFailure (too-scattered) where no pixel
    is ``inside`` together with its four neighbours.
    """
    N_x, N_y, where = centred_differences(N, inside)
    if not where.any():
        raise RecoveryFailure("too-scattered", "no accepted pixel has its four neighbours accepted")
    N_x, N_y = N_x[where], N_y[where]
    return (N_x.T @ N_x + N_y.T @ N_y) / len(N_x)


def smoothness_matrix_on_background(
    N: np.ndarray, inside: np.ndarray, background: np.ndarray, background_normal: np.ndarray
) -> np.ndarray:
    """S (3, 3) of Eq. (17) over object and background, which is taken for a plane that faces the camera (report 3.2).

    ``background`` (H, W) bool are its pixels. ``background_normal`` (3,) is their N: the normal n = (0, 0, 1) in the
    rotated frame, N = R n = r3. Derivatives of N across the object's edge then count too, and they draw the
    eigenvector r3 toward the true viewing direction. A black background has no colour and so no N = Ĝρ. The end of
    report 3.2 does not say which N to use; this project takes "the background's vanishing p and q" to mean
    n = (0, 0, 1). Raises RecoveryFailure: too-scattered.
    """
    return smoothness_matrix(np.where(background[..., None], background_normal, N), inside | background)


def third_row(S: np.ndarray, N: np.ndarray, inside: np.ndarray) -> tuple[np.ndarray, float, np.ndarray, np.ndarray]:
    """(r3, share of pixels with n3 < 0, eigenvalues, eigenvectors) of S (3, 3): report 3.3.

    r3 (3,) is the eigenvector r for which r·N has the same sign at all pixels ``inside``; where none has, the one with
    the largest majority of one sign. Its own sign is such that n3 = r3·N is mostly positive.
    """
    eigenvalues, eigenvectors = np.linalg.eigh(S)  # Eq. (17): S r + Λ r = 0
    positive = (N[inside] @ eigenvectors > 0).mean(axis=0)
    chosen = int(np.argmax(np.maximum(positive, 1 - positive)))
    sign = 1.0 if positive[chosen] >= 0.5 else -1.0
    negative_share = float(min(positive[chosen], 1 - positive[chosen]))
    return sign * eigenvectors[:, chosen], negative_share, eigenvalues, eigenvectors


def third_row_on_background(N: np.ndarray, inside: np.ndarray, background: np.ndarray) -> np.ndarray:
    """r3 (3,) from the smoothness matrix over object and background, in which the background's N is r3 itself.

    Fixed-point iteration: each r3 is the background's N for the next smoothness matrix. See
    ``smoothness_matrix_on_background``. Raises RecoveryFailure: too-scattered.
    """
    r3, *_ = third_row(smoothness_matrix(N, inside), N, inside)
    for _ in range(BACKGROUND_ROUNDS):
        S = smoothness_matrix_on_background(N, inside, background, r3)
        before, (r3, *_) = r3, third_row(S, N, inside)
        if 1 - before @ r3 < 1e-12:
            break
    return r3


def best_angle(N: np.ndarray, inside: np.ndarray, r3: np.ndarray, u1: np.ndarray) -> Angle:
    """α in [0, π/2) at the zero of Eq. (19), for r1 = cos α u1 + sin α u2, r2 = −sin α u1 + cos α u2 (Appendix).

    With U = u1·N / r3·N and V = u2·N / r3·N the integrand of Eq. (18) is (cos α A + sin α B)², A = U_y − V_x and
    B = V_y + U_x. So the integral is a quadratic form in (cos α, sin α), and its derivative by α is Eq. (19) with
    a = −2ΣAB, b = ΣB² − ΣA², c = ΣAB. Pixels with n3 ≤ 0 have no slopes and are left out. ``u1`` (3,) is a unit vector
    orthogonal to ``r3`` (3,). Raises RecoveryFailure: too-scattered.
    """
    u2 = np.cross(r3, u1)
    w = N @ r3
    visible = inside & (w > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = np.where(visible[..., None], (N @ np.stack([u1, u2], axis=-1)) / w[..., None], 0.0)
    D_x, D_y, where = centred_differences(slopes, visible)
    if not where.any():
        raise RecoveryFailure("too-scattered", "no accepted pixel has its four neighbours accepted")
    A = (D_y[..., 0] - D_x[..., 1])[where]
    B = (D_y[..., 1] + D_x[..., 0])[where]
    AA, AB, BB = float(A @ A) / len(A), float(A @ B) / len(A), float(B @ B) / len(A)
    a, b, c = -2 * AB, BB - AA, AB  # Eq. (19)
    # a = −2c, so Eq. (19) reads c cos 2α + (b / 2) sin 2α = 0: one zero in [0, π/2), known in closed form.
    alpha = float(0.5 * np.arctan2(-2 * c, b) % (np.pi / 2))
    cos, sin = np.cos(alpha), np.sin(alpha)
    integral = cos * cos * AA + 2 * cos * sin * AB + sin * sin * BB
    return Angle(u1, u2, alpha, integral, (AA, AB, BB), (a, b, c))


def closed_form(N: np.ndarray, inside: np.ndarray) -> Attitude:
    """The rotation by report 3.1–3.4, from the rotated normals ``N`` (H, W, 3) that are ``inside`` (H, W).

    The rows (−r1, −r2, r3) are a second solution, the convex/concave twin: integrability cannot tell the two apart.
    Raises RecoveryFailure: too-scattered.
    """
    r3, negative_share, eigenvalues, eigenvectors = third_row(smoothness_matrix(N, inside), N, inside)
    # Report 3.4: the other two eigenvectors are the candidates for u1.
    candidates = [e for e in eigenvectors.T if abs(e @ r3) < 0.5]
    first, second = (best_angle(N, inside, r3, u1) for u1 in candidates)
    chosen = 0 if first.integral <= second.integral else 1
    return Attitude(
        rotation=rotation_at((first, second)[chosen], r3),
        negative_share=negative_share,
        eigenvalues=eigenvalues,
        eigenvectors=eigenvectors,
        angles=(first, second),
        chosen=chosen,
    )


def rotation_at(angle: Angle, r3: np.ndarray) -> np.ndarray:
    """Rᵀ (3, 3), rows r1 r2 r3: (r1, r2)ᵀ = R_α (u1, u2)ᵀ, Eq. (18). Eq. (12) is n = Rᵀ N."""
    cos, sin = np.cos(angle.alpha), np.sin(angle.alpha)
    return np.stack([cos * angle.u1 + sin * angle.u2, -sin * angle.u1 + cos * angle.u2, r3])
