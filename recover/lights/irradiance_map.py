"""Every pixel under lights too wide or too many to be told apart: depth and a map from normal to colour, together.

The pixels that see all the light whole lie on an ellipsoid, however wide the lights: they are the core, whose matrix
and rotation are known. Beyond it the colour is a smooth function E(n) of the normal (``recover.geometry.harmonics``),
its coefficients unknown; with one depth at each corner of the pixels both follow from the picture, by Gauss–Newton.
Alone they would not: a tilt of all normals toward one direction changes E by little more than what the harmonics leave
out, and no picture was found in which they come nearer than 2 to 10°. The core's slopes, held, decide that.

A convex surface is taken for granted: where something stands in the light, E is not a function of the normal.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from huesphere.recover.geometry.depth_grid import Cells, varied
from huesphere.recover.geometry.harmonics import Harmonics
from huesphere.recover.geometry.least_squares import Schedule, descend
from huesphere.recover.geometry.rays import of_relief
from huesphere.recover.geometry.slopes import normals_by_slopes, normals_of_slopes
from huesphere.recover.geometry.sphere import near_normals
from huesphere.recover.geometry.threads import in_threads

LADDER = (((0, 1, 2), 3e-3), ((0, 1, 2, 4), 1e-3), ((0, 1, 2, 4, 6), 3e-4))  # degrees, and what they leave out
LIGHT = 0.3  # of a coefficient, over the brightest colour
MOST_CELLS = 3500
ROUNDING = 3e-4  # of a cell's colour, over the brightest
CORE_DEG, WHOLE = 0.3, 0.95  # how well a cell of the core is held, and the share of it that is core
STEEPEST_N3, DOUBTFUL = 0.1, 1e-2  # of the start; weight of its normals outside the core
CAUCHY = 3.0  # standard deviations, beyond which a residual counts ever less
DESCENT = Schedule(
    first_damping=1e-3,
    raise_by=10.0,
    lower_by=10.0,
    most_steps=25,
    trials=6,
    relative_gain=1e-3,
    least_raised=1e-2,
)
FIRST_DESCENT = replace(DESCENT, most_steps=10)  # of the surface that a search begins with
RING, OF_RING = 2, replace(DESCENT, most_steps=4)  # cells that the fit grows by, and how it is fitted then
RIM, NOTHING = 4, 1e-4  # pixels from the outline that a block cannot follow, and their weight
LEAVES = 3.0  # times what the map may leave out: a pixel is explained
NEAR_DEG = 3.0  # of the cell's normal, where a pixel's own is sought
AT_ONCE = 16_384  # pixels


@dataclass(frozen=True)
class Irradiance:
    """The map and the surface that explain the picture."""

    normals: np.ndarray  # (H, W, 3) unit, NaN off the object
    misfit: np.ndarray  # (H, W) |ρ − E(n)| over the brightest colour, root mean square of the channels; NaN off it
    misfit_of_start: np.ndarray  # (H, W) the same of the normals that it was begun with
    coefficients: np.ndarray  # (K, 3) of the last harmonics, over the brightest colour
    left_out: float  # what the last harmonics, or the noise, may leave of a colour, over the brightest
    loss: float
    steps: int

    @property
    def explains(self) -> np.ndarray:
        """Which pixels (H, W) the map explains."""
        return self.misfit < LEAVES * self.left_out


def fit_irradiance(
    rgb: np.ndarray,
    mask: np.ndarray,
    normals: np.ndarray,
    core: np.ndarray,
    noise: float,
    ray: np.ndarray | None = None,
    seen: np.ndarray | None = None,
) -> Irradiance:
    """The map of the picture (H, W, 3) and normals of all of ``mask`` (H, W), from ``normals`` (H, W, 3) as a start.

    ``core`` (H, W): pixels whose normals are known. ``noise``: standard deviation of a channel, picture units.
    ``ray`` (H, W, 2): of a picture in perspective. ``seen`` (H, W), if given: pixels whose colours count. Raises
    LinAlgError where the equations break down.
    """
    bright = float(rgb[mask].max())
    block = max(1, int(np.ceil(np.sqrt(mask.sum() / MOST_CELLS))))
    cells = Cells(np.where(mask[..., None], rgb, 0.0) / bright, mask, block, ray)
    along = np.zeros((len(cells), 2)) if cells.ray is None else cells.ray
    n = Cells(np.where(mask[..., None], np.nan_to_num(normals), 0.0), mask, block).N
    n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-9)
    known = Cells(np.where(mask, core, False)[..., None].astype(float), mask, block).N[:, 0] > WHOLE
    held = _start(cells, of_relief(n, cells.ray), known)
    turn = normals_by_slopes(held, along)
    information = np.einsum("pxi,pxj->pij", turn, turn) * (known / np.radians(CORE_DEG) ** 2)[:, None, None]
    shown = 1.0 if seen is None else Cells(seen[..., None].astype(float), mask, block).N[:, 0] > WHOLE
    weight = np.where(cells.well_within(RIM), 1.0, NOTHING) * np.maximum(shown, NOTHING)
    slope, steps = _grown(cells, along, weight, held, information, known), 0
    for degrees, left_out in LADDER:
        sigma, harmonics = max(left_out, noise / bright / block), Harmonics(degrees)
        fit = _Fit(cells, along, harmonics, sigma, held, information * sigma**2, weight, slope)
        slope, coefficients, loss, more = fit.descend(slope)
        steps += more
    at_pixels = cells.normals_at_pixels(normals_of_slopes(slope, along), mask)
    rho, sigma = rgb[mask].astype(np.float64) / bright, max(left_out, noise / bright)
    begun = np.nan_to_num(normals[mask].astype(np.float64))

    def colour_of(n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        values, gradients = harmonics.at(n)
        return values @ coefficients, np.einsum("pkx,kc->pcx", gradients, coefficients)

    def at(part: slice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        own = near_normals(rho[part], colour_of, at_pixels[part], sigma, NEAR_DEG)
        left, left_of_start = (_left(rho[part], harmonics, coefficients, n) for n in (own, begun[part]))
        return own, left, left_of_start

    parts = [slice(first, first + AT_ONCE) for first in range(0, len(rho), AT_ONCE)]
    out, misfit, of_start = (np.full((*mask.shape, *tail), np.nan) for tail in ((3,), (), ()))
    out[mask], misfit[mask], of_start[mask] = (np.concatenate(one) for one in zip(*in_threads(at, parts)))
    return Irradiance(out, misfit, of_start, coefficients, sigma, loss / len(cells), steps)


def first_surface(
    cells: Cells, ray: np.ndarray, weight: np.ndarray, F: np.ndarray, core: np.ndarray, noise: float
) -> np.ndarray:
    """Slopes (P, 2) of all cells from those of the ``core`` (P,), where colours are F n, by the smoothest of maps.

    ``weight`` (P,): how much each cell's colour counts. ``F`` (3, 3) and ``noise``, the standard deviation of a cell's
    channel, are over the brightest colour.
    """
    n = cells.N @ np.linalg.inv(F).T
    n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-9)
    held = _start(cells, of_relief(n, cells.ray), core)
    by_slope = F @ normals_by_slopes(held, ray)
    known = core / (noise**2 + ROUNDING**2)
    information = np.einsum("pci,pcj->pij", by_slope, by_slope) * known[:, None, None]
    slope = _grown(cells, ray, weight, held, information, core)
    degrees, left_out = LADDER[0]
    sigma = max(left_out, noise)
    fit = _Fit(cells, ray, Harmonics(degrees), sigma, held, information * sigma**2, weight, slope)
    return fit.descend(slope, FIRST_DESCENT)[0]


def _start(cells: Cells, n: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Slopes (P, 2) of the depth that is nearest to the normals (P, 3), those that are ``known`` (P,) first."""
    n = np.concatenate([n[:, :2], np.maximum(n[:, 2:], STEEPEST_N3)], axis=1)
    weight = np.where(known, 1.0, DOUBTFUL)
    wanted = -n[:, :2] / n[:, 2:] * weight[:, None]
    return cells.solve(cells.factor(weight, 0 * weight, weight), wanted[..., None])[..., 0]


def _grown(
    cells: Cells, ray: np.ndarray, weight: np.ndarray, held: np.ndarray, information: np.ndarray, known: np.ndarray
) -> np.ndarray:
    """Slopes (P, 2) of all cells: from the ``known`` (P,) outward, ring by ring, lest the surface fold over."""
    (degrees, sigma), image, slope = LADDER[1], np.zeros((*cells.where.shape, 2)), held
    active = np.zeros(cells.where.shape, bool)
    active[cells.where] = known
    while True:
        ring = ndimage.binary_dilation(active, np.ones((3, 3)), iterations=RING) & cells.where
        if (ring == active).all():
            return slope
        image[cells.where] = slope
        nearest = ndimage.distance_transform_edt(~active, return_distances=False, return_indices=True)
        sure = np.where(active[cells.where], 1.0, DOUBTFUL)
        wanted = image[tuple(nearest)][cells.where] * sure[:, None]
        slope = cells.solve(cells.factor(sure, 0 * sure, sure), wanted[..., None])[..., 0]
        active = ring
        shown = weight * active[cells.where]
        fit = _Fit(cells, ray, Harmonics(degrees), sigma, held, information * sigma**2, shown, slope)
        slope = fit.descend(slope, OF_RING)[0]


class _Fit:
    """Σ w |ρ − E(n(∇z))|² / σ² under Cauchy's weights, with the core's slopes and the light's size as priors."""

    def __init__(
        self,
        cells: Cells,
        ray: np.ndarray,
        harmonics: Harmonics,
        sigma: float,
        held: np.ndarray,
        information: np.ndarray,
        weight: np.ndarray,
        slope: np.ndarray,
    ) -> None:
        self.cells, self.ray, self.harmonics, self.sigma = cells, ray, harmonics, sigma
        self.held, self.information = held, information  # slopes (P, 2), and how surely (P, 2, 2), over 1/σ²
        self.ridge = (sigma / LIGHT) ** 2
        values, gradients = harmonics.at(normals_of_slopes(slope, ray))
        self.weight = weight
        for _ in range(2):  # what a cell with one slope cannot follow counts as noise
            coefficients = self.coefficients(values)
            J = np.einsum("pkx,pxd,kc->pcd", gradients, normals_by_slopes(slope, ray), coefficients, optimize=True)
            self.weight = weight / (1 + (varied(self.cells, slope, J) / sigma) ** 2)

    def coefficients(self, values: np.ndarray) -> np.ndarray:
        """(K, 3) nearest to the colours, at normals whose harmonics are ``values`` (P, K)."""
        weighted = values * self.weight[:, None]
        return np.linalg.solve(weighted.T @ values + self.ridge * np.eye(values.shape[1]), weighted.T @ self.cells.N)

    def loss(self, slope: np.ndarray, coefficients: np.ndarray) -> float:
        values, _ = self.harmonics.at(normals_of_slopes(slope, self.ray))
        squares = ((self.cells.N - values @ coefficients) ** 2).sum(axis=1) / self.sigma**2
        away = slope - self.held
        prior = np.einsum("pi,pij,pj->", away, self.information, away) + self.ridge * (coefficients**2).sum()
        return float((CAUCHY**2 * np.log1p(self.weight * squares / CAUCHY**2)).sum() + prior / self.sigma**2)

    def descend(self, slope: np.ndarray, schedule: Schedule = DESCENT) -> tuple[np.ndarray, np.ndarray, float, int]:
        """(slopes, coefficients, loss, steps) where Gauss–Newton ends."""
        outcome = descend(
            (slope, self.coefficients(self.harmonics.at(normals_of_slopes(slope, self.ray))[0])),
            loss=lambda state: self.loss(*state),
            linearise=lambda state: self._equations(*state),
            step=lambda state, equations, damping: self._step(*state, equations, damping),
            schedule=schedule,
        )
        return *outcome.state, outcome.loss, outcome.steps

    def _equations(self, slope: np.ndarray, coefficients: np.ndarray) -> tuple[np.ndarray, ...]:
        """W (P, 2, 2), g (P, 2) of the slopes; H, h of the coefficients, row by row; what is between them."""
        values, gradients = self.harmonics.at(normals_of_slopes(slope, self.ray))
        e = self.cells.N - values @ coefficients
        w = self.weight / (1 + self.weight * (e**2).sum(axis=1) / (CAUCHY * self.sigma) ** 2)
        J = np.einsum("pkx,pxd,kc->pcd", gradients, normals_by_slopes(slope, self.ray), coefficients, optimize=True)
        W = np.einsum("pci,pcj->pij", J, J) * w[:, None, None] + self.information
        g = np.einsum("pci,pc->pi", J, e) * w[:, None]
        g -= np.einsum("pij,pj->pi", self.information, slope - self.held)
        K = len(self.harmonics)
        between = (np.einsum("pcd,pk->pdkc", J, values) * w[:, None, None, None]).reshape(len(slope), 2, 3 * K)
        weighted = values * w[:, None]
        H = np.kron(weighted.T @ values + self.ridge * np.eye(K), np.eye(3))
        h = (weighted.T @ e - self.ridge * coefficients).ravel()
        return W, g, H, h, between

    def _step(
        self, slope: np.ndarray, coefficients: np.ndarray, equations: tuple[np.ndarray, ...], damping: float
    ) -> tuple[np.ndarray, np.ndarray]:
        W, g, H, h, between = equations
        least = 1e-7 * float(W.max())
        factors = self.cells.factor(W[:, 0, 0] + least, W[:, 0, 1], W[:, 1, 1] + least, damping=damping * 1e-2)
        moves = self.cells.solve(factors, np.concatenate([g[..., None], between], axis=-1))
        by_slope, by_light = moves[..., 0], moves[..., 1:]
        schur = H - np.einsum("pdk,pdl->kl", between, by_light, optimize=True)
        schur += (damping * self.ridge + 1e-12 * np.trace(H)) * np.eye(len(H))
        move = np.linalg.solve(schur, h - np.einsum("pdk,pd->k", between, by_slope))
        return slope + by_slope - by_light @ move, coefficients + move.reshape(coefficients.shape)


def _left(rho: np.ndarray, harmonics: Harmonics, coefficients: np.ndarray, n: np.ndarray) -> np.ndarray:
    """What the map leaves of colours ``rho`` (P, 3) at normals (P, 3), root mean square of the channels, (P,)."""
    return np.sqrt(((rho - harmonics.at(n)[0] @ coefficients) ** 2).mean(axis=1))  # type: ignore[no-any-return]
