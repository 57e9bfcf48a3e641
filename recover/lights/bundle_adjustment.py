"""Distant lights and the surface that they light, by Gauss–Newton over all of them: directions, colours, depth.

Where light k is seen it adds b_k (a_k·n), and where the surface turns away from it nothing: ρ = Σ b_k max(0, a_k·n) at
every pixel. Unknown are the depth at the corners of blocks of pixels, and five numbers a light. The depths are
eliminated: their equations have a narrow band (``recover.geometry.depth_grid``), and the rest (the Schur complement) is
as large as the lights are many.

The clamped cosine has a kink at its terminator, and a poor start is on the wrong side of it. So the cosine is softened
at first, to w ln(1 + e^{x/w}), and residuals count as if noise were large; both are sharpened step by step. Blocks of
pixels that are known to see every light are taken to do so from the start, which determines Σ b_k a_kᵀ = F, as does
what is known of F beforehand. Residuals have Cauchy's weights: cast shadows, steps in depth and light of other surfaces
are outliers.

All colours, noise and residuals here are divided by the largest channel value on the object, "the brightest".
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit

from huesphere.recover.geometry.depth_grid import DepthGrid, variation_within_cells
from huesphere.recover.geometry.least_squares import descend
from huesphere.recover.geometry.slopes import normals_by_slopes, normals_of_slopes
from huesphere.recover.geometry.sphere import across
from huesphere.recover.lights.blocks import (
    DESCENT,
    NEXT_TO_NOTHING,
    WHOLE_BLOCK,
    Equations,
    block_size,
    share_of_blocks,
    without_depth,
)
from huesphere.recover.lights.parameters import LIGHTS
from huesphere.recover.problem import Problem

COLOUR = 0.5  # standard deviation of a light's channel about 0 in the prior: keeps lights that no block sees finite
NEGATIVE_COLOUR = 1e-3  # the same of a channel below 0: a soft bound at 0
FARTHEST = 0.2  # radians that a light turns in one step, at most
OF_ALL = 1e-3  # share of the damping of the mean diagonal, for lights that are hardly seen
FIRST_DAMPING = 1e-2  # of the first trial of a descent


@dataclass(frozen=True)
class PriorOnF:
    """F as it is known before lights and surface are fitted."""

    F: np.ndarray  # (3, 3), divided by the brightest
    precision: np.ndarray  # (9, 9) inverse covariance of the entries of this F, row by row


def prior_on_F(F: np.ndarray, turn: np.ndarray, stretch: float) -> PriorOnF:
    """The prior on an F (3, 3) whose normals F⁻¹ρ may be turned and stretched.

    ``turn`` (3, 3): covariance of the small rotation ω, radians². ``stretch``: standard deviation of the relative
    change of length in any direction. F⁻¹δF is the sum of the small rotation −[ω]× and a symmetric matrix.
    """
    turned, stretched = np.zeros((3, 9)), np.zeros((9, 9))
    for i in range(3):
        for j in range(3):
            turned[:, 3 * i + j] = -0.5 * np.cross(np.eye(3)[i], np.eye(3)[j])
            stretched[3 * i + j, 3 * i + j] += 0.5
            stretched[3 * i + j, 3 * j + i] += 0.5
    precision = turned.T @ np.linalg.inv(turn) @ turned + stretched.T @ stretched / stretch**2
    by_F = np.kron(np.linalg.inv(F), np.eye(3))
    return PriorOnF(F, by_F.T @ precision @ by_F)


@dataclass(frozen=True)
class LitBlocks:
    """A surface in blocks of pixels, and its lights."""

    slope: np.ndarray  # (P, 2) depth gradient of each block, camera frame
    toward: np.ndarray  # (K, 3) unit, camera frame, toward each light
    colour: np.ndarray  # (K, 3) of each light, divided by the brightest
    loss: float  # mean over the blocks: about 0.6 where residuals are noise alone

    @property
    def F(self) -> np.ndarray:
        """(3, 3) of a pixel that sees every light, divided by the brightest."""
        return self.colour.T @ self.toward

    @property
    def beside(self) -> np.ndarray:
        """(K, 2, 3) two unit vectors across the direction toward each light, along which it turns."""
        return np.stack(across(self.toward), axis=1)


class Bundle:
    """The picture in blocks of pixels, divided by ``brightest``, and the fit of lights and surface to them."""

    def __init__(self, problem: Problem, core: np.ndarray, most_blocks: int, prior: PriorOnF | None = None) -> None:
        """At most about ``most_blocks`` blocks of the object.

        ``core`` (H, W): pixels that see every light. ``prior``: what is known of F beforehand.
        """
        mask = problem.mask
        self.prior = prior
        self.brightest = float(problem.rgb[mask].max())
        self.block = block_size(mask, most_blocks)
        self.noise = problem.noise / self.brightest / self.block  # of a block's mean
        rgb = np.where(mask[..., None], problem.rgb, 0.0) / self.brightest
        self.cells = DepthGrid(rgb, mask, self.block, problem.ray)
        self.ray = np.zeros((len(self.cells), 2)) if self.cells.ray is None else self.cells.ray
        self.core = share_of_blocks(core, mask, self.block) > WHOLE_BLOCK
        seen = share_of_blocks(problem.seen, mask, self.block) > WHOLE_BLOCK
        self.trusted = self.cells.well_within(LIGHTS.rim_px) & seen
        self.trust = np.where(self.trusted, 1.0, NEXT_TO_NOTHING)  # (P,) weight of each block's colour

    def normals(self, slope: np.ndarray) -> np.ndarray:
        """Unit normals (P, 3), camera frame, of the slopes (P, 2)."""
        return normals_of_slopes(slope, self.ray)

    def fit(self, lit: LitBlocks, width: float, sigma: float, steps: int, *, core_sees_all: bool) -> LitBlocks:
        """``lit`` after so many ``steps`` of Gauss–Newton, or after fewer where these no longer lower the loss.

        ``width``: range of the cosine over which a terminator is softened. ``sigma``: standard deviation that residuals
        are expected to have. ``core_sees_all``: the core counts as seeing every light, whichever side of the
        terminators its normals are on.
        """
        return _Descent(self, lit, width, sigma, core_sees_all).steps(lit, steps)

    def residual(self, lit: LitBlocks) -> np.ndarray:
        """Residuals of the blocks' colours (P, 3), terminators not softened."""
        shade = np.maximum(self.normals(lit.slope) @ lit.toward.T, 0.0)
        return self.cells.mean - shade @ lit.colour  # type: ignore[no-any-return]

    def covariance(self, lit: LitBlocks, sigma: float) -> np.ndarray:
        """(5K, 5K) of the lights' colours, then of their turns along ``beside``, depth being unknown too.

        ``sigma``: standard deviation of residuals.
        """
        return _Descent(self, lit, sigma, sigma, core_sees_all=False).covariance(lit)


class _Descent:
    """Levenberg–Marquardt at one width of terminators and one standard deviation ``sigma`` of residuals."""

    def __init__(self, of: Bundle, lit: LitBlocks, width: float, sigma: float, core_sees_all: bool) -> None:
        self.of, self.width, self.sigma = of, width, sigma
        self.cauchy = LIGHTS.outlier_deviations  # width of Cauchy's loss, in standard deviations
        self.all_lit = of.core if core_sees_all else np.zeros(len(of.core), bool)
        *_, seen = self._shaded(lit)
        J = _by_normal(seen, lit) @ normals_by_slopes(lit.slope, of.ray)
        # What a block with one slope cannot follow counts as noise.
        self.weight = of.trust / (1 + (variation_within_cells(of.cells, lit.slope, J) / sigma) ** 2)

    def steps(self, lit: LitBlocks, count: int) -> LitBlocks:
        outcome = descend(
            lit,
            loss=self.loss,
            linearise=self._equations,
            step=self._moved,
            schedule=replace(DESCENT, first_damping=FIRST_DAMPING, most_steps=count),
        )
        return replace(outcome.state, loss=outcome.loss)

    def _shaded(self, lit: LitBlocks) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(normals (P, 3), softened cosines of the lights (P, K), how much each is seen (P, K))."""
        n = self.of.normals(lit.slope)
        cosine = n @ lit.toward.T
        shade, seen = self.width * np.logaddexp(0.0, cosine / self.width), expit(cosine / self.width)
        shade[self.all_lit], seen[self.all_lit] = cosine[self.all_lit], 1.0
        return n, shade, seen

    def loss(self, lit: LitBlocks) -> float:
        """Mean over the blocks of Cauchy's loss of their residuals, and of the priors on colours and on F."""
        _, shade, _ = self._shaded(lit)
        squares = ((self.of.cells.mean - shade @ lit.colour) ** 2).sum(axis=1) / self.sigma**2
        sizes = (_held(lit.colour) * lit.colour**2).sum()
        if self.of.prior is not None:
            away = (lit.F - self.of.prior.F).ravel()
            sizes += away @ self.of.prior.precision @ away
        c2 = self.cauchy**2
        return float((c2 * np.log1p(self.weight * squares / c2)).sum() + sizes) / len(squares)

    def _equations(self, lit: LitBlocks) -> Equations:
        """Normal equations: W (P, 2, 2), g (P, 2) of slopes; H, h of lights (colours, then turns); the cross terms."""
        n, shade, seen = self._shaded(lit)
        e = self.of.cells.mean - shade @ lit.colour
        w = self.weight / (1 + self.weight * (e**2).sum(axis=1) / (self.cauchy * self.sigma) ** 2) / self.sigma**2
        J = _by_normal(seen, lit) @ normals_by_slopes(lit.slope, self.of.ray)
        A = _by_lights(n, shade, seen, lit)
        weighted = J * w[:, None, None]
        W, g = np.swapaxes(weighted, 1, 2) @ J, np.einsum("pci,pc->pi", weighted, e)
        between = np.swapaxes(weighted, 1, 2) @ A
        flat = (A * w[:, None, None]).reshape(-1, A.shape[2])
        H, h = flat.T @ A.reshape(flat.shape), flat.T @ e.ravel()
        colours = np.arange(lit.colour.size)
        held = _held(lit.colour).ravel()
        H[colours, colours] += held
        h[colours] -= held * lit.colour.ravel()
        if self.of.prior is not None:
            of_F = F_by_lights(lit)
            pull = of_F @ self.of.prior.precision
            H += pull @ of_F.T
            h -= pull @ (lit.F - self.of.prior.F).ravel()
        return W, g, H, h, between

    def _moved(self, lit: LitBlocks, equations: Equations, damping: float) -> LitBlocks:
        S, s, own, by_lights = without_depth(self.of.cells, equations, damping)
        size = np.maximum(np.diag(S), 0.0)
        move = np.linalg.solve(S + damping * np.diag(size + OF_ALL * size.mean()), s)
        count = len(lit.toward)
        turns = move[3 * count :].reshape(count, 2)
        share = 1 / max(1.0, float(np.abs(turns).max()) / FARTHEST)
        toward = lit.toward + share * np.einsum("kd,kdx->kx", turns, lit.beside)
        return LitBlocks(
            slope=lit.slope + share * (own - by_lights @ move),
            toward=toward / np.linalg.norm(toward, axis=1, keepdims=True),
            colour=lit.colour + share * move[: 3 * count].reshape(count, 3),
            loss=np.nan,
        )

    def covariance(self, lit: LitBlocks) -> np.ndarray:
        return np.linalg.pinv(without_depth(self.of.cells, self._equations(lit), 0.0).S, hermitian=True)


def F_by_lights(lit: LitBlocks) -> np.ndarray:
    """Derivative (5K, 9) of F = Σ b_k a_kᵀ, row by row, by the lights' colours, then by turns along ``beside``."""
    count, beside = len(lit.toward), lit.beside
    change = np.zeros((5 * count, 3, 3))
    for k in range(count):
        for channel in range(3):
            change[3 * k + channel, channel] = lit.toward[k]
        for i in range(2):
            change[3 * count + 2 * k + i] = np.outer(lit.colour[k], beside[k, i])
    return change.reshape(5 * count, 9)


def _held(colour: np.ndarray) -> np.ndarray:
    """Prior precision (K, 3) of colours about 0: small, and large where they are negative."""
    return np.where(colour < 0, NEGATIVE_COLOUR, COLOUR) ** -2


def _by_normal(seen: np.ndarray, lit: LitBlocks) -> np.ndarray:
    """Derivative (P, 3, 3) of colours by the normal, where lights are ``seen`` (P, K), from 0 (not) to 1."""
    return (seen @ (lit.colour[:, :, None] * lit.toward[:, None, :]).reshape(-1, 9)).reshape(-1, 3, 3)  # type: ignore[no-any-return]


def _by_lights(n: np.ndarray, shade: np.ndarray, seen: np.ndarray, lit: LitBlocks) -> np.ndarray:
    """Derivative (P, 3, 5K) of colours by the lights' colours (K, 3), then by turns (K, 2) across their directions."""
    P, K = shade.shape
    by_colour = np.zeros((P, 3, K, 3))
    for channel in range(3):
        by_colour[:, channel, :, channel] = shade
    turned = (n @ lit.beside.reshape(-1, 3).T).reshape(P, 1, K, 2)
    by_turn = seen[:, None, :, None] * lit.colour.T[None, :, :, None] * turned
    return np.concatenate([by_colour.reshape(P, 3, 3 * K), by_turn.reshape(P, 3, 2 * K)], axis=-1)
