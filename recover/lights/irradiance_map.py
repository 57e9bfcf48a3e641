"""A map from normal to colour, and the depth, of a picture whose lights are too wide or too many to be found singly.

The pixels that see all the light whole lie on an ellipsoid, however wide the lights: they are the core, whose matrix
and rotation are known. Beyond the core the colour is a smooth function E(n) of the normal, a sum of few spherical
harmonics (``recover.geometry.harmonics``) with unknown coefficients. With one depth at each corner of blocks of pixels
both follow from the picture, by Gauss–Newton. Without a core they would not: a tilt of all normals toward one direction
changes E by little more than what the harmonics leave out, and on no picture such a fit came nearer than 2 to 10°. So
the slopes of the core are held at their known values.

The surface must be convex: where something stands in the light, E is not a function of the normal alone.

Source: R. Basri and D. W. Jacobs, "Lambertian reflectance and linear subspaces", IEEE TPAMI 25 (2003) 218–233.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from huesphere.recover.geometry.depth_grid import DepthGrid, variation_within_cells
from huesphere.recover.geometry.harmonics import Harmonics
from huesphere.recover.geometry.least_squares import Schedule, descend
from huesphere.recover.geometry.rays import of_relief
from huesphere.recover.geometry.slopes import normals_by_slopes, normals_of_slopes
from huesphere.recover.geometry.sphere import near_normals
from huesphere.recover.geometry.threads import in_threads
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

MOST_BLOCKS = 3500  # blocks of pixels, at most about so many: bounds the work
STEEPEST_N3 = 0.1  # normals of the start are no more edge on than this: their slopes grow without bound
START_WEIGHT = 1e-2  # of slopes that are only a start, beside those that are known
FIRST_DESCENT = replace(DESCENT, most_steps=10)  # of the surface that a search for lights begins with
RING_DESCENT = replace(DESCENT, most_steps=4)  # each time that the fit has grown by a ring
PIXELS_AT_ONCE = 16_384  # of a thread


@dataclass(frozen=True)
class Irradiance:
    """The map and the surface that explain the picture together."""

    normals: np.ndarray  # (H, W, 3) unit, camera frame, NaN off the object
    misfit: np.ndarray  # (H, W) |ρ − E(n)| over the brightest colour, root mean square of the channels; NaN off it
    misfit_of_start: np.ndarray  # (H, W) the same of the normals that the fit began with
    coefficients: np.ndarray  # (K, 3) of the harmonics of the last stage, over the brightest colour
    expected_residual: float  # what these harmonics, or the noise, may leave of a colour, over the brightest
    loss: float  # mean over the blocks
    steps: int  # of Gauss–Newton, all stages together

    @property
    def explains(self) -> np.ndarray:
        """Which pixels (H, W) the map explains."""
        return self.misfit < LIGHTS.outlier_deviations * self.expected_residual


@dataclass(frozen=True)
class _Given:
    """The picture in blocks of pixels, and the slopes that are known. Colours are over the brightest."""

    cells: DepthGrid
    ray: np.ndarray  # (P, 2), 0 where rays are parallel
    weight: np.ndarray  # (P,) of each block's colour
    core: np.ndarray  # (P,) bool, blocks of the core
    slope: np.ndarray  # (P, 2) of the start, those of the core as they are known
    information: np.ndarray  # (P, 2, 2) inverse covariance of the slopes of the core, 0 elsewhere


def fit_irradiance(problem: Problem, normals: np.ndarray, core: np.ndarray) -> Irradiance:
    """The map of the picture, and normals of all of the object, from ``normals`` (H, W, 3) of all of it as a start.

    ``core`` (H, W): pixels whose normals are known. Camera frame. Raises LinAlgError where the equations break down.
    """
    mask = problem.mask
    given = _given(problem, normals, core)
    brightest, block = float(problem.rgb[mask].max()), given.cells.block
    noise = problem.noise / brightest
    slope, steps = _grown(given), 0
    for degrees, residual in LIGHTS.harmonic_stages:
        harmonics = Harmonics(degrees)
        fit = _Fit(given, harmonics, max(residual, noise / block), slope)
        slope, coefficients, loss, more = fit.descend(slope)
        steps += more
    at_pixels = given.cells.normals_at_pixels(normals_of_slopes(slope, given.ray), mask)
    rho, sigma = problem.rgb[mask].astype(np.float64) / brightest, max(residual, noise)
    begun = np.nan_to_num(normals[mask].astype(np.float64))

    def colour_of(n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        values, gradients = harmonics.at(n)
        return values @ coefficients, np.einsum("pkx,kc->pcx", gradients, coefficients)

    def at(part: slice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        own = near_normals(rho[part], colour_of, at_pixels[part], sigma, LIGHTS.map_normal_deg)
        misfit, misfit_of_start = (_misfit(rho[part], harmonics, coefficients, n) for n in (own, begun[part]))
        return own, misfit, misfit_of_start

    parts = [slice(first, first + PIXELS_AT_ONCE) for first in range(0, len(rho), PIXELS_AT_ONCE)]
    out, misfit, of_start = (np.full((*mask.shape, *tail), np.nan) for tail in ((3,), (), ()))
    out[mask], misfit[mask], of_start[mask] = (np.concatenate(one) for one in zip(*in_threads(at, parts)))
    return Irradiance(out, misfit, of_start, coefficients, sigma, loss / len(given.cells), steps)


def _given(problem: Problem, normals: np.ndarray, core: np.ndarray) -> _Given:
    """The picture in blocks, the slopes of the ``core`` (H, W) held at those of ``normals`` (H, W, 3)."""
    mask = problem.mask
    block = block_size(mask, MOST_BLOCKS)
    rgb = np.where(mask[..., None], problem.rgb, 0.0) / float(problem.rgb[mask].max())
    cells = DepthGrid(rgb, mask, block, problem.ray)
    ray = np.zeros((len(cells), 2)) if cells.ray is None else cells.ray
    n = DepthGrid(np.where(mask[..., None], np.nan_to_num(normals), 0.0), mask, block).mean
    n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-9)
    known = share_of_blocks(core, mask, block) > WHOLE_BLOCK
    slope = _start(cells, of_relief(n, cells.ray), known)
    turn = normals_by_slopes(slope, ray)
    precision = known / np.radians(LIGHTS.core_deg) ** 2
    information = np.einsum("pxi,pxj->pij", turn, turn) * precision[:, None, None]
    seen = share_of_blocks(problem.seen, mask, block) > WHOLE_BLOCK
    weight = np.where(cells.well_within(LIGHTS.rim_px), 1.0, NEXT_TO_NOTHING) * np.maximum(seen, NEXT_TO_NOTHING)
    return _Given(cells, ray, weight, known, slope, information)


def first_surface(
    cells: DepthGrid, ray: np.ndarray, weight: np.ndarray, F: np.ndarray, core: np.ndarray, noise: float
) -> np.ndarray:
    """Slopes (P, 2) of all blocks from those of the ``core`` (P,), where colours are F n, by the smoothest of maps.

    ``weight`` (P,): how much each block's colour counts. ``F`` (3, 3) and ``noise``, the standard deviation of a
    block's channel, are over the brightest colour. Raises LinAlgError where the equations break down.
    """
    n = cells.mean @ np.linalg.inv(F).T
    n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-9)
    slope = _start(cells, of_relief(n, cells.ray), core)
    by_slope = F @ normals_by_slopes(slope, ray)
    precision = core / (noise**2 + LIGHTS.core_residual**2)
    information = np.einsum("pci,pcj->pij", by_slope, by_slope) * precision[:, None, None]
    given = _Given(cells, ray, weight, core, slope, information)
    slope = _grown(given)
    degrees, residual = LIGHTS.harmonic_stages[0]
    return _Fit(given, Harmonics(degrees), max(residual, noise), slope).descend(slope, FIRST_DESCENT)[0]


def _start(cells: DepthGrid, n: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Slopes (P, 2) of the depth that is nearest to the normals (P, 3), most of all to those ``known`` (P,)."""
    n = np.concatenate([n[:, :2], np.maximum(n[:, 2:], STEEPEST_N3)], axis=1)
    weight = np.where(known, 1.0, START_WEIGHT)
    wanted = -n[:, :2] / n[:, 2:] * weight[:, None]
    return cells.solve(cells.factor(weight, 0 * weight, weight), wanted[..., None])[..., 0]


def _grown(given: _Given) -> np.ndarray:
    """Slopes (P, 2) of all blocks: from the core outward, ring by ring; all at once the surface could fold over."""
    cells, slope = given.cells, given.slope
    degrees, sigma = LIGHTS.harmonic_stages[1]
    image, active = np.zeros((*cells.where.shape, 2)), np.zeros(cells.where.shape, bool)
    active[cells.where] = given.core
    while True:
        ring = ndimage.binary_dilation(active, np.ones((3, 3)), iterations=LIGHTS.ring_blocks) & cells.where
        if (ring == active).all():
            return slope
        image[cells.where] = slope
        nearest = ndimage.distance_transform_edt(~active, return_distances=False, return_indices=True)
        weight = np.where(active[cells.where], 1.0, START_WEIGHT)
        wanted = image[tuple(nearest)][cells.where] * weight[:, None]
        slope = cells.solve(cells.factor(weight, 0 * weight, weight), wanted[..., None])[..., 0]
        active = ring
        so_far = replace(given, weight=given.weight * active[cells.where])
        slope = _Fit(so_far, Harmonics(degrees), sigma, slope).descend(slope, RING_DESCENT)[0]


class _Fit:
    """Σ w |ρ − E(n(∇z))|² / σ² under Cauchy's weights, with the core's slopes and the light's size as priors.

    The priors are kept over 1/σ², as the weights are.
    """

    def __init__(self, given: _Given, harmonics: Harmonics, sigma: float, slope: np.ndarray) -> None:
        self.cells, self.ray, self.harmonics, self.sigma = given.cells, given.ray, harmonics, sigma
        self.held, self.information = given.slope, given.information * sigma**2
        self.cauchy = LIGHTS.outlier_deviations  # width of Cauchy's loss, in standard deviations
        self.ridge = (sigma / LIGHTS.largest_coefficient) ** 2
        values, gradients = harmonics.at(normals_of_slopes(slope, self.ray))
        self.weight = given.weight
        for _ in range(2):  # what a block with one slope cannot follow counts as noise
            coefficients = self.coefficients(values)
            J = np.einsum("pkx,pxd,kc->pcd", gradients, normals_by_slopes(slope, self.ray), coefficients, optimize=True)
            self.weight = given.weight / (1 + (variation_within_cells(self.cells, slope, J) / sigma) ** 2)

    def coefficients(self, values: np.ndarray) -> np.ndarray:
        """(K, 3) by least squares on the colours, at normals whose harmonics are ``values`` (P, K)."""
        weighted = values * self.weight[:, None]
        return np.linalg.solve(weighted.T @ values + self.ridge * np.eye(values.shape[1]), weighted.T @ self.cells.mean)

    def loss(self, slope: np.ndarray, coefficients: np.ndarray) -> float:
        values, _ = self.harmonics.at(normals_of_slopes(slope, self.ray))
        squares = ((self.cells.mean - values @ coefficients) ** 2).sum(axis=1) / self.sigma**2
        away = slope - self.held
        prior = np.einsum("pi,pij,pj->", away, self.information, away) + self.ridge * (coefficients**2).sum()
        c2 = self.cauchy**2
        return float((c2 * np.log1p(self.weight * squares / c2)).sum() + prior / self.sigma**2)

    def descend(self, slope: np.ndarray, schedule: Schedule = DESCENT) -> tuple[np.ndarray, np.ndarray, float, int]:
        """(slopes (P, 2), coefficients (K, 3), loss, steps) where Gauss–Newton from ``slope`` (P, 2) ends."""
        outcome = descend(
            (slope, self.coefficients(self.harmonics.at(normals_of_slopes(slope, self.ray))[0])),
            loss=lambda state: self.loss(*state),
            linearise=lambda state: self._equations(*state),
            step=lambda state, equations, damping: self._step(*state, equations, damping),
            schedule=schedule,
        )
        return *outcome.state, outcome.loss, outcome.steps

    def _equations(self, slope: np.ndarray, coefficients: np.ndarray) -> Equations:
        """Normal equations: W (P, 2, 2), g (P, 2) of slopes; H, h of coefficients, row by row; the cross terms."""
        values, gradients = self.harmonics.at(normals_of_slopes(slope, self.ray))
        e = self.cells.mean - values @ coefficients
        w = self.weight / (1 + self.weight * (e**2).sum(axis=1) / (self.cauchy * self.sigma) ** 2)
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
        self, slope: np.ndarray, coefficients: np.ndarray, equations: Equations, damping: float
    ) -> tuple[np.ndarray, np.ndarray]:
        schur, right, own, by_lights = without_depth(self.cells, equations, damping)
        H = equations[2]
        schur += (damping * self.ridge + 1e-12 * np.trace(H)) * np.eye(len(H))
        move = np.linalg.solve(schur, right)
        return slope + own - by_lights @ move, coefficients + move.reshape(coefficients.shape)


def _misfit(rho: np.ndarray, harmonics: Harmonics, coefficients: np.ndarray, n: np.ndarray) -> np.ndarray:
    """Residuals of colours ``rho`` (P, 3) at normals (P, 3), root mean square of the channels, (P,)."""
    return np.sqrt(((rho - harmonics.at(n)[0] @ coefficients) ** 2).mean(axis=1))  # type: ignore[no-any-return]
