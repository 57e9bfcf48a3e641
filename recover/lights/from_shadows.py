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

from itertools import combinations

import numpy as np
from scipy import ndimage

from huesphere.recover.geometry.rays import of_relief
from huesphere.recover.geometry.sphere import fibonacci, on_sphere
from huesphere.recover.geometry.threads import in_threads
from huesphere.recover.lights import one_light
from huesphere.recover.lights.model import LEAST_SUPPORT_SHARE, Light, Lights, tolerance, without
from huesphere.recover.lights.one_light import WindowLimits, alike, folds, refined
from huesphere.recover.lights.parameters import LIGHTS
from huesphere.recover.problem import Problem
from huesphere.recover.solution import Solution

# Each guess of a light is refined from each of these widths of the robust loss; the best end is kept (brightest).
REFINEMENT_WIDTHS = (0.02, 0.001, 0.0002)

GUESS_WINDOWS = 70  # Windows of shadowed pixels from which a light is guessed, in one search (windows).

# Bounds on the work: more of these makes the search slower and, within the variation from draw to draw, no better.
MOST_LIGHTS = 9  # lights, for all sets of them are looked at
GUESSED_COLOURS = 700  # directions of F⁻¹b on the grid, over the whole sphere
FEWEST_IN_WINDOW = 14  # pixels that a window must hold to be used
BEST_OF_WINDOW = 4  # guesses of each window that are kept
REFINED = 12  # guesses that are refined to all pixels
ENOUGH_TO_POLISH = 0.5  # of the fewest pixels of a light, which a refined guess must explain to be polished
POLISHING_ROUNDS = 50  # rounds of Gauss–Newton in polishing, at most
SUPPORT_WIDTH = 8  # tolerances within which pixels support a guess that is not refined yet
FACING_SAMPLE = 64  # pixels that see every light, against which each guess of a window is checked
FEW_SAMPLE, MANY_SAMPLE, ALL_LIT_SAMPLE = 600, 2500, 800  # pixels drawn to refine, to polish, and that see all lights
WINDOWS_AT_ONCE = 10  # windows a thread takes at a time
DRAWS = 3  # draws of windows before the search gives up
COMPLETING_SHARE = 0.8  # of the pixels that miss a light, whose explanation ends the search: saves a third of its time
ALIKE_COSINE = 0.97  # of directions of guesses that may be one light: less than this, and they are two
KNOWN_COSINE = (
    0.98  # of the directions of a light already found and a candidate: more than this, and they are one light
)
CLEAR_SHARE = 0.1  # of the shadowed pixels: a light of little curl with more support makes the search stop early
STILL_UNEXPLAINED = 0.5  # of a light's pixels, which others found must leave unexplained for it to be added
MOST_AT_ONCE = 3  # lights that pixels are supposed to miss together, in sets

WORST_CONDITION = 2e3  # of the matrix of a shadow within which a second is looked for: beyond, it is singular
LEAST_N3 = 0.12  # n_z of normals whose slopes take part in the curl: slopes grow without bound toward the rim
FEWEST_SQUARES = 20  # squares of 2×2 pixels whose median curl means something
SURELY_ONE_LIGHT = 0.005  # second singular value of a remainder that surely is one light: 0.003 to 0.016 are seen
LEAST_GAIN = 1.2  # pixels that a fit of an inferred light must explain over those that the remainder explains
INFERRED_TOLERANCE = 5e-4  # of the brightest: least tolerance of a light that no pixel was fitted to
NEGATIVE_SLACK = 0.1  # of a light's largest channel: how negative another may come out of a fit, or be guessed
BEHIND_CAMERA = 0.02  # −n_z of a light's direction, at most: lights behind the object give no light that is seen


def find_lights(problem: Problem, solution: Solution) -> Lights:
    """The lights that usable pixels of the picture miss, each found by the pixels that miss it.

    ``solution``: F with its rotation (and convexity) chosen, and its inliers, which see every light.
    Directions are in the camera frame, colours in picture units. The search draws pixels with a fixed seed, so the
    same input gives the same lights.
    """
    search = _Search(problem, solution)
    sure, likely = SURELY_ONE_LIGHT, LIGHTS.relative_light_error
    whole = None
    while whole is None and len(search.lights) < MOST_LIGHTS:
        shadowed = search.shadowed()
        if shadowed.sum() < search.least_support:
            break
        candidates = search.candidates(shadowed)
        if not candidates:
            whole = search.with_inferred_light(likely)
            if whole is not None:
                break
            candidates = next(filter(None, (search.candidates(shadowed) for _ in range(DRAWS - 1))), [])
        if not candidates:
            break
        search.add_all(candidates)
        whole = (
            search.complete()
            or search.with_inferred_light(sure)
            or search.with_inferred_light(likely, COMPLETING_SHARE)
        )
    lights = whole or search.with_inferred_light(likely) or search.lights
    return Lights(lights, search.missing(lights))


class _Search:
    """The lights found so far, and which pixels they explain.

    Pixels are numbered as they come in the rows of the picture, usable ones alone. A light under trial is an array of
    six numbers, (b, a).
    """

    def __init__(self, problem: Problem, solution: Solution) -> None:
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
        self.place = np.nonzero(usable)
        all_lit = (solution.inlier & usable)[usable]
        normals, self.residual = on_sphere(self.rho, self.F)  # residual: of the best set of missing lights so far
        self.misses_light = ~all_lit & (self.residual > self.tolerance)
        sample = self.random.choice(np.flatnonzero(all_lit), ALL_LIT_SAMPLE)
        self.lit_normals, self.lit_rho = np.ascontiguousarray(normals[sample]), np.ascontiguousarray(self.rho[sample].T)
        self.lights: tuple[Light, ...] = ()

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
        as all the lights found, and at least the ``share`` of the pixels that miss a light.
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
        enough = explained >= share * self.misses_light.sum() and explained >= self._explains(self.lights)
        return whole if enough else None

    def _inferred(self, b: np.ndarray, a: np.ndarray, others: tuple[Light, ...]) -> Light:
        """The light b aᵀ that remains beside the ``others``, fitted to pixels that miss it if there are some."""
        shadowed = np.flatnonzero(self.misses_light)
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
        """How many of the pixels that miss a light some set of up to three of the ``lights``, missing, explains."""
        out = np.zeros(len(self.rho), bool)
        within = max(self.tolerance, INFERRED_TOLERANCE * self.brightest)
        for count in range(1, MOST_AT_ONCE + 1):
            for missed in combinations(range(len(lights)), count):
                out |= on_sphere(self.rho, without(self.F, lights, missed))[1] < within
        return int((out & self.misses_light).sum())

    def shadowed(self) -> np.ndarray:
        """Pixels (H, W) that no set of the lights found so far explains, single pixels left out."""
        image = np.zeros(self.usable.shape, bool)
        image[self.usable] = self.misses_light & (self.residual > self.tolerance)
        return ndimage.binary_opening(image, np.ones((2, 2)))

    def add_all(self, candidates: list[Light]) -> None:
        """Add the first of the candidates, then those that still explain pixels beside what was added, in order."""
        self._add(candidates[0])
        for light in candidates[1:]:
            if self.complete() is not None or len(self.lights) == MOST_LIGHTS:
                break
            known = any(light.direction @ other.direction > KNOWN_COSINE for other in self.lights)
            left = 0 if known else (self.shadowed()[self.usable] & (self._distance(light) < self.tolerance)).sum()
            if left > STILL_UNEXPLAINED * light.support:
                self._add(light)

    def _distance(self, light: Light) -> np.ndarray:
        """Distances (P,) of the pixels' colours to the ellipsoid of those that miss ``light`` alone."""
        return on_sphere(self.rho, self.F - np.outer(light.colour, light.direction))[1]

    def _add(self, light: Light) -> None:
        self.lights = (*self.lights, light)
        newest = len(self.lights) - 1
        for more in range(MOST_AT_ONCE):
            for others in combinations(range(newest), more):
                _, distance = on_sphere(self.rho, without(self.F, self.lights, (*others, newest)))
                self.residual = np.minimum(self.residual, distance)

    def possible(self, both: np.ndarray) -> np.ndarray:
        """Whether each (b, a) of ``both`` (K, 6) may be a light, (K,).

        It must shine from the front, have no negative colour, have no pixel that sees all lights behind it, and give
        no more light than such pixels get.
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

    def candidates(self, shadowed: np.ndarray) -> list[Light]:
        """Lights that explain many of the ``shadowed`` pixels (H, W) as a surface, alone or beside one known light.

        Best first: support over 1 + (curl / ``curl_halving_credit``)².
        """
        found: list[Light] = []
        credit = LIGHTS.curl_halving_credit
        for missed in ((), *((j,) for j in range(len(self.lights)))):
            base = without(self.F, self.lights, missed)
            if np.linalg.cond(base) < WORST_CONDITION:
                found += self._beside(base, shadowed)
            if any(light.curl < credit and light.support > CLEAR_SHARE * shadowed.sum() for light in found):
                break
        return sorted(found, key=lambda light: -light.support / (1 + (light.curl / credit) ** 2))

    def _beside(self, base: np.ndarray, shadowed: np.ndarray) -> list[Light]:
        """Lights whose absence from the matrix ``base`` (3, 3) explains pixels of ``shadowed`` (H, W)."""
        index = self.number[shadowed]
        guesses = self._guesses(base, shadowed)
        if not len(guesses):
            return []
        sample = self.rho[self.random.choice(index, min(FEW_SAMPLE, len(index)), replace=False)]

        guesses = guesses[self.possible(guesses)]
        support = one_light.support(sample, base, guesses, SUPPORT_WIDTH * self.tolerance)
        starts = _distinct(guesses[np.argsort(-support, kind="stable")])[:REFINED]
        some = self.rho[self.random.choice(index, min(MANY_SAMPLE, len(index)), replace=False)]
        few = some[:FEW_SAMPLE]

        def share(end: np.ndarray) -> float:
            distance = on_sphere(few, base - np.outer(end[:3], end[3:]))[1]
            return float((distance < self.tolerance).mean())

        def best_end(start: np.ndarray) -> tuple[float, np.ndarray]:
            widths = REFINEMENT_WIDTHS
            ends = [refined(few, base, start, width * self.brightest, self.tolerance) for width in widths]
            shares = [share(end) for end in ends]
            return max(shares), ends[int(np.argmax(shares))]

        def lights(end: np.ndarray) -> list[Light]:
            end = refined(some, base, end, self.tolerance, self.tolerance, rounds=POLISHING_ROUNDS)
            own = index[on_sphere(self.rho[index], base - np.outer(end[:3], end[3:]))[1] < self.tolerance]
            if len(own) < self.least_support:
                return []
            partners = np.array([np.concatenate(fold) for fold in folds(base, end[:3], end[3:])])
            return [self._judged(base, own, both[:3], both[3:]) for both in partners[self.possible(partners)]]

        ends = [end for end in in_threads(best_end, starts) if end[0] * len(index) > self._enough_to_polish]
        ends.sort(key=lambda end: -end[0])
        most_curl = LIGHTS.most_curl * (LIGHTS.noisy_curl_factor if self.noisy else 1.0)
        found = in_threads(lights, _distinct(np.array([end for _, end in ends]).reshape(-1, 6)))
        return [light for own in found for light in own if light.curl < most_curl]

    @property
    def _enough_to_polish(self) -> float:
        """Pixels that a refined guess must explain to be polished."""
        return ENOUGH_TO_POLISH * self.least_support

    def _judged(self, base: np.ndarray, own: np.ndarray, b: np.ndarray, a: np.ndarray) -> Light:
        """The light (b, a), with the curl and the attached share of its ``own`` pixels, of matrix ``base`` − b aᵀ."""
        n, _ = on_sphere(self.rho[own], base - np.outer(b, a))
        rows, columns = (index[own] for index in self.place)
        box = slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1)
        normals = np.zeros((box[0].stop - box[0].start, box[1].stop - box[1].start, 3))
        normals[rows - box[0].start, columns - box[1].start] = n
        ray = None if self.ray is None else self.ray[box]
        curl = relative_curl(of_relief(normals, ray), normals[..., 2] != 0, smooth=self.noisy)
        return Light(a, b, len(own), curl, float((n @ a < 0).mean()))

    def _guesses(self, base: np.ndarray, shadowed: np.ndarray) -> np.ndarray:
        """(b, a) (K, 6): the best few of each of some windows of ``shadowed`` pixels (H, W), fitted to the window."""
        directions = fibonacci(GUESSED_COLOURS)
        colours = directions @ base.T
        real = colours.min(axis=1) > -NEGATIVE_SLACK * colours.max(axis=1)
        windows = self._windows(shadowed)
        if not windows or not real.any():
            return np.empty((0, 6))
        size = np.linalg.norm(colours[real], axis=1, keepdims=True)
        counts = np.array([len(window) for window in windows])
        padded = np.zeros((len(windows), counts.max()), np.int64)
        for row, window in zip(padded, windows):
            row[: len(window)] = self.random.permutation(window)
        length = self.rho @ np.linalg.inv(base).T
        out = np.empty((len(windows), BEST_OF_WINDOW, 6))
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
            one_light.scan(
                padded[some], counts[some], length, self.rho, c, b, base, lit, limits, self.tolerance, out[some]
            )

        in_threads(scan, (slice(k, k + WINDOWS_AT_ONCE) for k in range(0, len(windows), WINDOWS_AT_ONCE)))
        return out.reshape(-1, 6)[np.isfinite(out[..., 0].ravel())]

    def _windows(self, shadowed: np.ndarray) -> list[np.ndarray]:
        """Numbers of the ``shadowed`` pixels (H, W) of windows drawn at random among them."""
        rows, columns = np.nonzero(shadowed)
        half_widths, windows = LIGHTS.window_half_widths_px, []
        picks = self.random.choice(len(rows), min(GUESS_WINDOWS, len(rows)), replace=False)
        for k, pick in enumerate(picks):
            half = half_widths[k % len(half_widths)]
            around = np.s_[
                max(rows[pick] - half, 0) : rows[pick] + half + 1,
                max(columns[pick] - half, 0) : columns[pick] + half + 1,
            ]
            inside = self.number[around][shadowed[around]]
            if len(inside) >= FEWEST_IN_WINDOW:
                windows.append(inside)
        return windows


def _distinct(lights: np.ndarray) -> list[np.ndarray]:
    """Those of the lights (b, a) (K, 6) that are not alike one that comes before."""
    kept: list[np.ndarray] = []
    for one in lights:
        if not any(alike(one, other, ALIKE_COSINE, LIGHTS.alike_colour) for other in kept):
            kept.append(one)
    return kept


def relative_curl(normals: np.ndarray, region: np.ndarray, *, smooth: bool = False) -> float:
    """How far slopes are from closing around squares of 2×2 pixels, over how much they vary there: the median.

    ``normals`` (H, W, 3), camera frame, within ``region`` (H, W). 0 on a surface, about 0.4 on vectors that have
    nothing to do with a surface, 1 where the region holds too few squares. ``smooth``: slopes are averaged over 3×3
    pixels first, against noise.
    """
    region = region & (normals[..., 2] > LEAST_N3)
    n3 = np.where(region, normals[..., 2], 1.0)
    p, q = (np.where(region, -normals[..., i] / n3, 0.0) for i in (0, 1))
    if smooth:
        region = ndimage.binary_erosion(region, np.ones((3, 3)))
        p, q = ndimage.uniform_filter(p, 3), ndimage.uniform_filter(q, 3)
    whole = region[:-1, :-1] & region[:-1, 1:] & region[1:, :-1] & region[1:, 1:]
    if whole.sum() < FEWEST_SQUARES:
        return 1.0
    i, j = np.nonzero(whole)
    # p and q at the corners of each square: top left, top right, bottom left, bottom right
    (p0, p1, p2, p3), (q0, q1, q2, q3) = (
        (image[i, j], image[i, j + 1], image[i + 1, j], image[i + 1, j + 1]) for image in (p, q)
    )
    loop = p0 + p1 - p2 - p3 - q1 - q3 + q0 + q2
    varied = sum(
        np.abs(b - a) + np.abs(d - c) + np.abs(c - a) + np.abs(d - b)
        for a, b, c, d in ((p0, p1, p2, p3), (q0, q1, q2, q3))
    )
    return float(np.median(np.abs(loop) / (varied + 1e-12)))
