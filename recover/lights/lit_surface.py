"""The lights of a noisy picture, all at once: how many, where, of what colours, and the surface that they light.

One by one (``recover.lights.from_shadows``) lights are found where the pixels that miss one of them tell it singly,
which takes little noise. All together they are told by the whole picture, as far as each is distant: ρ = Σ b_k max(0,
a_k·n) is a map from normal to colour that few lights make, and few surfaces fit (``recover.lights.bundle_adjustment``).
The way there:

- The smoothest of maps carries the surface outward from the pixels that see every light
(``recover.lights.irradiance_map``).
- On that surface, non-negative least squares finds what lights of a grid of directions would make the picture. Many
  weak ones come out where one is, for the surface is a few degrees off: clusters of them are the first guess.
- Lights and surface are fitted together on coarse blocks of pixels, terminators softened at first. What comes to lie
  on another light is one with it, what fades is gone. Then the grid is asked again, on the better surface.
- The best end is fitted to fine blocks, where nothing is known beforehand of any pixel.

That the map is one of *few* lights matters: with as many as the grid has, a picture of a surface tilted by 10° is
explained as well as that of the true one, by other lights.
"""

import contextlib
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import nnls

from huesphere.recover.geometry.sphere import fibonacci
from huesphere.recover.geometry.threads import in_threads
from huesphere.recover.lights.bundle_adjustment import Bundle, F_by_lights, Lit, expected
from huesphere.recover.lights.irradiance_map import first_surface

ATTEMPTS = ((1200, (20.0, 30.0)), (800, (25.0, 40.0)))  # coarse blocks; degrees within which the grid's are one light
FINE, CALM = 5000, 0.7  # fine blocks; what may be left over, for no further attempt
GRID = 800  # directions over the whole sphere, of which those in front count
AGAIN_DEG = (15.0,)  # the same when the grid is asked again
ROUNDS = 2  # times that the grid is asked again
FEWEST, MOST_LIGHTS = 3, 12  # blocks of the core; lights
FIRST, AGAIN = ((0.15, 1e-2), (0.06, 5e-3), (0.03, 3e-3)), ((0.06, 5e-3), (0.03, 3e-3))  # widths, and residuals
LAST, LAST_TIMES, LEAST_NOISE = (0.03, 0.02), (3.0, 1.5), 1e-3  # the same of the fine blocks, in units of the noise
ON_GRID = 6e-3, 4e-3  # what residuals are held against on the grid: at first, and on the better surface
STEPS, FINE_STEPS, TIMES = 10, 8, 3  # of the fit, before lights are counted anew, and how often that is
NEAR_DEG, FAINT = 8.0, 0.01  # lights that are one; share of all light, below which one is gone
FINE_NEAR_DEG, FINE_FAINT = 6.0, 0.005
BETTER = 0.01  # of the loss, by which a new end must be better
CAUCHY, LOOKS = 3.0, 3  # weights on the grid
RIDGE = 1e-6  # of the grid's equations
LEAST_DEG, STRETCH = 0.2, 0.4  # by which F may be turned at least, and stretched for each radian: standard deviations
EXPLAINED = 3.0  # standard deviations within which a block is explained


@dataclass(frozen=True)
class LitSurface:
    """What explains the picture."""

    toward: np.ndarray  # (K, 3) unit, camera frame, toward each light
    colour: np.ndarray  # (K, 3) picture units, what a surface that faces the light gets of it
    F: np.ndarray  # (3, 3) of a pixel that sees every light
    normals: np.ndarray  # (H, W, 3) of the object's pixels, between those of the blocks; NaN off it
    explained: float  # share of the blocks whose colour is explained to within noise
    loss: float  # mean over the blocks; 0.6 to 0.8 of noise, to 1.5 of detail besides, 2 to 5 where it is wrong
    covariance: np.ndarray  # (9, 9) of F, row by row, from noise alone


def lit_surface(
    rgb: np.ndarray,
    mask: np.ndarray,
    core: np.ndarray,
    F: np.ndarray,
    turn: np.ndarray,
    noise: float,
    ray: np.ndarray | None = None,
    seen: np.ndarray | None = None,
) -> LitSurface:
    """The lights and the surface of the object ``mask`` (H, W) in the picture ``rgb`` (H, W, 3).

    ``core`` (H, W) are pixels that see every light and ``F`` (3, 3) their matrix, its rotation known to 10° or so:
    ``turn`` (3, 3) is the covariance of a small rotation of the camera frame, radians². ``noise``: standard deviation
    of a channel, picture units. ``ray`` (H, W, 2): of a picture in perspective. ``seen`` (H, W), if given: pixels whose
    colours count. Raises LinAlgError where the equations break down, or there is too little to begin with.
    """
    turn = turn + np.radians(LEAST_DEG) ** 2 * np.eye(3)
    known = expected(F / rgb[mask].max(), turn, STRETCH * float(np.sqrt(np.trace(turn))))
    fine = Bundle(rgb, mask, core, noise, FINE, ray, seen, known)
    sigma, ends = max(LEAST_NOISE, fine.noise), []
    for cells, apart_deg in ATTEMPTS:
        coarse = Bundle(rgb, mask, core, noise, cells, ray, seen, known)
        with contextlib.suppress(np.linalg.LinAlgError):
            ends.append(_refined(coarse, fine, _searched(coarse, known.F, apart_deg), sigma))
        if ends and ends[-1].loss < CALM:
            break
    if not ends:
        raise np.linalg.LinAlgError("no search came to an end")
    lit = min(ends, key=lambda end: end.loss)
    sigma, of_F = sigma * LAST_TIMES[-1], F_by_lights(lit)
    squares = (fine.residual(lit) ** 2).sum(axis=1)[fine.sure > 0.5] / sigma**2
    normals = np.full(rgb.shape, np.nan)
    normals[mask] = fine.cells.normals_at_pixels(fine.normals(lit.slope), mask)
    return LitSurface(
        toward=lit.toward,
        colour=lit.colour * fine.bright,
        F=lit.F * fine.bright,
        normals=normals,
        explained=float((squares < EXPLAINED**2).mean()),
        loss=lit.loss,
        covariance=of_F.T @ fine.covariance(lit, sigma) @ of_F * fine.bright**2,
    )


def _refined(coarse: Bundle, fine: Bundle, lit: Lit, sigma: float) -> Lit:
    """What was found on ``coarse`` blocks, fitted to ``fine`` ones of noise ``sigma``."""
    lit = replace(lit, slope=_carried(coarse, fine, lit.slope))
    for width, times in zip(LAST, LAST_TIMES):
        lit = _counted(fine, lit, width, times * sigma, FINE_STEPS, (FINE_NEAR_DEG, FINE_FAINT), tied=False)
    return lit


def _searched(bundle: Bundle, F: np.ndarray, apart_deg: tuple[float, ...]) -> Lit:
    """The best of several searches on coarse blocks."""
    if (bundle.core & (bundle.sure > 0.5)).sum() < FEWEST or (bundle.sure > 0.5).sum() < 2 * FEWEST:
        raise np.linalg.LinAlgError("too few blocks well within the object, or its core")
    slope = first_surface(bundle.cells, bundle.ray, bundle.sure, F, bundle.core, bundle.noise)
    best = min(_from_grid(bundle, slope, ON_GRID[0], apart_deg, FIRST), key=lambda lit: lit.loss)
    for _ in range(ROUNDS):
        again = min(_from_grid(bundle, best.slope, ON_GRID[1], AGAIN_DEG, AGAIN), key=lambda lit: lit.loss)
        if again.loss > best.loss - BETTER:
            break
        best = again
    return best


def _from_grid(
    bundle: Bundle,
    slope: np.ndarray,
    sigma: float,
    apart_deg: tuple[float, ...],
    ladder: tuple[tuple[float, float], ...],
) -> list[Lit]:
    """Fits that begin with the lights that a grid of directions has on the surface of these slopes (P, 2)."""
    grid = fibonacci(GRID)
    grid = grid[grid[:, 2] > 0]
    strength = _on_grid(bundle, slope, grid, sigma)

    def one(deg: float) -> Lit:
        toward = _clusters(grid, strength.sum(axis=1), np.cos(np.radians(deg)))
        lit = Lit(slope, toward, _on_grid(bundle, slope, toward, sigma), np.inf)
        for width, sigma_then in ladder:
            lit = _counted(bundle, lit, width, sigma_then, STEPS, (NEAR_DEG, FAINT), tied=True)
        return lit

    return in_threads(one, apart_deg)


def _on_grid(bundle: Bundle, slope: np.ndarray, toward: np.ndarray, sigma: float) -> np.ndarray:
    """Colours (K, 3), none negative, of lights ``toward`` (K, 3) that make the picture of these slopes (P, 2)."""
    n, rho, weight = bundle.normals(slope), bundle.cells.N, bundle.sure
    shade = np.maximum(n @ toward.T, 0.0)
    shade[bundle.core] = n[bundle.core] @ toward.T
    for _ in range(LOOKS):
        weighted = shade * weight[:, None]
        gram = weighted.T @ shade
        gram += RIDGE * np.trace(gram) / len(gram) * np.eye(len(gram))
        root = np.linalg.cholesky(gram).T
        wanted = np.linalg.solve(root.T, weighted.T @ rho)
        colour = np.stack([nnls(root, channel)[0] for channel in wanted.T], axis=-1)
        weight = bundle.sure / (1 + ((rho - shade @ colour) ** 2).sum(axis=1) / (CAUCHY * sigma) ** 2)
    return colour  # type: ignore[no-any-return]


def _clusters(grid: np.ndarray, strength: np.ndarray, near: float) -> np.ndarray:
    """Directions (K, 3), the strongest first, each the mean of what is left of the ``grid`` about a strongest place."""
    left, out = np.where(strength > RIDGE * strength.max(), strength, 0.0), list[np.ndarray]()
    alike = grid @ grid.T > near
    while left.any() and len(out) < MOST_LIGHTS:
        own = alike[np.argmax(np.where(left > 0, alike @ left, -1.0))]
        mean = left[own] @ grid[own]
        out.append(mean / np.linalg.norm(mean))
        left = np.where(own, 0.0, left)
    return np.array(out)


def _counted(
    bundle: Bundle, lit: Lit, width: float, sigma: float, steps: int, one: tuple[float, float], *, tied: bool
) -> Lit:
    """The fit; and once more where lights turned out to be one with others, or none."""
    for _ in range(TIMES):
        lit = bundle.fit(lit, width, sigma, steps, tied=tied)
        fewer = _fewer(lit, *one)
        if len(fewer.toward) == len(lit.toward):
            break
        lit = fewer
    return lit


def _fewer(lit: Lit, near_deg: float, faint: float) -> Lit:
    """Without lights fainter than that share of all, and with one in place of two that are so near."""
    colour = np.maximum(lit.colour, 0.0)
    strength = colour.sum(axis=1)
    bright = strength > faint * strength.sum()
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
    """Slopes (P, 2) of the blocks of ``one`` at those of the ``other``."""
    rows, columns = np.nonzero(other.cells.where)
    at = (np.stack([rows, columns]) + 0.5) * (other.block / one.block) - 0.5
    one_each, wanted = np.ones(len(rows)), one.cells.between(slope, at)
    W = np.broadcast_to(np.eye(2), (len(rows), 2, 2))
    return other.cells.slopes_nearest(W, one_each, wanted[..., None])[..., 0]
