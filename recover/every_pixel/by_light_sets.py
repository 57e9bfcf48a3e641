"""Every pixel labelled with the set of lights that it misses, with its normal under the other lights.

With the lights of ``recover.lights.from_shadows`` a pixel that misses the lights of a set S has the matrix
F_S = F − Σ_S b aᵀ, whatever its rank. As |n| = 1, its colour makes three measurements of two unknowns: the normal is
that of the nearest point of the ellipsoid {F_S n}, and the residual shows which S it is. A pixel that is turned away
from a light cannot see it; one that faces a light and misses it is in a cast shadow. Pixels that no set explains (a
light never found, black pixels) take their normal from the depth interpolated between the others.

This answers the report's open question, the pixels that do not see every light.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy import ndimage

from huesphere.recover.depth.integration import depth_from_normals
from huesphere.recover.every_pixel.parameters import EVERY_PIXEL
from huesphere.recover.every_pixel.sheets import one_sheet_a_region
from huesphere.recover.geometry.rays import facing_camera, of_relief, of_surface
from huesphere.recover.geometry.sphere import on_sphere
from huesphere.recover.geometry.threads import in_threads
from huesphere.recover.lights.model import Lights, tolerance, without
from huesphere.recover.lights.parameters import LIGHTS
from huesphere.recover.lights.shadow_regions import FEWEST_PIXELS, ShadowRegions
from huesphere.recover.problem import Problem
from huesphere.scenes.surfaces import depth_normals

SAMPLE = 6000  # pixels that do not see every light, at most, from which the sets that occur are found
FLAT = 0.05  # smallest over largest singular value of a matrix: of flatter ellipsoids colour does not give the side
COST_OF_MISSED_LIGHT = 0.5  # breaks ties: of two sets that explain a colour as well, the smaller is taken
# Cost of what cannot be: a light that is seen though the normal faces away from it, or a normal that faces away from
# the camera. A set of lights explains a pixel only if its cost is at most this. The set that misses no light has no
# other cost: with one such violation its cost is exactly this, so it may still explain the pixel, and two exclude it. A
# set with a missed light is excluded by one violation.
IMPOSSIBLE = 30.0
KNOWN_WITHIN = 0.1  # of the object's size, the root of its area: so far from known pixels the variance has doubled
PASSES = 2  # labels, then again with the surface that the first labels give
FARTHEST = 0.5  # squared distance of a sheet's unit normal to the interpolated one beyond which its cost stays the same
# Two residuals of a pixel, picture units: ``near`` is that of noise, ``wide`` the largest of an explained pixel, which
# turns its normal by undetermined_rad where F is weakest. This is the least ratio of the second to the first.
WIDER = 1.3


@dataclass(frozen=True)
class LabelledPixels:
    """The shadow label and the normal of every pixel of the object, and how each was found.

    ``explained``, ``interpolated`` and ``mapped`` exclude one another; a pixel of the object that is none of them is
    partly lit, in the edge of a cast shadow.
    """

    normals: np.ndarray  # (H, W, 3) unit, camera frame, NaN off the object
    missed: np.ndarray  # (H, W) int, bit j: light j is missed; −1 where it is not known which are
    explained: np.ndarray  # (H, W) bool: the lights that are not missed explain the colour
    interpolated: np.ndarray  # (H, W) bool: the surface between the other pixels gave the normal
    mapped: np.ndarray  # (H, W) bool: the irradiance map gave the normal (``by_irradiance_map``)


@dataclass(frozen=True)
class _LightSet:
    """Lights that are missed together, and one sheet of their ellipsoid."""

    missed: tuple[int, ...]  # numbers of the lights
    sheet: float  # ±1: a side of a flat ellipsoid; 0: of one that is not flat, whose sides differ in colour

    @property
    def bits(self) -> int:
        return sum(1 << j for j in self.missed)


def label_by_light_sets(problem: Problem, start: np.ndarray, F: np.ndarray, lights: Lights) -> LabelledPixels:
    """Labels and normals of all pixels of the object, by the set of ``lights`` that each misses.

    ``start`` (H, W, 3): normals of the pixels that see every light, NaN elsewhere. ``F`` (3, 3): their matrix, picture
    units. Pixels choose the set of least cost: residual, missed lights, and what their neighbours would choose.
    """
    rgb, usable, mask, ray = problem.rgb, problem.usable, problem.mask, problem.ray
    rho = np.ascontiguousarray(rgb[usable], dtype=np.float64)
    brightest = float(rho.max())
    near = max(tolerance(brightest, problem.noise), EVERY_PIXEL.several_lights_tolerance * brightest)
    wide = max(WIDER * near, EVERY_PIXEL.undetermined_rad * float(np.linalg.svd(F)[1][2]))
    alone_within = wide if lights.complete else near  # of a set that is taken though the neighbours' choice is another
    sets = _sets_that_occur(rho, F, lights, near)

    by_all, normals_by_all = np.zeros(mask.shape, bool), np.zeros((*mask.shape, 3))
    n, distance, penalty = _under_sets(rho, F, lights, sets[:1], None if ray is None else ray[usable])
    by_all[usable] = (distance[0] < wide) & (penalty[0] <= IMPOSSIBLE)
    normals_by_all[usable] = n[0]

    open_ = _open_questions(usable, distance[0] > near)
    colours = np.ascontiguousarray(rgb[open_], dtype=np.float64)
    n, distance, penalty = _under_sets(colours, F, lights, sets, None if ray is None else ray[open_])
    squares = (LIGHTS.outlier_deviations * distance / near) ** 2  # in standard deviations: ``near`` is that many
    misfit = EVERY_PIXEL.robust_cost * np.log1p(squares / EVERY_PIXEL.robust_cost)
    two_sheets = np.array([bool(each.sheet) for each in sets])
    known = np.isfinite(start).all(axis=-1) & usable
    # The interpolated surface takes part only where colour leaves a choice between the two sheets of a flat ellipsoid.
    choice = two_sheets.any()
    between = interpolated_normals(np.where(known[..., None], start, 0.0), known, mask, ray) if choice else start
    cost_of_away = EVERY_PIXEL.cost_of_other_sheet * _certainty(known, mask)[open_]
    share = np.maximum(ndimage.uniform_filter(open_.astype(float), EVERY_PIXEL.window_px), 1e-9)
    for _ in range(PASSES if choice else 1):
        prior_cost = penalty.copy()
        if choice:
            prior_cost[two_sheets] += cost_of_away * _square_away(n[two_sheets], between[open_])
        cost = misfit + prior_cost
        smooth = np.array(in_threads(partial(_window_mean, where=open_, share=share), cost)).reshape(cost.shape)
        best, alone = np.argmin(cost + EVERY_PIXEL.neighbour_weight * smooth, axis=0), np.argmin(cost, axis=0)
        # The set that the neighbours vote for may explain a pixel badly that another set explains well.
        better = ~_holds(best, distance, prior_cost, wide) & _holds(alone, distance, prior_cost, alone_within)
        best = _with_like_sheets(np.where(better, alone, best), cost, n, sets, open_)
        explained, image = by_all.copy(), normals_by_all.copy()
        explained[open_] = _holds(best, distance, prior_cost, wide)
        image[open_] = np.take_along_axis(n, best[None, :, None], axis=0)[0]
        explained &= with_explained_neighbours(explained)
        between = interpolated_normals(image, explained, mask, ray)

    partly = usable & ~explained
    image[partly], found = _partly_lit(rgb[partly].astype(np.float64), F, lights, sets, between[partly])
    partly[partly] = found
    missed = np.zeros(mask.shape, int)
    missed[open_] = np.array([each.bits for each in sets])[best]
    whole = np.where((explained | partly)[..., None], image, between)
    return LabelledPixels(
        normals=np.where(mask[..., None], whole, np.nan),
        missed=np.where(explained, missed, -1),
        explained=explained,
        interpolated=mask & ~explained & ~partly,
        mapped=np.zeros(mask.shape, bool),
    )


def _with_like_sheets(
    best: np.ndarray, cost: np.ndarray, n: np.ndarray, sets: list[_LightSet], open_: np.ndarray
) -> np.ndarray:
    """The numbers ``best`` (P,) of the sets, with sheets of flat ellipsoids that are those of a smooth surface.

    ``cost`` (S, P) and normals ``n`` (S, P, 3) under every set, of the pixels ``open_`` (H, W).
    """
    best = best.copy()
    for one, each in enumerate(sets):
        if each.sheet != 1.0:
            continue
        pair = one, one + 1  # the other sheet of a set comes next
        own = np.isin(best, pair)
        image, normals = np.zeros(open_.shape, bool), np.zeros((2, *open_.shape, 3))
        costs = np.zeros((2, *open_.shape))
        image[open_], normals[:, open_], costs[:, open_] = own, n[list(pair)], cost[list(pair)]
        second, decided = one_sheet_a_region(normals[0], normals[1], costs, image)
        chosen = np.where(second, *reversed(pair))[open_]
        best = np.where(decided[open_], chosen, best)
    return best


def _square_away(n: np.ndarray, between: np.ndarray) -> np.ndarray:
    """Squared distances (S, P) of the normals ``n`` (S, P, 3) to those ``between`` (P, 3), up to FARTHEST."""
    return np.minimum(((n - between) ** 2).sum(axis=2), FARTHEST)


def _certainty(known: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """How certain the interpolated surface is (H, W), 1 at the ``known`` pixels of the object ``mask`` (H, W).

    The inverse of its variance, whose excess grows with the square of the distance to a known pixel.
    """
    distance = ndimage.distance_transform_edt(~known) / (KNOWN_WITHIN * np.sqrt(mask.sum()))
    return np.asarray(1 / (1 + distance**2))


def with_explained_neighbours(explained: np.ndarray) -> np.ndarray:
    """Pixels (H, W) of whose 3×3 neighbourhood enough is ``explained`` (H, W): a single fit among misfits is chance."""
    share = ndimage.uniform_filter(explained.astype(float), 3)
    return share > EVERY_PIXEL.least_explained_neighbours  # type: ignore[no-any-return]


def _holds(which: np.ndarray, distance: np.ndarray, prior_cost: np.ndarray, within: float) -> np.ndarray:
    """Whether the set of number ``which`` (P,) of each pixel is possible and explains it ``within`` a distance, (P,).

    ``distance`` and ``prior_cost`` (S, P): of every set.
    """
    own, cost = (np.take_along_axis(values, which[None], axis=0)[0] for values in (distance, prior_cost))
    return (own < within) & (cost <= IMPOSSIBLE)  # type: ignore[no-any-return]


def _sets_that_occur(rho: np.ndarray, F: np.ndarray, lights: Lights, near: float) -> list[_LightSet]:
    """The sets of missed lights that explain a share of the colours (P, 3) better than others do, none missed first.

    Both sheets of flat ellipsoids.
    """
    _, distance = on_sphere(rho, F)
    rest = rho[distance > near]
    sets = [_LightSet((), 0.0)]
    if not len(rest):
        return sets
    sample = rest[np.random.default_rng(0).choice(len(rest), min(SAMPLE, len(rest)), replace=False)]
    none = np.zeros(len(sample), bool)
    regions = ShadowRegions.of_core(sample, none, F, near).with_lights(lights.found, none)
    for number, missed in enumerate(regions.sets):
        if missed and (regions.label == number).sum() >= FEWEST_PIXELS:
            values = np.linalg.svd(without(F, lights.found, missed))[1]
            flat = values[2] < FLAT * values[0]
            sets += [_LightSet(missed, sheet) for sheet in ((1.0, -1.0) if flat else (0.0,))]
    return sets


def _open_questions(usable: np.ndarray, unexplained: np.ndarray) -> np.ndarray:
    """Pixels (H, W) whose lights are an open question: ``unexplained`` (P,) ones of the ``usable``, and those near.

    Elsewhere every pixel of a window sees every light. Near: as far as a pixel and an unexplained one share a
    window.
    """
    image = np.zeros(usable.shape, bool)
    image[usable] = unexplained
    return usable & ndimage.maximum_filter(image, 2 * EVERY_PIXEL.window_px - 1)  # type: ignore[no-any-return]


def _under_sets(
    rho: np.ndarray, F: np.ndarray, lights: Lights, sets: list[_LightSet], ray: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normals (S, P, 3), distances (S, P), and costs (S, P) of missed lights, of every pixel under every set.

    ``rho`` (P, 3): colours. ``ray`` (P, 2): of a picture in perspective.
    """
    n, distance, penalty = (np.empty((len(sets), len(rho), *rest)) for rest in ((3,), (), ()))
    directions = np.array([light.direction for light in lights.found]).reshape(-1, 3)
    turned = EVERY_PIXEL.terminator_cosine

    def fill(k: int) -> None:
        M = without(F, lights.found, sets[k].missed)
        n[k], distance[k] = on_sphere(rho, M)
        if sets[k].sheet:
            # M n hardly depends on the component of n along this direction: normals on the wrong side are mirrored.
            # Which side is +1 is arbitrary, but the same for all pixels, and both sides are among the sets.
            across = np.linalg.svd(M)[2][2]
            n[k] -= np.outer((np.sign(n[k] @ across) != sets[k].sheet) * 2 * (n[k] @ across), across)
            distance[k] = np.linalg.norm(rho - n[k] @ M.T, axis=1)
        cosine = n[k] @ directions.T
        missed = np.isin(np.arange(len(directions)), sets[k].missed)
        cast = (cosine[:, missed] > turned).sum(axis=1)
        penalty[k] = COST_OF_MISSED_LIGHT * len(sets[k].missed) + EVERY_PIXEL.cost_of_cast_shadow * cast
        penalty[k] += IMPOSSIBLE * (cosine[:, ~missed] < -turned).any(axis=1)
        penalty[k] += IMPOSSIBLE * (facing_camera(n[k], ray) < -turned)

    in_threads(fill, range(len(sets)))
    return n, distance, penalty


def _partly_lit(
    rho: np.ndarray, F: np.ndarray, lights: Lights, sets: list[_LightSet], between: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(normals (P, 3), whether one was found (P,)) of pixels part of which lies in the edge of a cast shadow.

    They miss a share v of light j, ρ = (F_S − v b aᵀ) n: with |n| = 1 three unknowns and three measurements, a
    quadratic in τ = v a·n. No measurement is left to show which j and which root, so the normal nearest to the
    interpolated surface ``between`` (P, 3) is taken.
    """
    most = EVERY_PIXEL.most_turn_of_partly_lit
    n, nearest = between.copy(), np.full(len(rho), most)
    for missed in {each.missed for each in sets}:
        M = without(F, lights.found, missed)
        if np.linalg.cond(M) > 1 / FLAT:
            continue
        inverse = np.linalg.inv(M)
        whole = rho @ inverse.T
        for j in set(range(len(lights.found))) - set(missed):
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
    return n, nearest < most


def _window_mean(values: np.ndarray, where: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Means (P,) of ``values`` (P,) of the pixels ``where`` (H, W), over those of them in the window about each.

    ``share`` (H, W): of the window that is ``where``.
    """
    image = np.zeros(where.shape)
    image[where] = values
    return (ndimage.uniform_filter(image, EVERY_PIXEL.window_px) / share)[where]  # type: ignore[no-any-return]


def interpolated_normals(
    normals: np.ndarray, known: np.ndarray, mask: np.ndarray, ray: np.ndarray | None = None
) -> np.ndarray:
    """Normals (H, W, 3), camera frame, of the depth over all of ``mask`` (H, W) that the ``known`` normals span.

    ``ray`` (H, W, 2): of a picture in perspective.
    """
    depth = depth_from_normals(of_relief(normals, ray), known, mask)
    own = depth_normals(np.where(mask, depth, 0.0), mask)
    return of_surface(np.where(np.isfinite(own), own, [0.0, 0.0, 1.0]), ray)
