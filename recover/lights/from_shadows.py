"""The lights, one by one, from one picture: pixels that miss a light reveal it.

Let F be the matrix of the pixels that see every light (ρ = F n, report Eq. 6), known with its rotation. A pixel that
misses a light of colour b and direction a has the colour ρ = (F − b aᵀ) n, whether the surface is turned away from the
light (a·n < 0, attached shadow) or something stands between (a·n > 0, cast shadow). For a guessed *direction* of b,
|n| = 1 gives the pixel's normal and τ = −|b| a·n in closed form (a quadratic), and τ must be linear in n: so three
numbers, |b| a, follow by least squares from the pixels of one small window (``recover.lights.one_light``). The guesses
are a grid over directions of F⁻¹b, two numbers.

Up to four (b, a) give the same ellipsoid {(F − b aᵀ) n : |n| = 1} (``one_light.folds``). Only with one of the four are
the pixels' normals those of a surface: the curl of their slopes decides. A light must also agree with the pixels that
see every light: there a·n ≥ 0, and no channel is darker than this light alone would make it.

The lights are complete when Σ b aᵀ = F. Where all but one are found, the remainder F − Σ b aᵀ is the last light, though
that may have no shadow in the picture. Of two or more lights without a shadow only the sum is known.
"""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy import ndimage

from huesphere.recover.geometry.rays import of_relief
from huesphere.recover.geometry.sphere import fibonacci, on_sphere
from huesphere.recover.geometry.threads import in_threads
from huesphere.recover.lights import one_light
from huesphere.recover.lights.evidence import Core, Support, measure, relative_curl, sharpness
from huesphere.recover.lights.model import LEAST_SUPPORT_SHARE, Light, Lights, tolerance, without
from huesphere.recover.lights.one_light import WindowLimits, alike, folds, refined
from huesphere.recover.lights.parameters import LIGHTS
from huesphere.recover.lights.polish import loss_beside, polished, polished_beside
from huesphere.recover.lights.shadow_regions import ShadowRegions, sheets
from huesphere.recover.lights.sum_fit import fitted_to_sum
from huesphere.recover.problem import Problem
from huesphere.recover.solution import Solution

# Each guess of a light is refined from each of these widths of the robust loss; the best end is kept (brightest).
REFINEMENT_WIDTHS = (0.02, 0.001, 0.0002)
POLISHING_WIDTHS = (1e-2, 5e-4, 3e-5)  # the widths that polishing, the fit of a guess to noise level, begins with

GUESS_WINDOWS = 140  # windows from which a light is guessed beside one region, at most (``_windows``)

# Bounds on the work: more of these makes the search slower and, within the variation from draw to draw, no better.
MOST_LIGHTS = 9  # lights found at which the search ends: all subsets of them are tried for completeness, 2⁹ at most
GUESSED_COLOURS = 700  # directions of F⁻¹b on the grid, over the whole sphere
FEWEST_IN_WINDOW = 14  # pixels of the kind that counts which a window must hold to be used (``_windows``)
BEST_OF_WINDOW = 4  # guesses of each window that are kept
REFINED = 12  # guesses with the most support, within either width, that are polished
ENOUGH_TO_POLISH = 0.5  # of the least support: pixels that a polished guess must explain to be judged
SUPPORT_WIDTH = 8  # tolerances within which pixels support a guess that is not polished yet
FACING_SAMPLE = 64  # pixels that see every light, against which each guess of a window is checked
FEW_SAMPLE, MANY_SAMPLE = 600, 500  # pixels drawn to rank guesses by their support, and to polish them
ALL_LIT_SAMPLE = 800  # pixels drawn of those that see every light, which no light may contradict
WINDOWS_AT_ONCE = 10  # windows a thread takes at a time
DRAWS = 3  # draws of windows before the search gives up
ALIKE_COSINE = 0.97  # of the directions of two guesses: below it they are two lights
KNOWN_COSINE = 0.98  # of the directions of a candidate and of a light already found: above it they are one light
MOST_BESIDE = 3  # lights that pixels may miss besides the one that is looked for
MOST_CANDIDATES = 20  # that are kept from one search to the next
MOST_PLACES = 6  # regions beside which a light is looked for in one search
BORDER_PX = 3  # windows are about pixels so near to the region beside which a light is looked for
BELT_PX = 5  # pixels so near to those judge and polish the guesses
# Third singular value of F⁻¹M, M being the matrix of the pixels that miss a light: below the first their colours lie
# nearly in a plane, below the second two normals may have one colour.
FLAT, NEARLY_FLAT = 0.01, 0.05
FINE_RESIDUALS = 3.0  # of the core's median residual: width of the loss at the end of polishing
SPREAD_SAMPLE = 2500  # unexplained pixels from all over the picture that a candidate is fitted to in the end
WORTH_SPREADING = 0.1  # of the least support: a candidate whose score is less is not fitted so
POLISH_FROM = 10.0  # tolerances: width of the robust loss that this fit begins with; of polishing, in last widths
SETTLING_ROUNDS = 2  # of fitting all lights anew and labelling the pixels anew
MOST_OF_SET = 600  # pixels of each set of missed lights that a light is then fitted to, about
SUM_SLACK = 2e-3  # of |F|: standard deviation of the elements of Σ b aᵀ − F in the fit of all lights to F
SUM_WIDTH = 2.0  # tolerances: width of the robust loss in the fit of all lights to F
STRIP_HALF_WIDTHS = (4, 6)  # pixels: of windows in which only pixels next to a known region count
CERTAIN_SCORE = 0.8  # score over support of a light that is accepted before others are looked for
ADJUSTED_REST = 0.1  # second singular value of F⁻¹R up to which the rest R may be one light in a fit of all to F
ADJUSTED_GAIN = 1.1  # times the pixels that the lights found explain, which those of that fit must explain
MOST_AT_ONCE = 3  # lights that pixels are supposed to miss together, in sets

WORST_CONDITION = 2e3  # of the matrix of a region beside which a light is looked for: beyond, it counts as singular
SURELY_ONE_LIGHT = 0.005  # second singular value of a remainder that surely is one light: 0.003 to 0.016 are seen
LEAST_GAIN = 1.2  # pixels that a fit of an inferred light must explain over those that the remainder explains
INFERRED_TOLERANCE = 5e-4  # of the brightest: least tolerance of a light that no pixel was fitted to
NEGATIVE_SLACK = 0.1  # of a light's largest channel: how negative another may come out of a fit, or be guessed
BEHIND_CAMERA = 0.02  # largest −a_z of a light's direction a: light from behind the object is not seen


def find_lights(problem: Problem, solution: Solution, supposed: tuple[Light, ...] = ()) -> Lights:
    """The lights that usable pixels of the picture miss, each found by the pixels that miss it.

    ``solution``: F with its rotation (and convexity) chosen, and its inliers, which see every light. ``supposed``:
    lights found in nearly the same picture, which are tried first and judged like all others.
    Directions are in the camera frame, colours in picture units. The search draws pixels with a fixed seed, so the
    same input gives the same lights.
    """
    search = _Search(problem, solution)
    search.suppose(supposed)
    sure, likely = SURELY_ONE_LIGHT, LIGHTS.relative_light_error
    whole = None
    while whole is None and len(search.lights) < MOST_LIGHTS and search.shadowed().sum() >= search.least_support:
        best = search.best_candidate()
        if best is None:
            break
        search._add(best)
        whole = search.complete() or search.with_inferred_light(sure)
    search.settle()
    whole = search.complete() or search.with_inferred_light(sure) or search.with_inferred_light(likely)
    lights = whole or search.adjusted() or search.lights
    return Lights(lights, search.missing(lights))


@dataclass(frozen=True)
class _Candidate:
    """A light under trial: its evidence, and the numbers of the other lights that the pixels which miss it miss too."""

    light: Light
    missed: tuple[int, ...]
    score: float
    flat: bool  # the matrix of the pixels that miss this light has nearly rank 2, as in ``Support``

    @property
    def certain(self) -> bool:
        """Whether hardly anything speaks against it."""
        return self.score > CERTAIN_SCORE * self.light.support


class _Search:
    """The lights found so far, and which pixels they explain.

    Usable pixels are numbered in raster order, from 0; all other pixels have the number −1 (``number``). There are P
    usable pixels. A light under trial is an array of six numbers, (b, a).
    """

    def __init__(self, problem: Problem, solution: Solution) -> None:
        """Number the pixels, label them before any light is known, and measure the inliers as the core (``Core``)."""
        usable = problem.usable
        self.usable, self.ray, self.noise = usable, problem.ray, problem.noise
        self.F = np.ascontiguousarray(solution.F, dtype=np.float64)
        self.rho = np.ascontiguousarray(problem.rgb[usable], dtype=np.float64)
        self.brightest = float(self.rho.max())
        self.tolerance = tolerance(self.brightest, self.noise)
        self.noisy = self.tolerance > LIGHTS.noisy_tolerance * self.brightest
        self.least_support = max(LIGHTS.least_support_px, LEAST_SUPPORT_SHARE * len(self.rho))
        self.random = np.random.default_rng(0)
        self.number = np.full(usable.shape, -1)
        self.number[usable] = np.arange(len(self.rho))
        # (P,) the inliers, which are taken to see every light
        self.inlier = (solution.inlier & usable)[usable]
        self.regions = ShadowRegions.of_core(self.rho, self.inlier, self.F, self.tolerance)
        # (P,) pixels off the ellipsoid of F, supposed to miss a light; highlights and other materials are among them
        self.off_ellipsoid = self.regions.unexplained
        normals = self.regions.normals
        sample = self.random.choice(np.flatnonzero(self.inlier), ALL_LIT_SAMPLE)
        # (N, 3) normals and (3, N) colours of some of the inliers
        self.lit_normals, self.lit_rho = np.ascontiguousarray(normals[sample]), np.ascontiguousarray(self.rho[sample].T)
        lit = self._image(self.inlier, False)
        curl = relative_curl(of_relief(self._image(normals, 0.0), self.ray), lit, smooth=self.noisy)
        residual = float(np.median(self.regions.distance[self.inlier]))
        self.core = Core(curl, residual, self.ray, self.noisy)
        # Width of the robust loss at the end of polishing, picture units
        self.fine = max(self.noise, FINE_RESIDUALS * self.core.residual)
        self.pool: list[_Candidate] = []
        self.supposed = 0  # searches left that may take a candidate of ``suppose`` before they look in windows

    @property
    def lights(self) -> tuple[Light, ...]:
        """The lights found so far."""
        return self.regions.lights

    def _image(self, values: np.ndarray, rest: float | bool) -> np.ndarray:
        """``values`` (P, …) of the usable pixels as an image, ``rest`` elsewhere."""
        out = np.full((*self.usable.shape, *values.shape[1:]), rest, dtype=values.dtype)
        out[self.usable] = values
        return out

    def missing(self, lights: tuple[Light, ...]) -> float:
        """|F − Σ b aᵀ| / |F| over ``lights``."""
        rest = without(self.F, lights, tuple(range(len(lights))))
        return float(np.linalg.norm(rest) / np.linalg.norm(self.F))

    def complete(self) -> tuple[Light, ...] | None:
        """Those of the lights found that together are all the light there is; None if no choice of them is."""
        choices = (c for k in range(1, len(self.lights) + 1) for c in combinations(self.lights, k))
        return next((choice for choice in choices if self.missing(choice) < LIGHTS.relative_light_error), None)

    def with_inferred_light(self, limit: float, share: float = 0.0) -> tuple[Light, ...] | None:
        """Some of the lights found, and one more light that is inferred: the rest of F. None where no choice fits.

        The remainder R = F − Σ b aᵀ over the chosen lights is one light where F⁻¹R has rank one: the second singular
        value of F⁻¹R must be below ``limit``. All subsets of the lights found are tried, because one of them may be
        wrong, and the subset with the least second singular value is taken. A ``limit`` of at most
        ``SURELY_ONE_LIGHT`` is evidence enough. With a larger one, the result must also explain at least as many pixels
        as all the lights found, and at least the ``share`` of the pixels off the ellipsoid of F.
        """
        best, least, sure = None, limit, limit <= SURELY_ONE_LIGHT
        for k in range(1, len(self.lights) + 1):
            for choice in combinations(self.lights, k):
                rest = without(self.F, choice, tuple(range(k)))
                _, s, vt = np.linalg.svd(np.linalg.solve(self.F, rest))
                a = vt[0] if vt[0, 2] > 0 else -vt[0]
                b = rest @ a
                one = s[1] < least and s[0] > LIGHTS.relative_light_error
                if one and self.possible(np.array([[*b, *a]])).all():
                    best, least = (choice, b, a), s[1]
        if best is None:
            return None
        whole = (*best[0], self._inferred(best[1], best[2], best[0]))
        if sure:
            return whole
        explained = self._explains(whole)
        enough = explained >= share * self.off_ellipsoid.sum() and explained >= self._explains(self.lights)
        return whole if enough else None

    def _inferred(self, b: np.ndarray, a: np.ndarray, others: tuple[Light, ...]) -> Light:
        """The light b aᵀ that remains beside the ``others``, fitted to pixels that miss it if there are some."""
        shadowed = np.flatnonzero(self.off_ellipsoid)
        some = self.rho[shadowed[:: max(1, len(shadowed) // MANY_SAMPLE)]]

        def explained(base: np.ndarray, b: np.ndarray, a: np.ndarray) -> np.ndarray:
            return shadowed[on_sphere(self.rho[shadowed], base - np.outer(b, a))[1] < self.tolerance]

        bases = [without(self.F, others, missed) for missed in ((), *((j,) for j in range(len(others))))]
        base, own = max(((base, explained(base, b, a)) for base in bases), key=lambda each: len(each[1]))
        best = self._judged(base, own, b, a) if len(own) else Light(a, b, 0, 1.0, 0.0)

        def fitted(start: tuple[np.ndarray, float]) -> tuple[np.ndarray, np.ndarray]:
            both = refined(some, start[0], np.concatenate([b, a]), start[1] * self.brightest, self.tolerance)
            return both, explained(start[0], both[:3], both[3:])

        starts = [(base, width) for base in bases for width in REFINEMENT_WIDTHS]
        for (base, _), (both, own) in zip(starts, in_threads(fitted, starts)):
            more = max(LEAST_GAIN * best.support, LIGHTS.least_support_px)
            if len(own) > more and self.possible(both[None]).all():
                light = self._judged(base, own, both[:3], both[3:])
                best = light if self.missing((*others, light)) < LIGHTS.relative_light_error else best
        return best

    def _explains(self, lights: tuple[Light, ...]) -> int:
        """Number of pixels off the ellipsoid of F that some set of up to MOST_AT_ONCE missed ``lights`` explains."""
        out = np.zeros(len(self.rho), bool)
        within = max(self.tolerance, INFERRED_TOLERANCE * self.brightest)
        for count in range(1, MOST_AT_ONCE + 1):
            for missed in combinations(range(len(lights)), count):
                out |= on_sphere(self.rho, without(self.F, lights, missed))[1] < within
        return int((out & self.off_ellipsoid).sum())

    def shadowed(self) -> np.ndarray:
        """Pixels (H, W) that no set of the lights found so far explains, single pixels left out."""
        return ndimage.binary_opening(self._image(self.regions.unexplained, False), np.ones((2, 2)))

    def _add(self, light: Light) -> None:
        self.regions.add(light, self.inlier)

    def settle(self) -> None:
        """Fit each light once more, to all pixels that miss it, whatever else they miss; and label the pixels anew."""
        for _ in range(SETTLING_ROUNDS):
            lights = tuple(self._fitted(k) for k in range(len(self.lights)))
            self.regions = self.regions.with_lights(lights, self.inlier)

    def _fitted(self, k: int) -> Light:
        """Light number ``k``, fitted to all pixels that miss it."""
        light, pixels = self.lights[k], self._pixels_of(self.regions, k)
        if not len(pixels[0]):
            return light
        start = np.concatenate([light.colour, light.direction])
        both = polished_beside(*pixels, start, self.tolerance, self.fine)
        loss, loss_before = (loss_beside(*pixels, one, self.tolerance) for one in (both, start))
        better = loss < loss_before and self.possible(both[None]).all()
        return replace(light, colour=both[:3], direction=both[3:]) if better else light

    def _pixels_of(self, regions: ShadowRegions, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(rho (P, 3), bases (G, 3, 3), ends (G + 1,)) of the pixels that miss light ``k``, for ``polished_beside``."""
        rho, bases, ends = [np.empty((0, 3))], [np.eye(3)], [0, 0]
        for number, missed in enumerate(regions.sets):
            own = np.flatnonzero(regions.label == number)
            if k in missed and len(own):
                rho.append(self.rho[own[:: 1 + len(own) // MOST_OF_SET]])
                bases.append(without(self.F, regions.lights, tuple(j for j in missed if j != k)))
                ends.append(ends[-1] + len(rho[-1]))
        return np.concatenate(rho), np.array(bases), np.array(ends)

    def adjusted(self) -> tuple[Light, ...] | None:
        """All or all but one of the lights found, and the rest of F as one more, fitted together so that they add up.

        As ``with_inferred_light``, for colours that are less certain: the rest need not be one light before the fit.
        The result must explain more pixels than the lights found do; else None.
        """
        every, best, least = tuple(range(len(self.lights))), None, ADJUSTED_REST
        fewer = combinations(every, len(every) - 1) if len(every) > 1 else ()
        for choice in (every, *fewer):
            rest = without(self.F, self.lights, choice)
            _, s, vt = np.linalg.svd(np.linalg.solve(self.F, rest))
            a = vt[0] if vt[0, 2] > 0 else -vt[0]
            if s[1] < least and self.possible(np.array([[*(rest @ a), *a]])).all():
                best, least = (*(self.lights[j] for j in choice), Light(a, rest @ a, 0, 1.0, 0.0)), s[1]
        if best is None:
            return None
        before, lights = self._explains(self.lights), best
        for _ in range(SETTLING_ROUNDS):
            regions = self.regions.with_lights(lights, self.inlier)
            start = np.array([np.concatenate([one.colour, one.direction]) for one in lights])
            pixels = [self._pixels_of(regions, k) for k in range(len(lights))]
            slack = SUM_SLACK * float(np.linalg.norm(self.F))
            fit = fitted_to_sum(pixels, self.F, start, SUM_WIDTH * self.tolerance, slack)
            lights = tuple(replace(one, colour=f[:3], direction=f[3:]) for one, f in zip(lights, fit))
        fine = self.missing(lights) < LIGHTS.relative_light_error and self.possible(fit).all()
        return lights if fine and self._explains(lights) > ADJUSTED_GAIN * before else None

    def possible(self, both: np.ndarray) -> np.ndarray:
        """Whether each (b, a) of ``both`` (K, 6) may be a light, (K,).

        It must shine from the front and have no negative colour. Hardly any of the pixels that see every light may face
        away from it, or be darker in a channel than this light alone would make them.
        """
        b, a = both[:, :3], both[:, 3:]
        cosine = a @ self.lit_normals.T
        rest = np.min([self.lit_rho[c] - b[:, c, None] * cosine for c in range(3)], axis=0)
        in_front = (a[:, 2] >= -BEHIND_CAMERA) & (b.min(axis=1) >= -NEGATIVE_SLACK * b.max(axis=1))
        behind = (cosine < -LIGHTS.far_side_cosine).mean(axis=1)
        slack = LIGHTS.relative_light_error * self.brightest + LIGHTS.outlier_deviations * self.noise
        too_much = (rest < -slack).mean(axis=1)
        share = LIGHTS.far_side_share
        return in_front & (behind <= share) & (too_much < share)  # type: ignore[no-any-return]

    def suppose(self, lights: tuple[Light, ...]) -> None:
        """Put ``lights``, fitted to the pixels of this picture, among the candidates of the first search."""
        index = self.number[self.shadowed()]
        if not len(index):
            return
        some = self.rho[self.random.choice(index, min(SPREAD_SAMPLE, len(index)), replace=False)]
        for light in lights:
            start = np.concatenate([light.colour, light.direction])
            end = polished(some, self.F, start, self.tolerance, self.fine)
            tried = self._judge((), end) if self.possible(end[None]).all() else None
            self.pool += [] if tried is None else [tried]
        self.pool = _strongest(self.pool)
        self.supposed = len(self.pool)

    def best_candidate(self) -> Light | None:
        """The light with the highest score among those that explain pixels which the lights found do not; None: none.

        It is looked for first among the candidates that earlier searches left, then in windows beside every region in
        turn. Without a look into windows only a certain candidate is taken; the first searches, as many as ``suppose``
        left candidates, also take one that is not certain.
        """
        self.pool = _strongest([again for one in self.pool if (again := self._again(one)) is not None])
        shadowed = self.shadowed()
        self.supposed -= 1
        for draw in range(DRAWS):
            if self.pool and (self.pool[0].certain or ((draw or self.supposed >= 0) and self._enough(self.pool[0]))):
                break
            for missed, around in self._places(shadowed):
                found = self._beside(missed, shadowed, around)
                self.pool = _strongest(self.pool + found)
                if self.pool and self.pool[0].certain:
                    break
        best = next(iter(self.pool), None)
        if best is None or not self._enough(best):
            return None
        self.pool = [one for one in self.pool if one is not best]
        return best.light

    def _enough(self, one: _Candidate) -> bool:
        """Whether a candidate may be accepted."""
        share = LIGHTS.least_credit * (LIGHTS.credit_of_flat if one.flat else 1.0)
        return one.score >= max(LIGHTS.least_score * self.least_support, share * one.light.support)

    def _again(self, one: _Candidate) -> _Candidate | None:
        """A candidate, judged by the pixels that are still unexplained; None where hardly any are left to it."""
        both = np.concatenate([one.light.colour, one.light.direction])
        return self._judge(one.missed, both)

    def _places(self, shadowed: np.ndarray) -> list[tuple[tuple[int, ...], np.ndarray]]:
        """(lights missed, pixels (H, W) of ``shadowed`` beside the region that misses them), longest border first."""
        places = []
        label = self._image(self.regions.label, -1)
        for k, missed in enumerate(self.regions.sets):
            if len(missed) > MOST_BESIDE:
                continue
            own = ndimage.binary_opening(label == k, np.ones((2, 2)))
            around = shadowed & ndimage.binary_dilation(own, np.ones((3, 3)), iterations=BORDER_PX)
            if around.sum() >= FEWEST_IN_WINDOW:
                places.append((missed, around))
        places.sort(key=lambda place: -int(place[1].sum()))
        return places[:MOST_PLACES]

    def _beside(self, missed: tuple[int, ...], shadowed: np.ndarray, around: np.ndarray) -> list[_Candidate]:
        """Lights that pixels of ``shadowed`` (H, W) miss besides ``missed``, from windows ``around`` (H, W)."""
        base = without(self.F, self.lights, missed)
        if np.linalg.cond(base) > WORST_CONDITION:
            return []
        index = self.number[shadowed & ndimage.binary_dilation(around, iterations=BELT_PX)]
        guesses = self._guesses(base, shadowed, around)
        if not len(guesses):
            return []
        sample = self.rho[self.random.choice(index, min(FEW_SAMPLE, len(index)), replace=False)]

        guesses = guesses[self.possible(guesses)]
        starts: list[np.ndarray] = []
        for width in sorted({SUPPORT_WIDTH * self.fine, SUPPORT_WIDTH * self.tolerance}):
            support = one_light.support(sample, base, guesses, width)
            starts += _distinct(guesses[np.argsort(-support, kind="stable")])[:REFINED]
        starts = _distinct(np.array(starts))
        some = self.rho[self.random.choice(index, min(MANY_SAMPLE, len(index)), replace=False)]

        def share(end: np.ndarray) -> float:
            distance = on_sphere(some, base - np.outer(end[:3], end[3:]))[1]
            near = distance[distance < self.tolerance]
            return len(near) / len(some) * sharpness(near, self.tolerance, self.core.residual)

        def best_end(start: np.ndarray) -> tuple[float, np.ndarray]:
            widths = {max(self.fine, width * self.brightest) for width in POLISHING_WIDTHS} | {POLISH_FROM * self.fine}
            ends = [polished(some, base, start, width, self.fine) for width in sorted(widths)]
            shares = [share(end) for end in ends]
            return max(shares), ends[int(np.argmax(shares))]

        def judged(end: np.ndarray) -> list[_Candidate]:
            partners = np.array([np.concatenate(fold) for fold in folds(base, end[:3], end[3:])])
            tried = [self._judge(missed, both) for both in partners[self.possible(partners)]]
            return [self._spread(one, base, every) for one in tried if one is not None]

        rest = self.number[shadowed]
        every = self.rho[self.random.choice(rest, min(SPREAD_SAMPLE, len(rest)), replace=False)]
        ends = [end for end in in_threads(best_end, starts) if end[0] * len(index) > self._enough_to_polish]
        ends.sort(key=lambda end: -end[0])
        found = in_threads(judged, _distinct(np.array([end for _, end in ends]).reshape(-1, 6)))
        return [one for own in found for one in own]

    def _spread(self, one: _Candidate, base: np.ndarray, rho: np.ndarray) -> _Candidate:
        """The candidate fitted to colours ``rho`` (P, 3) of unexplained pixels from all over the picture.

        As it is where its score is very low, or the fit does not raise it.
        """
        if one.score < WORTH_SPREADING * self.least_support:
            return one
        both = np.concatenate([one.light.colour, one.light.direction])
        for width in (POLISH_FROM * self.tolerance, self.tolerance):
            end = polished(rho, base, both, width, self.fine)
            again = self._judge(one.missed, end) if self.possible(end[None]).all() else None
            if again is not None and again.score > one.score:
                one, both = again, end
        return one

    def _judge(self, missed: tuple[int, ...], both: np.ndarray) -> _Candidate | None:
        """The candidate of the light ``both`` (6,) by the pixels that miss it besides ``missed``; None: hardly any do.

        None, too, where the light is one that was already found.
        """
        b, a = both[:3], both[3:]
        if any(a @ one.direction > KNOWN_COSINE for one in self.lights):
            return None
        M = without(self.F, self.lights, missed) - np.outer(b, a)
        open_ = np.flatnonzero(self.regions.unexplained)
        n, distance = on_sphere(self.rho[open_], M)
        near = distance < self.tolerance
        if near.sum() < self.least_support:
            return None
        own_px = np.zeros(len(self.rho), bool)
        own_px[open_[near]] = True
        own = ndimage.binary_opening(self._image(own_px, False), np.ones((2, 2)))
        if own.sum() < self.least_support:
            return None
        inside = own[self.usable][open_]
        beside = self._image(self.regions.label == self.regions.sets.index(missed), False)
        values = np.linalg.svd(np.linalg.solve(self.F, M))[1]
        best: tuple[Support, np.ndarray] | None = None
        for sheet in sheets(self.rho[open_], M, n, self.tolerance) if values[2] < NEARLY_FLAT else [n]:
            normals = self.regions.normals.copy()
            normals[open_] = sheet
            support = measure(
                self._image(normals, 0.0),
                own,
                beside,
                self.core,
                sharp=sharpness(distance[inside], self.tolerance, self.core.residual),
                flat=bool(values[2] < FLAT),
            )
            if best is None or support.score > best[0].score:
                best = support, sheet
        if best is None:
            return None
        support, n = best
        attached = float((n[inside] @ a < 0).mean())
        return _Candidate(Light(a, b, support.pixels, support.curl, attached), missed, support.score, support.flat)

    @property
    def _enough_to_polish(self) -> float:
        """Pixels that a polished guess must explain to be judged."""
        return ENOUGH_TO_POLISH * self.least_support

    def _judged(self, base: np.ndarray, own: np.ndarray, b: np.ndarray, a: np.ndarray) -> Light:
        """The light (b, a) with what its ``own`` pixels, whose matrix is ``base`` − b aᵀ, show: count, curl, share."""
        normals, which = np.zeros((len(self.rho), 3)), np.zeros(len(self.rho), bool)
        which[own] = True
        normals[own], _ = on_sphere(self.rho[own], base - np.outer(b, a))
        image = self._image(normals, 0.0)
        curl = relative_curl(of_relief(image, self.ray), self._image(which, False), smooth=self.noisy)
        return Light(a, b, len(own), curl, float((normals[own] @ a < 0).mean()))

    def _guesses(self, base: np.ndarray, shadowed: np.ndarray, around: np.ndarray) -> np.ndarray:
        """(b, a) (K, 6): the best few guesses from each of the windows that ``_windows`` draws.

        ``base`` (3, 3) is the matrix that the pixels of the windows would have if they saw the light.
        """
        directions = fibonacci(GUESSED_COLOURS)
        colours = directions @ base.T
        real = colours.min(axis=1) > -NEGATIVE_SLACK * colours.max(axis=1)
        windows = self._windows(shadowed, around)
        if not windows or not real.any():
            return np.empty((0, 6))
        size = np.linalg.norm(colours[real], axis=1, keepdims=True)
        counts = np.array([len(window) for window in windows])
        padded = np.zeros((len(windows), counts.max()), np.int64)
        for row, window in zip(padded, windows):
            row[: len(window)] = self.random.permutation(window)
        length = self.rho @ np.linalg.inv(base).T
        out = np.empty((len(windows), BEST_OF_WINDOW, 6))
        # Guesses are unit colours b, and c = base⁻¹ b.
        c, b = np.ascontiguousarray(directions[real] / size), np.ascontiguousarray(colours[real] / size)
        lit = self.lit_normals[:FACING_SAMPLE]
        limits = WindowLimits(
            LIGHTS.far_side_cosine,
            LIGHTS.far_side_share,
            LIGHTS.window_share,
            ALIKE_COSINE,
            LIGHTS.alike_colour,
        )

        def scan(some: slice) -> None:
            one_light.scan(padded[some], counts[some], length, self.rho, c, b, base, lit, limits, self.fine, out[some])

        in_threads(scan, (slice(k, k + WINDOWS_AT_ONCE) for k in range(0, len(windows), WINDOWS_AT_ONCE)))
        return out.reshape(-1, 6)[np.isfinite(out[..., 0].ravel())]

    def _windows(self, shadowed: np.ndarray, around: np.ndarray) -> list[np.ndarray]:
        """For each of up to GUESS_WINDOWS square windows, the numbers of the pixels that count in it.

        Windows are centred on pixels of ``around`` (H, W), a subset of ``shadowed`` (H, W) beside a known region, drawn
        at random. In windows of the half widths LIGHTS.window_half_widths_px all pixels of ``shadowed`` count; in those
        of the half widths STRIP_HALF_WIDTHS only pixels of ``around``. The half widths take turns. Windows of fewer
        than FEWEST_IN_WINDOW such pixels are left out.
        """
        rows, columns = np.nonzero(around)
        windows = []
        kinds = [(half, shadowed) for half in LIGHTS.window_half_widths_px]
        kinds += [(half, around) for half in STRIP_HALF_WIDTHS]
        picks = self.random.choice(len(rows), min(GUESS_WINDOWS, len(rows)), replace=False)
        for k, pick in enumerate(picks):
            half, within = kinds[k % len(kinds)]
            box = np.s_[
                max(rows[pick] - half, 0) : rows[pick] + half + 1,
                max(columns[pick] - half, 0) : columns[pick] + half + 1,
            ]
            inside = self.number[box][within[box]]
            if len(inside) >= FEWEST_IN_WINDOW:
                windows.append(inside)
        return windows


def _strongest(candidates: list[_Candidate]) -> list[_Candidate]:
    """The candidates by their score, the best first, at most MOST_CANDIDATES.

    Of candidates that are alike and whose pixels miss the same other lights, only the best is kept.
    """
    kept: list[_Candidate] = []
    for one in sorted(candidates, key=lambda one: -one.score):
        both = np.concatenate([one.light.colour, one.light.direction])
        same = (other for other in kept if other.missed == one.missed)
        others = (np.concatenate([other.light.colour, other.light.direction]) for other in same)
        if not any(alike(both, other, ALIKE_COSINE, LIGHTS.alike_colour) for other in others):
            kept.append(one)
    return kept[:MOST_CANDIDATES]


def _distinct(lights: np.ndarray) -> list[np.ndarray]:
    """Those of the lights (b, a) (K, 6) that are not alike one that comes before."""
    kept: list[np.ndarray] = []
    for one in lights:
        if not any(alike(one, other, ALIKE_COSINE, LIGHTS.alike_colour) for other in kept):
            kept.append(one)
    return kept
