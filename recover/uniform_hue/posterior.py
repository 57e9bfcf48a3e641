"""How surely G is known, and by which cue: the curvature of the function that ``fit`` minimises.

Half that function is taken for the negative logarithm of a likelihood, so that its Gauss–Newton matrix is the inverse
covariance of the unknowns (Laplace's approximation). The counts n_i of the cues, which were chosen with real and
made pictures, make it one of model errors rather than of noise.
"""

from dataclasses import dataclass

import numpy as np

from huesphere.recover.geometry.tangent_uncertainty import DEG, expected_length, tangent_frames
from huesphere.recover.uniform_hue.fit import Fitted, cue_equations, cue_weights

GAUGE = 1e-6  # of the largest information: added to all, since the length of G is no unknown of the normals
LEAST_INFORMATION = 1e-4  # of a log depth, or a lean in degrees: less is rounding


@dataclass(frozen=True)
class Posterior:
    """What is known of G after the fit, of whitened colours."""

    G: np.ndarray  # (3, 3)
    covariance: np.ndarray  # (9, 9) of the elements of G, in rows
    by_cue: dict[str, dict[str, float]]  # of "depth" (log) and "lean" (degrees): standard error by each cue alone

    def error_deg(self, colours: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Expected error (P,) of unit ``normals`` (P, 3) along G · ``colours`` (P, 3), whitened; degrees."""
        length = np.maximum(np.linalg.norm(colours @ self.G.T, axis=1), 1e-12)
        frames = np.stack(tangent_frames(normals), axis=1) / length[:, None, None]  # (P, 2, 3)
        spread = np.einsum("pe,pf,mekf->pmk", colours, colours, self.covariance.reshape(3, 3, 3, 3), optimize=True)
        tangent = frames @ spread @ frames.transpose(0, 2, 1)
        xx, xy, yy = tangent[:, 0, 0], tangent[:, 0, 1], tangent[:, 1, 1]
        return cue_weights()["error factor"] * DEG * expected_length(xx, xy, yy)  # type: ignore[no-any-return]

    def rotation_covariance(self) -> np.ndarray:
        """(3, 3) radians², of the small rotation about each axis that an error of G is, in the mean over directions."""
        # ½ Σ_m e_m × δb_m, with δG G⁻¹ = Ω: the antisymmetric part of Ω.
        inverse = np.linalg.inv(self.G)
        omega = np.zeros((3, 9))
        for k, (i, j) in enumerate(((2, 1), (0, 2), (1, 0))):
            change = np.zeros((3, 3, 9))
            for element in range(9):
                step = np.zeros(9)
                step[element] = 1.0
                change[:, :, element] = step.reshape(3, 3) @ inverse
            omega[k] = 0.5 * (change[i, j] - change[j, i])
        return cue_weights()["error factor"] ** 2 * omega @ self.covariance @ omega.T  # type: ignore[no-any-return]


def posterior(found: Fitted) -> Posterior:
    """Of the fit ``found``. Raises LinAlgError."""
    parts = {
        cue.name: cue_equations(cue, weight, found.x)[1] for cue, weight in zip(found.cues, found.weights, strict=True)
    }
    matrix = sum(parts.values()) + np.diag(np.append(np.zeros(9), found.precision))
    matrix = matrix + GAUGE * np.trace(matrix[:9, :9]) * np.diag(np.append(np.ones(9), np.zeros(2)))
    covariance = np.linalg.inv(matrix)[:9, :9]
    return Posterior(found.G, covariance, {name: _by_cue(found, parts, step) for name, step in _steps(found.G).items()})


def _steps(G: np.ndarray) -> dict[str, np.ndarray]:
    """Changes (9,) of G by bas-relief transformations: log depth by 1, and a lean by one degree (to the right, say)."""
    nothing = np.zeros(3)
    return {
        "depth": np.concatenate([G[0], G[1], nothing]),
        "lean_deg": np.concatenate([-G[2], nothing, nothing]) / DEG,
    }


def _by_cue(found: Fitted, parts: dict[str, np.ndarray], step: np.ndarray) -> dict[str, float]:
    """Standard error along ``step`` by each cue alone; what is known beforehand limits template and albedo."""
    out = {}
    for name, matrix in parts.items():
        along = np.append(step, np.zeros(2))
        information = float(along @ matrix @ along)
        for k, known in zip((9, 10), found.precision, strict=True):
            information -= float(along @ matrix[:, k]) ** 2 / (float(matrix[k, k]) + known)
        if information > LEAST_INFORMATION:
            out[name] = information**-0.5
    return out
