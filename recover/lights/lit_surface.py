"""The lights of a noisy picture, all at once: how many, where, of what colours, and the surface that they light.

One by one (``recover.lights.from_shadows``) lights are found where pixels show each of them singly, which takes little
noise. Together the whole picture determines them, as far as each light is distant: ρ = Σ b_k max(0, a_k·n) is a map
from normal to colour that few lights make, and few surfaces fit (``recover.lights.bundle_adjustment``). The steps:

- The smoothest of maps carries the surface outward from the pixels that see every light
  (``recover.lights.irradiance_map``).
- On that surface, non-negative least squares finds which lights of a grid of directions would make the picture. The
  surface is a few degrees off, so that each light comes out as many weak ones: their clusters are the first guess.
- Lights and surface are fitted together on coarse blocks of pixels, terminators softened at first. Lights that come to
  lie on one another are merged, faint ones dropped. Then the grid is searched again, on the improved surface.
- The best result is fitted to fine blocks, where no block is known beforehand to see every light.

That the lights are *few* matters: with as many as the grid has, a surface that is tilted by 10° explains the picture as
well as the true one does, with other lights.
"""

import contextlib
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import nnls

from huesphere.recover.geometry.sphere import fibonacci
from huesphere.recover.geometry.threads import in_threads
from huesphere.recover.lights.bundle_adjustment import Bundle, F_by_lights, LitBlocks, prior_on_F
from huesphere.recover.lights.irradiance_map import first_surface
from huesphere.recover.lights.parameters import LIGHTS
from huesphere.recover.problem import Problem
from huesphere.recover.solution import Solution

FINE_BLOCKS = 5000  # blocks of the last fit, at most about so many: bounds the work
GRID_DIRECTIONS = 800  # over the whole sphere, of which those in front count: bounds the work
GRID_ROUNDS = 2  # further searches of the grid, at most
FEWEST_BLOCKS = 3  # blocks of the core, and twice as many of all, without which there is nothing to fit
MOST_LIGHTS = 12  # clusters of the grid: more lights than this have never been needed
CALM_LOSS = 0.7  # mean loss of a block that noise alone leaves: no further attempt can better it
LEAST_IMPROVEMENT = 0.01  # of that loss, by which a further search of the grid must lower it to go on
AGAIN_DEG = 15.0  # within which grid directions are one light in further searches: 12 and 20 do as well
LEAST_TURN_DEG = 0.2  # standard deviation of the rotation of F, at least: a prior without any would be singular
STEPS, FINE_STEPS = 10, 8  # of the fit, before lights are counted anew
RECOUNTS = 3  # times that lights are counted anew, at most
REWEIGHTINGS = 3  # of the least squares on the grid
RIDGE = 1e-6  # of the mean diagonal of the grid's equations, which are nearly singular


@dataclass(frozen=True)
class LitSurface:
    """The lights and the surface that explain the picture together."""

    toward: np.ndarray  # (K, 3) unit, camera frame, toward each light
    colour: np.ndarray  # (K, 3) picture units, what a surface that faces the light gets of it
    F: np.ndarray  # (3, 3) Σ colour towardᵀ, of a pixel that sees every light, picture units
    normals: np.ndarray  # (H, W, 3) unit, of the object's pixels, interpolated between blocks; NaN off the object
    explained: float  # share of the blocks whose colour is explained to within noise
    loss: float  # mean over the blocks; 0.6 to 0.8 of noise, to 1.5 of detail besides, 2 to 5 where it is wrong
    covariance: np.ndarray  # (9, 9) of F row by row, picture units squared, from noise alone


def lit_surface(problem: Problem, solution: Solution) -> LitSurface:
    """The lights and the surface of the object, joint estimation from all its pixels.

    ``solution``: pixels that see every light (inlier) and their F, its rotation known to 10° or so as its covariance
    says. Raises LinAlgError where the equations break down, or too few blocks are there to begin with;
    RuntimeError where non-negative least squares does not converge.
    """
    turn = solution.rotation_covariance + np.radians(LEAST_TURN_DEG) ** 2 * np.eye(3)
    brightest = problem.rgb[problem.mask].max()
    prior = prior_on_F(solution.F / brightest, turn, LIGHTS.stretch_for_turn * float(np.sqrt(np.trace(turn))))
    fine = Bundle(problem, solution.inlier, FINE_BLOCKS, prior)
    sigma, ends = max(LIGHTS.least_block_noise, fine.noise), []
    for blocks, cluster_deg in LIGHTS.attempts:
        coarse = Bundle(problem, solution.inlier, blocks, prior)
        with contextlib.suppress(np.linalg.LinAlgError):
            ends.append(_refined(coarse, fine, _searched(coarse, prior.F, cluster_deg), sigma))
        if ends and ends[-1].loss < CALM_LOSS:
            break
    if not ends:
        raise np.linalg.LinAlgError("no attempt at lights and surface came to an end")
    lit = min(ends, key=lambda end: end.loss)
    sigma, by_lights = sigma * LIGHTS.fine_softening[-1][1], F_by_lights(lit)
    squares = (fine.residual(lit) ** 2).sum(axis=1)[fine.trusted] / sigma**2
    normals = np.full(problem.rgb.shape, np.nan)
    normals[problem.mask] = fine.cells.normals_at_pixels(fine.normals(lit.slope), problem.mask)
    return LitSurface(
        toward=lit.toward,
        colour=lit.colour * fine.brightest,
        F=lit.F * fine.brightest,
        normals=normals,
        explained=float((squares < LIGHTS.outlier_deviations**2).mean()),
        loss=lit.loss,
        covariance=by_lights.T @ fine.covariance(lit, sigma) @ by_lights * fine.brightest**2,
    )


def _refined(coarse: Bundle, fine: Bundle, lit: LitBlocks, sigma: float) -> LitBlocks:
    """What was found on ``coarse`` blocks, fitted to ``fine`` ones whose noise is ``sigma``."""
    lit = replace(lit, slope=_carried(coarse, fine, lit.slope))
    for width, times in LIGHTS.fine_softening:
        lit = _counted(fine, lit, _Stage(width, times * sigma, fine=True))
    return lit


def _searched(bundle: Bundle, F: np.ndarray, cluster_deg: tuple[float, ...]) -> LitBlocks:
    """The best of several searches on coarse blocks, from F (3, 3) over the brightest pixel."""
    if (bundle.core & bundle.trusted).sum() < FEWEST_BLOCKS or bundle.trusted.sum() < 2 * FEWEST_BLOCKS:
        raise np.linalg.LinAlgError("too few blocks well within the object, or its core")
    first, later = LIGHTS.grid_residuals
    slope = first_surface(bundle.cells, bundle.ray, bundle.trust, F, bundle.core, bundle.noise)
    best = min(_from_grid(bundle, slope, first, cluster_deg, LIGHTS.softening), key=lambda lit: lit.loss)
    for _ in range(GRID_ROUNDS):
        softening = LIGHTS.softening[1:]  # the surface is nearer now: its terminators need less of it
        again = min(_from_grid(bundle, best.slope, later, (AGAIN_DEG,), softening), key=lambda lit: lit.loss)
        if again.loss > best.loss - LEAST_IMPROVEMENT:
            break
        best = again
    return best


def _from_grid(
    bundle: Bundle,
    slope: np.ndarray,
    sigma: float,
    cluster_deg: tuple[float, ...],
    softening: tuple[tuple[float, float], ...],
) -> list[LitBlocks]:
    """Fits from the lights that a grid of directions has on the surface of these slopes (P, 2), one for each angle.

    Grid directions within an angle of ``cluster_deg`` are one light. ``sigma``: what residuals on the grid are held
    against, over the brightest pixel.
    """
    grid = fibonacci(GRID_DIRECTIONS)
    grid = grid[grid[:, 2] > 0]
    strength = _on_grid(bundle, slope, grid, sigma)

    def fitted(deg: float) -> LitBlocks:
        toward = _clusters(grid, strength.sum(axis=1), np.cos(np.radians(deg)))
        lit = LitBlocks(slope, toward, _on_grid(bundle, slope, toward, sigma), np.inf)
        for width, sigma_then in softening:
            lit = _counted(bundle, lit, _Stage(width, sigma_then, fine=False))
        return lit

    return in_threads(fitted, cluster_deg)


def _on_grid(bundle: Bundle, slope: np.ndarray, toward: np.ndarray, sigma: float) -> np.ndarray:
    """Colours (K, 3), none negative, of lights ``toward`` (K, 3) that make the picture of these slopes (P, 2).

    Non-negative least squares under Cauchy's weights for residuals of standard deviation ``sigma``, over the brightest.
    """
    n, rho, weight = bundle.normals(slope), bundle.cells.mean, bundle.trust
    shade = np.maximum(n @ toward.T, 0.0)
    shade[bundle.core] = n[bundle.core] @ toward.T
    for _ in range(REWEIGHTINGS):
        weighted = shade * weight[:, None]
        gram = weighted.T @ shade
        gram += RIDGE * np.trace(gram) / len(gram) * np.eye(len(gram))
        root = np.linalg.cholesky(gram).T
        wanted = np.linalg.solve(root.T, weighted.T @ rho)
        colour = np.stack([nnls(root, channel)[0] for channel in wanted.T], axis=-1)
        squares = ((rho - shade @ colour) ** 2).sum(axis=1)
        weight = bundle.trust / (1 + squares / (LIGHTS.outlier_deviations * sigma) ** 2)
    return colour  # type: ignore[no-any-return]


def _clusters(grid: np.ndarray, strength: np.ndarray, least_cosine: float) -> np.ndarray:
    """Directions (K, 3) of lights, the strongest first: means of the ``grid`` (G, 3), by ``strength`` (G,).

    Each is the mean of the directions within ``least_cosine`` of where most strength is left; these are then taken
    out.
    """
    left, out = np.where(strength > RIDGE * strength.max(), strength, 0.0), list[np.ndarray]()
    near = grid @ grid.T > least_cosine
    while left.any() and len(out) < MOST_LIGHTS:
        own = near[np.argmax(np.where(left > 0, near @ left, -1.0))]
        mean = left[own] @ grid[own]
        out.append(mean / np.linalg.norm(mean))
        left = np.where(own, 0.0, left)
    return np.array(out)


@dataclass(frozen=True)
class _Stage:
    """One step of the sharpening."""

    width: float  # cosine over which a terminator is softened
    sigma: float  # standard deviation that residuals are held against, over the brightest
    fine: bool  # of fine blocks, none of which is known to see every light


def _counted(bundle: Bundle, lit: LitBlocks, stage: _Stage) -> LitBlocks:
    """The fit of one stage; repeated where lights were merged or dropped after it."""
    steps = FINE_STEPS if stage.fine else STEPS
    for _ in range(RECOUNTS):
        lit = bundle.fit(lit, stage.width, stage.sigma, steps, core_sees_all=not stage.fine)
        fewer = _fewer(lit, LIGHTS.merged_lights_deg[stage.fine], LIGHTS.faintest_light[stage.fine])
        if len(fewer.toward) == len(lit.toward):
            break
        lit = fewer
    return lit


def _fewer(lit: LitBlocks, near_deg: float, faintest: float) -> LitBlocks:
    """``lit`` without lights fainter than that share of all light, and with one in place of two that are so near.

    Colours come out without negative channels. Raises LinAlgError if no light is left.
    """
    colour = np.maximum(lit.colour, 0.0)
    strength = colour.sum(axis=1)
    bright = strength > faintest * strength.sum()
    toward, colour = lit.toward[bright], colour[bright]
    if not len(toward):
        raise np.linalg.LinAlgError("no light is left")
    while len(toward) > 1:
        cosine = toward @ toward.T - 2 * np.eye(len(toward))
        i, j = np.unravel_index(np.argmax(cosine), cosine.shape)
        if cosine[i, j] < np.cos(np.radians(near_deg)):
            break
        mean = colour[i].sum() * toward[i] + colour[j].sum() * toward[j]
        toward[i], colour[i] = mean / np.linalg.norm(mean), colour[i] + colour[j]
        toward, colour = np.delete(toward, j, axis=0), np.delete(colour, j, axis=0)
    return replace(lit, toward=toward, colour=colour)


def _carried(one: Bundle, other: Bundle, slope: np.ndarray) -> np.ndarray:
    """Slopes (P, 2) of the blocks of ``one``, interpolated at those of the ``other``."""
    rows, columns = np.nonzero(other.cells.where)
    at = (np.stack([rows, columns]) + 0.5) * (other.block / one.block) - 0.5
    one_each, wanted = np.ones(len(rows)), one.cells.interpolated(slope, at)
    W = np.broadcast_to(np.eye(2), (len(rows), 2, 2))
    return other.cells.least_squares_slopes(W, one_each, wanted[..., None])[..., 0]
