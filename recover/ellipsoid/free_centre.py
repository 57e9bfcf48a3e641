"""The ellipsoid with an ambient term (report 3.6): ρ = F n + s, so colours lie on an ellipsoid about s, not black.

Nine unknowns: ρᵀDρ − 2ρᵀβ = 1 with D = C / (1 − sᵀCs) and β = D s. The report writes α for s, and 1 − αᵀα where
multiplying out (ρ − s)ᵀC(ρ − s) = 1 gives 1 − αᵀCα. The report's form is right only if α there is the ambient vector
in the frame of the normals, C^½ s, and not the ambient colour s.
"""

from dataclasses import dataclass

import numpy as np

from huesphere.recover.ellipsoid.fit import F_CONSISTENCY, ROUNDING_RESIDUAL, half, least_median_of_squares, middle
from huesphere.recover.ellipsoid.parameters import ELLIPSOID
from huesphere.recover.geometry.quadratic import design, elements_of
from huesphere.recover.status import RecoveryFailure

# The two stages of the search with an ambient term: (pixels, candidates kept, C-steps of each), see ``_concentrated``.
FREE_CENTRE_STAGES = ((600, 30, 6), (20_000, 3, 30))

# Number of random sets of nine colours, each fitted exactly, that start the search with an ambient term. If half of the
# pixels see every light, about 6 of the sets contain only such pixels.
FREE_CENTRE_TRIALS = 3000

UNKNOWNS = 9
LEAST_CURVATURE = 1e-9  # singular value of the scaled design over the largest: below it rounding hides the centre


@dataclass(frozen=True)
class AmbientFit:
    """An ellipsoid about the ambient light's colour."""

    C: np.ndarray  # (3, 3) symmetric positive definite, inverse squared picture units
    ambient: np.ndarray  # (3,) s, picture units
    residual: np.ndarray  # (N,) ρᵀDρ − 2ρᵀβ − 1, the regression's own
    accepted: np.ndarray  # (N,) bool
    s0: float  # robust dispersion of the residual
    r2: float  # 1 − (med |r|)²
    stderr: np.ndarray  # (3,) of s, picture units, from the spread of the accepted residuals


def fit_with_ambient(rgb: np.ndarray, *, robust: bool = True, seed: int = 0) -> AmbientFit:
    """C and s of colours (N, 3), picture units; report 3.6.

    ``robust``: least median of squares, the cut at 2.5 s0, and least squares over the accepted; else least squares over
    all. Deterministic in ``seed``. Raises RecoveryFailure: rank-deficient-colours where the colours fill no three
    dimensions about any point, ellipsoid-undetermined where they curve too little to have a centre, no-ellipsoid.
    """
    scale, M = _scaled_design(rgb)
    if not robust:
        return _fitted(M, scale, np.ones(len(rgb), bool))
    z = _least_median(M, rgb, scale, seed)
    r = M @ z - 1
    s0 = F_CONSISTENCY * (1 + 5 / (len(r) - UNKNOWNS)) * float(np.sqrt(middle(r**2, UNKNOWNS)))
    return _fitted(M, scale, np.abs(r) <= max(ELLIPSOID.acceptance_cut * s0, ROUNDING_RESIDUAL))


def ellipsoid_and_ambient(D: np.ndarray, beta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(C, s) from D (3, 3) and β (3,): s = D⁻¹β and C = D / (1 + sᵀDs). Report 3.6

    Where black lies outside the ellipsoid (much ambient light) D is negative definite and C still positive definite;
    where black lies on it D is infinite. Raises RecoveryFailure (no-ellipsoid) where C is not positive definite.
    """
    if not np.linalg.cond(D) < 1e14:
        raise RecoveryFailure("no-ellipsoid", "the best quadric with an ambient term has no centre")
    s = np.linalg.solve(D, beta)
    with np.errstate(divide="ignore", invalid="ignore"):
        C = D / (1 + s @ D @ s)
    if not (np.isfinite(C).all() and np.linalg.eigvalsh(C)[0] > 0):
        raise RecoveryFailure("no-ellipsoid", "the best quadric with an ambient term is not an ellipsoid")
    return C, s


def _scaled_design(rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(T (3, 3), M (N, 9)): the design of Eq. (9) and −2ρ, in colours Tρ of unit second moment about black."""
    moment = rgb.T @ rgb / len(rgb)
    eigenvalues, vectors = np.linalg.eigh(moment)
    if len(rgb) <= UNKNOWNS or not eigenvalues[0] > 1e-13 * eigenvalues[2]:
        raise RecoveryFailure("rank-deficient-colours", "the colours lie in a plane through black")
    T = (vectors / np.sqrt(eigenvalues)) @ vectors.T
    y = rgb @ T.T
    return T, np.concatenate([design(y), -2 * y], axis=1)


def _parts(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(D (3, 3), β (3,)) from the nine unknowns z."""
    return z[[[0, 3, 4], [3, 1, 5], [4, 5, 2]]], z[6:]


def _fitted(M: np.ndarray, T: np.ndarray, accepted: np.ndarray) -> AmbientFit:
    """Least squares over the ``accepted`` (N,) rows of the scaled design M (N, 9) = design of Tρ."""
    gram, right = M[accepted].T @ M[accepted], M[accepted].sum(axis=0)
    values = np.linalg.eigvalsh(gram)
    if not values[0] > LEAST_CURVATURE**2 * values[-1]:
        raise RecoveryFailure("ellipsoid-undetermined", "the colours curve too little to have a centre")
    z = np.linalg.solve(gram, right)
    C, s = ellipsoid_and_ambient(*_parts(z))
    residual = M @ z - 1
    objective = float(middle(residual**2, UNKNOWNS))
    variance = float(residual[accepted] @ residual[accepted]) / max(int(accepted.sum()) - UNKNOWNS, 1)
    back = np.linalg.inv(T)
    slope = _ambient_slope(z)
    covariance = back @ slope @ (variance * np.linalg.inv(gram)) @ slope.T @ back.T
    return AmbientFit(
        C=T.T @ C @ T,
        ambient=back @ s,
        residual=residual,
        accepted=accepted,
        s0=F_CONSISTENCY * (1 + 5 / (len(residual) - UNKNOWNS)) * float(np.sqrt(objective)),
        r2=1 - objective,
        stderr=np.sqrt(np.diag(covariance)),
    )


def _ambient_slope(z: np.ndarray) -> np.ndarray:
    """∂s/∂z (3, 9) of s = D⁻¹β: D⁻¹(dβ − dD s)."""
    D, beta = _parts(z)
    s = np.linalg.solve(D, beta)
    units = [(_parts(unit)[1] - _parts(unit)[0] @ s) for unit in np.eye(UNKNOWNS)]
    return np.linalg.solve(D, np.stack(units, axis=-1))


def _least_median(M: np.ndarray, rgb: np.ndarray, T: np.ndarray, seed: int) -> np.ndarray:
    """The nine unknowns z (9,) with a small median of r², r = M z − 1. Report 3.6, in scaled colours Tρ

    ``M`` (N, 9): the scaled design; ``rgb`` (N, 3): the colours, picture units; ``T`` (3, 3): their scaling. Candidates
    are the exact fits to random sets of nine rows, the least-squares fit to the sampled rows, and the ellipsoid about
    black that least median of squares finds. The best on a few hundred rows (only those that are ellipsoids, if any
    are) are refined on thousands of rows, by ``_concentrated``.
    """
    rng = np.random.default_rng(seed)
    # Rows are sampled by their rank in |Tρ|, so that the order of the pixels does not matter.
    order = np.argsort(np.einsum("ni,ni->n", M[:, 6:], M[:, 6:]), kind="stable")
    (first_size, first_kept, first_steps), (size, kept, steps) = FREE_CENTRE_STAGES
    sample = M[order[np.linspace(0, len(M) - 1, min(size, len(M))).round().astype(int)]]
    sample = rng.permutation(sample)
    nines = sample[rng.integers(0, len(sample), (FREE_CENTRE_TRIALS, UNKNOWNS))]
    z = np.linalg.solve(nines + 1e-9 * np.eye(UNKNOWNS), np.ones((len(nines), UNKNOWNS, 1)))[..., 0]
    candidates = [z[np.isfinite(z).all(axis=1)], np.linalg.lstsq(sample, np.ones(len(sample)))[0][None]]
    try:
        inverse = np.linalg.inv(T)
        scaled_C = inverse.T @ least_median_of_squares(rgb, seed=seed) @ inverse
        candidates.append(np.concatenate([elements_of(scaled_C), np.zeros(3)])[None])  # β = 0: no ambient light
    except RecoveryFailure:
        pass  # there is no ellipsoid about black: the other candidates remain
    best = _concentrated(sample[:first_size], np.concatenate(candidates), first_kept, first_steps)
    best = np.stack([b for b in best if _is_ellipsoid(b)] or list(best))
    return _concentrated(sample, best, kept, steps)[0]


def _is_ellipsoid(z: np.ndarray) -> bool:
    try:
        ellipsoid_and_ambient(*_parts(z))
    except (RecoveryFailure, np.linalg.LinAlgError):
        return False
    return True


def _concentrated(M: np.ndarray, candidates: np.ndarray, kept: int, steps: int) -> np.ndarray:
    """The ``kept`` best of the candidates z (K, 9), each refitted ``steps`` times, in order of their median r².

    r = M z − 1 over the rows of M (n, 9). A C-step refits a candidate by least squares to the half of the rows at which
    its own r² is least. That never raises the sum of these r² (P. J. Rousseeuw & K. Van Driessen, "Computing LTS
    regression for large data sets", Data Mining and Knowledge Discovery 12 (2006)).
    """
    h = half(len(M), UNKNOWNS)
    candidates = candidates[np.argsort(middle((candidates @ M.T - 1) ** 2, UNKNOWNS), kind="stable")[:kept]]
    for _ in range(steps):
        nearest = np.argpartition((candidates @ M.T - 1) ** 2, h - 1, axis=-1)[:, :h]
        gram = np.stack([M[rows].T @ M[rows] for rows in nearest]) + 1e-9 * np.eye(UNKNOWNS)
        candidates = np.linalg.solve(gram, np.stack([M[rows].sum(axis=0) for rows in nearest])[..., None])[..., 0]
    return candidates[np.argsort(middle((candidates @ M.T - 1) ** 2, UNKNOWNS), kind="stable")]
