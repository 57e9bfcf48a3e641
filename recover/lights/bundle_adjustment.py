"""Distant lights and the surface that they light, by Gauss–Newton over all of them: directions, colours, depth.

Where light k is seen it adds b_k (a_k·n), and where the surface turns away it adds nothing: ρ = Σ b_k max(0, a_k·n) of
every pixel. Unknown are the depth at the corners of blocks of pixels and five numbers a light. The depths are
eliminated: their equations have a narrow band (``recover.geometry.depth_grid``), and what is left is as large as the
lights are many.

The clamped cosine has a kink at its terminator, which a poor start is on the wrong side of. So it is softened at first,
w ln(1 + e^{x/w}), as is the noise, and both are sharpened step by step; and blocks of pixels that are known to see
every light are taken to do so from the start, which holds Σ b_k a_kᵀ, as does what is known of it beforehand. Residuals
count by Cauchy's weights: cast shadows, steps in depth and light of other surfaces are outliers.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit

from huesphere.recover.geometry.depth_grid import Cells, varied
from huesphere.recover.geometry.least_squares import Schedule, descend
from huesphere.recover.geometry.slopes import normals_by_slopes, normals_of_slopes

CAUCHY = 3.0  # standard deviations, beyond which a residual counts ever less
RIM, NOTHING = 4, 1e-4  # pixels from the outline, where a block cannot follow the surface; their weight
FULL = 0.95  # share of a block that must be of the core, or be seen
BRIGHTEST, DARK = 0.5, 1e-3  # of a light's colour, over the brightest pixel: what it may be, and how far below 0
FARTHEST = 0.2  # radians that a light turns in one step
DESCENT = Schedule(
    first_damping=1e-2,
    raise_by=10.0,
    lower_by=10.0,
    most_steps=25,
    trials=6,
    relative_gain=1e-3,
    least_raised=1e-2,
)
OF_DEPTH, OF_ALL, LEAST = 1e-2, 1e-3, 1e-7  # how the damping is shared out, and what holds a slope that nothing sees


@dataclass(frozen=True)
class Expected:
    """F (3, 3) over the brightest pixel as it is known beforehand, and how surely, by entries row by row (9, 9)."""

    F: np.ndarray
    precision: np.ndarray


def expected(F: np.ndarray, turn: np.ndarray, stretch: float) -> Expected:
    """An F (3, 3) whose normals F⁻¹ρ may be turned, ``turn`` (3, 3) in radians², and longer or shorter by ``stretch``.

    F⁻¹δF is the small rotation −[ω]× and a symmetric matrix.
    """
    turned, stretched = np.zeros((3, 9)), np.zeros((9, 9))
    for i in range(3):
        for j in range(3):
            turned[:, 3 * i + j] = -0.5 * np.cross(np.eye(3)[i], np.eye(3)[j])
            stretched[3 * i + j, 3 * i + j] += 0.5
            stretched[3 * i + j, 3 * j + i] += 0.5
    precision = turned.T @ np.linalg.inv(turn) @ turned + stretched.T @ stretched / stretch**2
    by_F = np.kron(np.linalg.inv(F), np.eye(3))
    return Expected(F, by_F.T @ precision @ by_F)


@dataclass(frozen=True)
class Lit:
    """A surface and its lights."""

    slope: np.ndarray  # (P, 2) of the blocks of pixels
    toward: np.ndarray  # (K, 3) unit, camera frame
    colour: np.ndarray  # (K, 3) over the brightest pixel
    loss: float  # mean over the blocks: 0.6 or so where noise alone is left over

    @property
    def F(self) -> np.ndarray:
        """(3, 3) of a pixel that sees every light, over the brightest pixel."""
        return self.colour.T @ self.toward


class Bundle:
    """The picture in blocks, and the fit to them."""

    def __init__(
        self,
        rgb: np.ndarray,
        mask: np.ndarray,
        core: np.ndarray,
        noise: float,
        cells: int,
        ray: np.ndarray | None = None,
        seen: np.ndarray | None = None,
        known: Expected | None = None,
    ) -> None:
        """Of ``mask`` (H, W) in the picture ``rgb`` (H, W, 3), at most about so many blocks.

        ``core`` (H, W): pixels that see every light. ``noise``: standard deviation of a channel, picture units.
        ``ray`` (H, W, 2): of a picture in perspective. ``seen`` (H, W), if given: pixels whose colours count.
        ``known``: F, as far as it is.
        """
        self.known = known
        self.bright = float(rgb[mask].max())
        self.block = max(1, int(np.ceil(np.sqrt(mask.sum() / cells))))
        self.mask, self.noise = mask, noise / self.bright / self.block
        self.cells = Cells(np.where(mask[..., None], rgb, 0.0) / self.bright, mask, self.block, ray)
        self.ray = np.zeros((len(self.cells), 2)) if self.cells.ray is None else self.cells.ray
        self.core = self._share(core) > FULL
        shown = np.ones(len(self.cells), bool) if seen is None else self._share(seen) > FULL
        self.sure = np.where(self.cells.well_within(RIM) & shown, 1.0, NOTHING)

    def _share(self, which: np.ndarray) -> np.ndarray:
        """Of each block (P,), how much is in ``which`` (H, W)."""
        return Cells((which & self.mask)[..., None].astype(float), self.mask, self.block).N[:, 0]

    def normals(self, slope: np.ndarray) -> np.ndarray:
        """(P, 3) of the slopes (P, 2)."""
        return normals_of_slopes(slope, self.ray)

    def fit(self, lit: Lit, width: float, sigma: float, steps: int, *, tied: bool) -> Lit:
        """``lit`` after so many steps, or where they lead nowhere.

        ``width``: cosine over which a terminator is softened. ``sigma``: standard deviation that residuals are held
        against. ``tied``: the core sees every light, whichever side of terminators it is on.
        """
        return _Descent(self, lit, width, sigma, tied).steps(lit, steps)

    def residual(self, lit: Lit) -> np.ndarray:
        """What the lights leave of the blocks' colours (P, 3)."""
        shade = np.maximum(self.normals(lit.slope) @ lit.toward.T, 0.0)
        return self.cells.N - shade @ lit.colour  # type: ignore[no-any-return]

    def covariance(self, lit: Lit, sigma: float) -> np.ndarray:
        """(5K, 5K) of the lights' colours, then of their turns ``across`` their directions, depth being unknown too."""
        return _Descent(self, lit, sigma, sigma, tied=False).covariance(lit)


class _Descent:
    """Levenberg–Marquardt at one width and sigma."""

    def __init__(self, of: Bundle, lit: Lit, width: float, sigma: float, tied: bool) -> None:
        self.of, self.width, self.sigma = of, width, sigma
        self.tied = of.core if tied else np.zeros(len(of.core), bool)
        *_, seen = self._shaded(lit)
        J = _by_normal(seen, lit) @ normals_by_slopes(lit.slope, of.ray)
        # What a block with one slope cannot follow counts as noise.
        self.weight = of.sure / (1 + (varied(of.cells, lit.slope, J) / sigma) ** 2)

    def steps(self, lit: Lit, count: int) -> Lit:
        outcome = descend(
            lit,
            loss=self.loss,
            linearise=self._equations,
            step=self._moved,
            schedule=replace(DESCENT, most_steps=count),
        )
        return replace(outcome.state, loss=outcome.loss)

    def _shaded(self, lit: Lit) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(normals (P, 3), softened cosines of the lights (P, K), how much each is seen (P, K))."""
        n = self.of.normals(lit.slope)
        cosine = n @ lit.toward.T
        shade, seen = self.width * np.logaddexp(0.0, cosine / self.width), expit(cosine / self.width)
        shade[self.tied], seen[self.tied] = cosine[self.tied], 1.0
        return n, shade, seen

    def loss(self, lit: Lit) -> float:
        """Mean over the blocks."""
        _, shade, _ = self._shaded(lit)
        squares = ((self.of.cells.N - shade @ lit.colour) ** 2).sum(axis=1) / self.sigma**2
        sizes = (_held(lit.colour) * lit.colour**2).sum()
        if self.of.known is not None:
            away = (lit.F - self.of.known.F).ravel()
            sizes += away @ self.of.known.precision @ away
        return float((CAUCHY**2 * np.log1p(self.weight * squares / CAUCHY**2)).sum() + sizes) / len(squares)

    def _equations(self, lit: Lit) -> tuple[np.ndarray, ...]:
        """W (P, 2, 2), g (P, 2) of the slopes; H, h of the lights: colours, then turns; what is between them."""
        n, shade, seen = self._shaded(lit)
        e = self.of.cells.N - shade @ lit.colour
        w = self.weight / (1 + self.weight * (e**2).sum(axis=1) / (CAUCHY * self.sigma) ** 2) / self.sigma**2
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
        if self.of.known is not None:
            of_F = F_by_lights(lit)
            pull = of_F @ self.of.known.precision
            H += pull @ of_F.T
            h -= pull @ (lit.F - self.of.known.F).ravel()
        return W, g, H, h, between

    def _eliminated(self, equations: tuple[np.ndarray, ...], damping: float) -> tuple[np.ndarray, ...]:
        """(S, s) of the lights when depth is eliminated, and slopes by themselves and by the lights."""
        W, g, H, h, between = equations
        least = LEAST * float(W.max())
        factors = self.of.cells.factor(W[:, 0, 0] + least, W[:, 0, 1], W[:, 1, 1] + least, damping=damping * OF_DEPTH)
        moves = self.of.cells.solve(factors, np.concatenate([g[..., None], between], axis=-1))
        own, by_lights = moves[..., 0], moves[..., 1:]
        S = H - np.einsum("pdk,pdl->kl", between, by_lights, optimize=True)
        return S, h - np.einsum("pdk,pd->k", between, own), own, by_lights

    def _moved(self, lit: Lit, equations: tuple[np.ndarray, ...], damping: float) -> Lit:
        S, s, own, by_lights = self._eliminated(equations, damping)
        size = np.maximum(np.diag(S), 0.0)
        move = np.linalg.solve(S + damping * np.diag(size + OF_ALL * size.mean()), s)
        count = len(lit.toward)
        turns = move[3 * count :].reshape(count, 2)
        share = 1 / max(1.0, float(np.abs(turns).max()) / FARTHEST)
        toward = lit.toward + share * np.einsum("kd,kdx->kx", turns, across(lit.toward))
        return Lit(
            slope=lit.slope + share * (own - by_lights @ move),
            toward=toward / np.linalg.norm(toward, axis=1, keepdims=True),
            colour=lit.colour + share * move[: 3 * count].reshape(count, 3),
            loss=np.nan,
        )

    def covariance(self, lit: Lit) -> np.ndarray:
        S, *_ = self._eliminated(self._equations(lit), 0.0)
        return np.linalg.pinv(S, hermitian=True)


def across(toward: np.ndarray) -> np.ndarray:
    """Two unit vectors (K, 2, 3) across each of ``toward`` (K, 3)."""
    other = np.where(np.abs(toward[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = np.cross(toward, other)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(toward, first)], axis=1)


def F_by_lights(lit: Lit) -> np.ndarray:
    """Change (5K, 9) of F = Σ b_k a_kᵀ, row by row, by the lights' colours, then by their turns ``across``."""
    count, beside = len(lit.toward), across(lit.toward)
    change = np.zeros((5 * count, 3, 3))
    for k in range(count):
        for channel in range(3):
            change[3 * k + channel, channel] = lit.toward[k]
        for i in range(2):
            change[3 * count + 2 * k + i] = np.outer(lit.colour[k], beside[k, i])
    return change.reshape(5 * count, 9)


def _held(colour: np.ndarray) -> np.ndarray:
    """What holds colours (K, 3) to 0: little, and firmly where they are negative."""
    return np.where(colour < 0, DARK, BRIGHTEST) ** -2


def _by_normal(seen: np.ndarray, lit: Lit) -> np.ndarray:
    """Change (P, 3, 3) of colours by the normal, of which the lights are ``seen`` (P, K)."""
    return (seen @ (lit.colour[:, :, None] * lit.toward[:, None, :]).reshape(-1, 9)).reshape(-1, 3, 3)  # type: ignore[no-any-return]


def _by_lights(n: np.ndarray, shade: np.ndarray, seen: np.ndarray, lit: Lit) -> np.ndarray:
    """Change (P, 3, 5K) of colours by the lights' colours (K, 3), then by the turns (K, 2) across their directions."""
    P, K = shade.shape
    by_colour = np.zeros((P, 3, K, 3))
    for channel in range(3):
        by_colour[:, channel, :, channel] = shade
    turned = (n @ across(lit.toward).reshape(-1, 3).T).reshape(P, 1, K, 2)
    by_turn = seen[:, None, :, None] * lit.colour.T[None, :, :, None] * turned
    return np.concatenate([by_colour.reshape(P, 3, 3 * K), by_turn.reshape(P, 3, 2 * K)], axis=-1)
