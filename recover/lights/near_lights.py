"""Near lights of known position: depth and the lights' colours, fitted to every pixel together.

A point light at P lights the surface point X of normal n by max(0, a·n), a = (P − X)/|P − X|³, so F = Σ c aᵀ changes
from point to point and no single ellipsoid holds all colours. A distant light of known direction has the same a, of
unit length, at every point. With P known, the depth of a pixel gives X, and X gives a. The unknowns are the absolute
depth at the corners of the pixels and the colours c. Robust Gauss–Newton (Levenberg–Marquardt) finds them, with one
sparse factorisation a step and a Schur complement for the colours. No first estimate is needed: the start is a dome
over the silhouette. Orthographic pictures only.

Frame: camera, x right, y up from the picture's middle, z toward the camera, in pixels.
"""

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from huesphere.recover.geometry.least_squares import Outcome, Schedule, descend
from huesphere.recover.lights.parameters import LIGHTS
from huesphere.render.dataset import KnownLights

STEPS, STILL_DEG = 40, 0.005  # at most so many, and the median turn of normals at which they end
FLOOR = 1e-5  # of the brightest colour, added to the width of the robust loss: a perfect fit has a median of 0
RIDGE = 1e-7  # of the trace of the colours' equations: the colours of far lights may be determined in sum alone
ONE_STEP = Schedule(  # between two looks at the scale of the residuals
    first_damping=1e-3, raise_by=8.0, lower_by=5.0, most_steps=1, trials=12, relative_gain=0.0, least_damping=1e-9
)
COLOUR_ROUNDS = 8  # reweightings of the colours on the start's surface
MEDIAN_LENGTH = 1.18  # √(2 ln 2): median length of a Gaussian residual of two dimensions, deviation 1; depth took one


class Fitted(NamedTuple):
    """Where the fit ended from one start. Camera frame."""

    normals: np.ndarray  # (H, W, 3) unit, NaN off the object
    depth: np.ndarray  # (H, W) pixels, absolute: in the frame of the lights' positions
    F: np.ndarray  # (H, W, 3, 3) ρ = F n, of the lights that the surface faces; NaN off the object
    colours: np.ndarray  # (L, 3) of each light at its distance from the start's middle, picture units
    residual: np.ndarray  # (H, W) length of the colour's residual, picture units; NaN off the object
    median_residual: float  # over usable pixels, picture units
    rotation: np.ndarray  # (3, 3) radians², covariance of a small rotation that all normals may share
    steps: int
    converged: bool  # the normals hardly moved in the last step


def fit_near(rgb: np.ndarray, usable: np.ndarray, mask: np.ndarray, depth: np.ndarray, lights: KnownLights) -> Fitted:
    """Depth and colours from a picture ``rgb`` (H, W, 3), picture units, of the object ``mask`` (H, W).

    ``usable`` (H, W): pixels whose colours count; ``depth`` (H, W) to start from, absolute, pixels; ``lights``:
    positions of near lights in pixels and directions of distant ones; at most STEPS of Gauss–Newton. Raises
    RuntimeError or LinAlgError where the equations are singular.
    """
    surface = _Surface(mask)
    z = surface.corners_of(depth)
    light = _Field(lights, surface.points(z).mean(axis=0))
    rho, counts = rgb[mask].astype(np.float64), usable[mask]
    floor = FLOOR * float(rho.max())
    view = _View.of(surface, light, z)
    c, weight = np.zeros((light.count, 3)), counts.astype(np.float64)
    for _ in range(COLOUR_ROUNDS):
        c = _colours(rho, view.shading, weight)
        weight, _ = _weights(rho - view.shading @ c, counts, floor)

    def one_step(state: _State, damping: float | None) -> Outcome[_State]:
        weight, scale = _weights(state.residual(rho), counts, floor)
        return descend(
            state,
            loss=lambda s: _cost(s.residual(rho), counts, scale) + surface.bending(s.z) / scale**2,
            linearise=lambda s: _Equations(surface, s.z, s.view, s.c, s.residual(rho), weight),
            step=lambda s, equations, damping: s.moved(surface, light, *equations.solve(damping)),
            schedule=ONE_STEP,
            damping=damping,
        )

    state, damping, converged, step = _State(z, c, view), None, False, 0
    while step < STEPS and not converged:
        step += 1
        outcome = one_step(state, damping)
        if not outcome.steps:
            break
        before, state, damping = state, outcome.state, outcome.damping
        turn = float(np.degrees(np.median(np.linalg.norm(state.view.n - before.view.n, axis=1))))
        converged = turn < STILL_DEG
    z, c, view = state
    e = np.linalg.norm(rho - view.shading @ c, axis=1)
    median = float(np.median(e[counts]))
    last = _Equations(surface, z, view, c, rho - view.shading @ c, _weights(rho - view.shading @ c, counts, floor)[0])
    middle = light.at(surface.points(z).mean(axis=0)[None])[0][0]
    rotation = (median / MEDIAN_LENGTH) ** 2 * _of_rotation(last.covariance(), c, middle)

    def image(values: np.ndarray) -> np.ndarray:
        whole = np.full((*mask.shape, *values.shape[1:]), np.nan)
        whole[mask] = values
        return whole

    depth = image(surface.points(z)[:, 2])
    return Fitted(image(view.n), depth, image(view.F(c)), c, image(e), median, rotation, step, converged)


class _Surface:
    """Depth at the M corners of an object's P pixels, bilinear in each: sparse operators from corners to pixels.

    ``p`` and ``q`` give the slopes ∂z/∂x and ∂z/∂y, ``mean`` the depth at the middle; ``stiffness`` is the matrix of
    the small penalty on twists and second differences, which no colour determines.
    """

    def __init__(self, mask: np.ndarray) -> None:
        height, width = mask.shape
        row, column = np.nonzero(mask)
        self.mask = mask
        self.x, self.y = column + 0.5 - width / 2, height / 2 - row - 0.5
        corners = [(row + i) * (width + 1) + column + j for i, j in ((0, 0), (0, 1), (1, 0), (1, 1))]
        used, number = np.unique(np.concatenate(corners), return_inverse=True)
        self.count = len(used)
        rows = np.tile(np.arange(len(row)), 4)

        def operator(*weights: float) -> sparse.csr_matrix:
            values = np.repeat(weights, len(row))
            return sparse.csr_matrix((values, (rows, number.ravel())), (len(row), self.count))

        self.p, self.q = operator(-0.5, 0.5, -0.5, 0.5), operator(0.5, 0.5, -0.5, -0.5)
        self.mean = operator(0.25, 0.25, 0.25, 0.25)
        at = np.full(mask.shape, -1)
        at[mask] = np.arange(len(row))
        stiff = [LIGHTS.depth_stiffness * operator(1.0, -1.0, -1.0, 1.0)]
        for slope, one, other in ((self.p, at[:, :-1], at[:, 1:]), (self.q, at[:-1], at[1:])):
            pair = (one >= 0) & (other >= 0)
            stiff.append(LIGHTS.depth_stiffness * (slope[one[pair]] - slope[other[pair]]))
        together = sparse.vstack(stiff).tocsr()
        self.stiffness = (together.T @ together).tocsc()

    def corners_of(self, depth: np.ndarray) -> np.ndarray:
        """Depth at the corners (M,) from that of pixels (H, W)."""
        return np.asarray(self.mean.T @ depth[self.mask] / (self.mean.T @ np.ones(len(self.x))))

    def points(self, z: np.ndarray) -> np.ndarray:
        """Middles (P, 3) of the pixels in space, from the depth ``z`` (M,) at the corners."""
        return np.stack([self.x, self.y, self.mean @ z], axis=1)

    def bending(self, z: np.ndarray) -> float:
        """The penalty on twists and second differences of the depth ``z`` (M,), squared picture units."""
        return float(z @ (self.stiffness @ z))


class _Field:
    """What arrives from each of L lights, near ones first; a near light's colour is that at its distance to ``middle``.

    ``middle`` (3,): a point of the object, pixels.
    """

    def __init__(self, lights: KnownLights, middle: np.ndarray) -> None:
        self.positions, self.directions = (np.asarray(v, float).reshape(-1, 3) for v in lights)
        self.scale = ((self.positions - middle) ** 2).sum(axis=1)[:, None]
        self.count = len(self.positions) + len(self.directions)

    def at(self, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """a and its derivative ∂a/∂z by the point's depth, both (P, L, 3), at points ``X`` (P, 3), pixels.

        Camera frame, near lights first. For a near light a = d² (P − X)/|P − X|³, where d is the light's distance to
        ``middle``: a has no unit, and length 1 at that distance. For a distant light a is its direction, and ∂a/∂z 0.
        """
        toward = self.positions - X[:, None]
        r = np.linalg.norm(toward, axis=2, keepdims=True)
        near = self.scale * toward / r**3
        by_depth = 3 * near * toward[..., 2:] / r**2
        by_depth[..., 2:] -= self.scale / r**3
        far = np.broadcast_to(self.directions, (len(X), *self.directions.shape))
        return np.concatenate([near, far], axis=1), np.concatenate([by_depth, np.zeros_like(far)], axis=1)


class _View(NamedTuple):
    """A surface under the lights: what its P pixels have of each of the L lights."""

    n: np.ndarray  # (P, 3) unit normals
    a: np.ndarray  # (P, L, 3), 0 where the surface faces away
    by_depth: np.ndarray  # (P, L, 3) ∂a/∂z, 0 where the surface faces away
    shading: np.ndarray  # (P, L) max(0, a·n)

    @classmethod
    def of(cls, surface: _Surface, light: _Field, z: np.ndarray) -> "_View":
        """Of the surface whose depth at the corners is ``z`` (M,)."""
        n = np.stack([-(surface.p @ z), -(surface.q @ z), np.ones(len(surface.x))], axis=1)
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        a, by_depth = light.at(surface.points(z))
        shading = np.einsum("plk,pk->pl", a, n)
        lit = (shading > 0)[..., None]
        return cls(n, a * lit, by_depth * lit, np.maximum(shading, 0.0))

    def F(self, c: np.ndarray) -> np.ndarray:
        """(P, 3, 3) ρ = F n of each pixel, for colours ``c`` (L, 3) of the lights."""
        return np.einsum("lc,plk->pck", c, self.a)


class _State(NamedTuple):
    """The unknowns of the fit, and the surface that they make."""

    z: np.ndarray  # (M,) depth at the corners, pixels
    c: np.ndarray  # (L, 3) colours
    view: _View

    def residual(self, rho: np.ndarray) -> np.ndarray:
        """Residuals (P, 3) of the colours ``rho`` (P, 3)."""
        return rho - self.view.shading @ self.c  # type: ignore[no-any-return]

    def moved(self, surface: _Surface, light: _Field, dz: np.ndarray, dc: np.ndarray) -> "_State":
        """The state after a step ``dz`` (M,) of depth and ``dc`` (L, 3) of colours."""
        z = self.z + dz
        return _State(z, self.c + dc, _View.of(surface, light, z))


def _colours(rho: np.ndarray, shading: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Colours (L, 3) of the lights by weighted least squares, from ``rho`` (P, 3) and ``shading`` (P, L)."""
    A = shading.T @ (weight[:, None] * shading)
    return np.linalg.solve(A + RIDGE * np.trace(A) * np.eye(len(A)), shading.T @ (weight[:, None] * rho))


def _weights(e: np.ndarray, counts: np.ndarray, floor: float) -> tuple[np.ndarray, float]:
    """(Cauchy's weights (P,) of residuals ``e`` (P, 3), 0 where they do not count; the width of the loss)."""
    length = np.linalg.norm(e, axis=1)
    scale = LIGHTS.near_robust_width * float(np.median(length[counts])) + floor
    return counts / (1 + (length / scale) ** 2), scale


def _cost(e: np.ndarray, counts: np.ndarray, scale: float) -> float:
    """Cauchy's loss of the residuals ``e`` (P, 3) that count, in units of its width ``scale``."""
    return float(np.log1p((e[counts] ** 2).sum(axis=1) / scale**2).sum())


class _Equations:
    """Normal equations of one step, H of depths (sparse), D of colours, B between them; g and h the right sides.

    ``e`` (P, 3): residuals; ``weight`` (P,): of each pixel; ``c`` (L, 3): colours of the lights. Six arguments of one
    linearisation, which nothing else needs together.
    """

    def __init__(
        self, surface: _Surface, z: np.ndarray, view: _View, c: np.ndarray, e: np.ndarray, weight: np.ndarray
    ) -> None:
        n, F, L = view.n, view.F(c), len(c)
        by_z = np.einsum("lc,plk,pk->pc", c, view.by_depth, n)
        # ∂n/∂p = n3 (n1 n − x̂), ∂n/∂q = n3 (n2 n − ŷ), for n3 = 1/√(1 + p² + q²).
        by_p, by_q = (np.einsum("pck,pk->pc", F, n[:, 2:] * (n * n[:, i : i + 1] - np.eye(3)[i])) for i in (0, 1))
        S = view.shading.T @ (weight[:, None] * view.shading)
        self.D = np.kron(np.eye(3), S + RIDGE * np.trace(S) * np.eye(L))
        self.B, self.h = np.zeros((surface.count, 3 * L)), np.zeros(3 * L)
        self.H, self.g = surface.stiffness.copy(), -(surface.stiffness @ z)
        for k in range(3):
            parts = ((by_p, surface.p), (by_q, surface.q), (by_z, surface.mean))
            J = sum(sparse.diags(by[:, k]) @ operator for by, operator in parts)
            WJ = sparse.diags(weight) @ J
            own = slice(k * L, (k + 1) * L)
            self.H = self.H + J.T @ WJ
            self.g += WJ.T @ e[:, k]
            self.B[:, own] = WJ.T @ view.shading
            self.h[own] = view.shading.T @ (weight * e[:, k])

    def covariance(self) -> np.ndarray:
        """Of the colours (3L, 3L), channel by channel, the depth left free, for noise of deviation 1."""
        H = (self.H + sparse.diags(1e-9 * np.full(len(self.g), self.H.diagonal().mean()))).tocsc()
        factors = splu(H, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        return np.linalg.pinv(self.D - self.B.T @ factors.solve(self.B), hermitian=True)

    def solve(self, damping: float) -> tuple[np.ndarray, np.ndarray]:
        """(dz (M,), dc (L, 3)) of a step, each equation damped by ``damping`` of its own weight."""
        diagonal = self.H.diagonal()
        H = (self.H + sparse.diags(damping * diagonal + 1e-9 * diagonal.mean())).tocsc()
        factors = splu(H, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        by_g, by_B = np.split(factors.solve(np.column_stack([self.g, self.B])), [1], axis=1)
        D = self.D + damping * np.diag(np.diag(self.D))
        dc = np.linalg.solve(D - self.B.T @ by_B, self.h - self.B.T @ by_g[:, 0])
        return by_g[:, 0] - by_B @ dc, dc.reshape(3, -1).T


def _of_rotation(covariance: np.ndarray, c: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Covariance (3, 3) of ω in F (1 + [ω]×), F = Σ c aᵀ, from that of the colours ``c`` (L, 3); ``a`` (L, 3)."""
    inverse = np.linalg.inv(c.T @ a)
    by_colour = np.einsum("ik,lj->ijkl", inverse, a).reshape(3, 3, -1)
    turn = np.stack([by_colour[i, j] - by_colour[j, i] for i, j in ((2, 1), (0, 2), (1, 0))]) / 2
    return np.asarray(turn @ covariance @ turn.T)
