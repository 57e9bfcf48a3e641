"""Every pixel: those that miss lights by their own matrix, the rest by the surface between: the report's open question.

With the lights of ``recover.lights.from_shadows`` a pixel that misses the lights S has the matrix F_S = F − Σ b aᵀ over
S, whatever its rank, and |n| = 1 makes three measurements of two unknowns: the normal is the nearest on the sphere, the
residual tells which S. A pixel turned away from a light cannot see it; one that faces a light and misses it is in a
cast shadow. What no set explains (a light never found, black pixels) takes its normal from the depth that the others
span.
"""

from dataclasses import dataclass
from functools import partial
from itertools import combinations

import numpy as np
from scipy import ndimage

from huesphere.recover.depth.integration import depth_from_normals
from huesphere.recover.geometry.rays import facing_camera, of_relief, of_surface
from huesphere.recover.geometry.sphere import on_sphere
from huesphere.recover.geometry.threads import in_threads
from huesphere.recover.lights.model import Lights, tolerance, without
from huesphere.scenes.surfaces import depth_normals

MOST_OFF = 4  # lights that a pixel may miss
SAMPLE, LEAST_SHARE = 2000, 0.002  # of pixels not all lit: sets of missing lights that explain fewer are not looked at
SLACK = 2e-4  # of the brightest colour: what the matrices of several missing lights may be off
LOOSE = 0.2  # radians, of F's weakest direction: misfit beyond which a normal is no better than the surface between
BREAK = 6.0  # squared standard deviations, beyond which a misfit costs ever less
OFF, CAST, IMPOSSIBLE = (
    0.5,
    3.0,
    30.0,
)  # costs of a missing light, of one in front of the pixel, of one seen from behind
TURNED = 0.03  # a·n beyond which a pixel counts as turned to or from a light
NEIGHBOURS, WINDOW = 4.0, 5  # weight of the mean cost over a window, and its side
SINGULAR = 0.05  # smallest over largest singular value of a matrix whose two sheets cannot be told apart by colour
SHEET = 30.0  # cost of a radian squared away from the surface between, where colour leaves a choice
NEAR_SURFACE = 0.5  # radians from the surface between, at most, of the normal of a pixel partly lit
PASSES = 2
LONE = 0.3  # share of a pixel's neighbourhood that must be explained too: a lone fit among misfits is chance


@dataclass(frozen=True)
class Knitted:
    """Normals of every pixel of the object, and how each was come by."""

    normals: np.ndarray  # (H, W, 3) unit, NaN off the object
    off: np.ndarray  # (H, W) int, bit j: light j is missed; −1 where it is not known which are
    explained: np.ndarray  # (H, W) bool
    between: np.ndarray  # (H, W) bool: the surface between the others gave it
    mapped: np.ndarray  # (H, W) bool: the irradiance map gave it (``recover.every_pixel.by_irradiance_map``)


def knit(
    rgb: np.ndarray,
    usable: np.ndarray,
    mask: np.ndarray,
    normals: np.ndarray,
    F: np.ndarray,
    lights: Lights,
    noise: float,
    ray: np.ndarray | None = None,
) -> Knitted:
    """Normals over all of ``mask`` (H, W), from colours (H, W, 3) that count where ``usable`` (H, W).

    ``normals`` (H, W, 3) are those of the pixels that see every light, of matrix ``F`` (3, 3), NaN elsewhere: the
    start. ``noise``: standard deviation of a channel, picture units. ``ray`` (H, W, 2): of a picture in perspective.
    """
    rho = np.ascontiguousarray(rgb[usable], dtype=np.float64)
    near = max(tolerance(float(rho.max()), noise), SLACK * float(rho.max()))
    loose = max(1.3 * near, LOOSE * float(np.linalg.svd(F)[1][2]))
    trusted = loose if lights.complete else near  # misfit of a set that no neighbour needs to share
    cells = _cells(rho, F, lights, near)
    known = np.isfinite(normals).all(axis=-1) & usable
    explained_by_all, normals_by_all = np.zeros(mask.shape, bool), np.zeros((*mask.shape, 3))
    n, distance, penalty = _all_sheets(rho, F, lights, cells[:1], None if ray is None else ray[usable])
    explained_by_all[usable] = (distance[0] < loose) & (penalty[0] <= IMPOSSIBLE)
    normals_by_all[usable] = n[0]
    unsettled = _unsettled(usable, distance[0] > near)
    n, distance, penalty = _all_sheets(
        np.ascontiguousarray(rgb[unsettled], dtype=np.float64),
        F,
        lights,
        cells,
        None if ray is None else ray[unsettled],
    )
    misfit = BREAK * np.log1p((3 * distance / near) ** 2 / BREAK)  # a third of ``near`` is one standard deviation
    flat = np.array([bool(side) for _, side in cells])
    # Only where colour leaves a choice does the surface between enter.
    between = surface_between(np.where(known[..., None], normals, 0.0), known, mask, ray) if flat.any() else normals
    share = np.maximum(ndimage.uniform_filter(unsettled.astype(float), WINDOW), 1e-9)
    for _ in range(PASSES if flat.any() else 1):
        doubt = penalty.copy()
        if flat.any():
            doubt[flat] += SHEET * np.minimum(((n[flat] - between[unsettled]) ** 2).sum(axis=2), 0.5)
        cost = misfit + doubt
        smooth = np.array(in_threads(partial(_window_mean, where=unsettled, share=share), cost)).reshape(cost.shape)
        best, alone = np.argmin(cost + NEIGHBOURS * smooth, axis=0)[None], np.argmin(cost, axis=0)[None]
        # What its neighbours vote for may explain a pixel badly that another set explains well.
        better = ~_sound(best, distance, doubt, loose) & _sound(alone, distance, doubt, trusted)
        best = np.where(better, alone, best)
        explained, image = explained_by_all.copy(), normals_by_all.copy()
        explained[unsettled] = _sound(best, distance, doubt, loose)
        image[unsettled] = np.take_along_axis(n, best[..., None], axis=0)[0]
        explained &= ndimage.uniform_filter(explained.astype(float), 3) > LONE
        between = surface_between(image, explained, mask, ray)
    partly = usable & ~explained
    image[partly], found = _partly_lit(rgb[partly].astype(np.float64), F, lights, cells, between[partly])
    partly[partly] = found
    numbers = np.zeros(mask.shape, int)
    numbers[unsettled] = np.array([sum(1 << j for j in cell) for cell, _ in cells])[best[0]]
    whole = np.where((explained | partly)[..., None], image, between)
    return Knitted(
        normals=np.where(mask[..., None], whole, np.nan),
        off=np.where(explained, numbers, -1),
        explained=explained,
        between=mask & ~explained & ~partly,
        mapped=np.zeros(mask.shape, bool),
    )


def _sound(cell: np.ndarray, distance: np.ndarray, doubt: np.ndarray, within: float) -> np.ndarray:
    """Whether the ``cell`` (1, P) of each pixel explains it ``within`` a distance and is possible, (P,)."""
    chosen = (np.take_along_axis(values, cell, axis=0)[0] for values in (distance, doubt))
    return (next(chosen) < within) & (next(chosen) <= IMPOSSIBLE)  # type: ignore[no-any-return]


def _cells(rho: np.ndarray, F: np.ndarray, lights: Lights, near: float) -> list[tuple[tuple[int, ...], float]]:
    """(lights missed, side of the sheet) of all sets that explain a share of the colours; both sheets of flat ones."""
    _, lit = on_sphere(rho, F)
    rest = rho[lit > near]
    if not len(rest):
        return [((), 0.0)]
    sample = rest[np.random.default_rng(0).choice(len(rest), min(SAMPLE, len(rest)), replace=False)]
    cells: list[tuple[tuple[int, ...], float]] = [((), 0.0)]
    for count in range(1, min(MOST_OFF, len(lights.found)) + 1):
        for off in combinations(range(len(lights.found)), count):
            M = without(F, lights.found, off)
            _, distance = on_sphere(sample, M)
            if (distance < near).mean() >= LEAST_SHARE:
                values = np.linalg.svd(M)[1]
                sides = (1.0, -1.0) if values[2] < SINGULAR * values[0] else (0.0,)
                cells += [(off, side) for side in sides]
    return cells


def _unsettled(usable: np.ndarray, strange: np.ndarray) -> np.ndarray:
    """Pixels (H, W) whose lights are an open question: the ``strange`` (P,) of the ``usable``, and those about them.

    Elsewhere every pixel of a window sees every light. About them: as far as a pixel and a strange one share a window.
    """
    image = np.zeros(usable.shape, bool)
    image[usable] = strange
    return usable & ndimage.maximum_filter(image, 2 * WINDOW - 1)  # type: ignore[no-any-return]


def _all_sheets(
    rho: np.ndarray,
    F: np.ndarray,
    lights: Lights,
    cells: list[tuple[tuple[int, ...], float]],
    ray: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normals (C, P, 3), distances (C, P) and penalties (C, P), misfit aside, of every pixel in every cell.

    ``ray`` (P, 2): of a picture in perspective.
    """
    n, distance, penalty = (np.empty((len(cells), len(rho), *rest)) for rest in ((3,), (), ()))
    directions = np.array([light.direction for light in lights.found]).reshape(-1, 3)

    def fill(k: int) -> None:
        off, side = cells[k]
        M = without(F, lights.found, off)
        n[k], distance[k] = on_sphere(rho, M)
        if side:
            across = np.linalg.svd(M)[2][2]
            n[k] -= np.outer((np.sign(n[k] @ across) != side) * 2 * (n[k] @ across), across)
            distance[k] = np.linalg.norm(rho - n[k] @ M.T, axis=1)
        cosine = n[k] @ directions.T
        missed = np.isin(np.arange(len(directions)), off)
        penalty[k] = OFF * len(off) + CAST * (cosine[:, missed] > TURNED).sum(axis=1)
        penalty[k] += IMPOSSIBLE * (cosine[:, ~missed] < -TURNED).any(axis=1)
        penalty[k] += IMPOSSIBLE * (facing_camera(n[k], ray) < -TURNED)

    in_threads(fill, range(len(cells)))
    return n, distance, penalty


def _partly_lit(
    rho: np.ndarray, F: np.ndarray, lights: Lights, cells: list[tuple[tuple[int, ...], float]], between: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(normals (P, 3), found (P,)) of pixels of which part is in a cast shadow's edge.

    They miss a share v of light j, ρ = (F_S − v b aᵀ) n: with |n| = 1 three unknowns and three measurements, a
    quadratic in τ = v a·n. Nothing is left over to tell which j and which root, so the nearest to the surface between
    is taken.
    """
    n, nearest = between.copy(), np.full(len(rho), NEAR_SURFACE)
    for off in {off for off, _ in cells}:
        M = without(F, lights.found, off)
        if np.linalg.cond(M) > 1 / SINGULAR:
            continue
        inverse = np.linalg.inv(M)
        whole = rho @ inverse.T
        for j in set(range(len(lights.found))) - set(off):
            c = inverse @ lights.found[j].colour
            along, cc = whole @ c, c @ c
            root = np.sqrt(np.maximum(along**2 - cc * ((whole**2).sum(axis=1) - 1), 0.0))
            for side in (-1.0, 1.0):
                tau = (-along + side * root) / cc
                trial = whole + tau[:, None] * c
                cosine = trial @ lights.found[j].direction
                away = np.linalg.norm(trial - between, axis=1)
                better = (tau >= 0) & (tau <= cosine) & (away < nearest) & (root > 0)
                n[better], nearest[better] = trial[better], away[better]
    return n, nearest < NEAR_SURFACE


def _window_mean(values: np.ndarray, where: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Means (P,) over the window about each pixel of ``where`` (H, W), of those in it, a ``share`` (H, W) of it."""
    image = np.zeros(where.shape)
    image[where] = values
    return (ndimage.uniform_filter(image, WINDOW) / share)[where]  # type: ignore[no-any-return]


def surface_between(
    normals: np.ndarray, known: np.ndarray, mask: np.ndarray, ray: np.ndarray | None = None
) -> np.ndarray:
    """Normals (H, W, 3) of the depth that is spanned by the normals that are known."""
    depth = depth_from_normals(of_relief(normals, ray), known, mask)
    own = depth_normals(np.where(mask, depth, 0.0), mask)
    return of_surface(np.where(np.isfinite(own), own, [0.0, 0.0, 1.0]), ray)
