"""The lights, one by one, from one picture: each that some pixel misses gives itself away there.

Let F be the matrix of the pixels that see every light, known with its rotation. A pixel that misses light j has the
colour ρ = (F − b aᵀ) n, b the light's colour and a its direction, whether the surface is turned away (a·n < 0, attached
shadow) or something stands between (a·n > 0, cast shadow). For a guessed *direction* of b, |n| = 1 gives the pixel's
normal and τ = −|b| a·n in closed form (a quadratic), and τ must be linear in n: so three numbers, |b| a, follow by
least squares from the pixels of one small window. The guesses are a grid over directions of F⁻¹b, two numbers.

Each ellipsoid (F − b aᵀ) S² has up to four (b, a): a and its partner may change roles, and normals may be mirrored in
the plane across a. Only one makes the pixels a surface: the curl of their slopes decides. And a light must leave the
rest possible: at every pixel that sees all lights a·n ≥ 0, and no channel is darker than the light alone would make
it.

When Σ b aᵀ = F no light is missing ("completeness"). Where all but one are found, what is missing is the last, though
it may have no shadow in the picture; of two or more without a shadow only the sum is known.
"""

from itertools import combinations

import numpy as np
from scipy import ndimage

from huesphere.recover.geometry.rays import of_relief
from huesphere.recover.geometry.sphere import fibonacci, on_sphere
from huesphere.recover.geometry.threads import in_threads
from huesphere.recover.lights import one_light as light_fit
from huesphere.recover.lights.model import COMPLETE, WITHIN, Light, Lights, tolerance, without
from huesphere.recover.lights.one_light import alike, folds, refined

MOST_LIGHTS = 9
COLOURS = 700  # directions of F⁻¹b tried, over the whole sphere
WINDOWS, HALF_WIDTHS, FEWEST_IN_WINDOW = 70, (3, 7), 14  # windows of shadowed pixels, and pixels in each
CHECKED = 64  # all-lit pixels that must be on the lit side of a guess
BEST_OF_WINDOW = 4  # guesses of each window that are looked at
COARSE = (0.02, 0.001, 0.0002)  # of the brightest colour: widths from which a guess is refined
REFINED = 12  # guesses refined to all pixels, those that most support
WORTH_POLISHING = 0.5  # of the fewest pixels of a light, which a guess must explain to be refined to the end
POLISHED = 50  # rounds, at most, of the best end of a guess
SAMPLE, REFINE_SAMPLE, LIT_SAMPLE = 600, 2500, 800
LEAST_SHARE, LEAST_PIXELS = 0.002, 40  # of support, below which a light is not believed
CURL, MOST_CURL = (
    0.02,
    0.035,
)  # relative curl of the shadowed pixels' slopes: halves the score; too much to be a surface
NOISY, GRAINY = 2.0, 1e-3  # times that much in a noisy picture; tolerance, over the brightest, of one
FEWEST_FOR_CURL = 20  # squares of 2×2 pixels
FAR_SIDE, FAR_SHARE = 0.06, 0.01  # all-lit pixels may lie so far beyond a terminator, and so many of them
ONE_LIGHT, SURELY_ONE = 0.03, 0.005  # second singular value of 1 − Σ F⁻¹b aᵀ: the rest may be one light, and is
EXPLAINED = 5e-4  # of the brightest colour: how near that light must come, which no pixel was fitted to
MOST_EXPLAINED = 0.8  # of the pixels that miss a light, beyond which lights that are complete end the search
MORE = 1.2  # times the pixels that the rest explains must be explained by a fit to them, to be better than it
AT_ONCE = 10  # windows a thread takes at a time
TRIES = 3  # draws of windows before the search gives up
WORST_CONDITION = 2e3  # of the matrix of a shadow within which a second is looked for
FLATTEST = 0.12  # n_z of normals whose slopes take part in the curl


def find_lights(
    rgb: np.ndarray,
    usable: np.ndarray,
    all_lit: np.ndarray,
    F: np.ndarray,
    noise: float,
    ray: np.ndarray | None = None,
) -> Lights:
    """The lights that pixels of ``usable`` (H, W) miss, from colours (H, W, 3), camera frame.

    ``all_lit`` (H, W) are the pixels of the matrix ``F`` (3, 3), rotation and twin included. ``noise``: standard
    deviation of a channel, picture units. ``ray`` (H, W, 2): of a picture in perspective (``recover.geometry.rays``).
    """
    search = _Search(rgb, usable, all_lit, F, noise, ray)
    whole = None
    while whole is None and len(search.lights) < MOST_LIGHTS:
        shadowed = search.shadowed()
        if shadowed.sum() < max(LEAST_PIXELS, LEAST_SHARE * len(search.rho)):
            break
        candidates = search.candidates(shadowed)
        if not candidates:
            whole = search.with_the_rest(ONE_LIGHT)
            if whole is not None:
                break
            candidates = next(filter(None, (search.candidates(shadowed) for _ in range(TRIES - 1))), [])
        if not candidates:
            break
        search.add_all(candidates)
        whole = search.complete() or search.with_the_rest(SURELY_ONE) or search.with_the_rest(ONE_LIGHT, MOST_EXPLAINED)
    lights = whole or search.with_the_rest(ONE_LIGHT) or search.lights
    return Lights(lights, search.missing(lights))


class _Search:
    def __init__(
        self,
        rgb: np.ndarray,
        usable: np.ndarray,
        all_lit: np.ndarray,
        F: np.ndarray,
        noise: float,
        ray: np.ndarray | None = None,
    ) -> None:
        self.ray = ray
        self.usable, self.F = usable, np.ascontiguousarray(F, dtype=np.float64)
        self.rho = np.ascontiguousarray(rgb[usable], dtype=np.float64)
        self.brightest = float(self.rho.max())
        self.noise = noise
        self.near = tolerance(self.brightest, noise)
        self.noisy = self.near > GRAINY * self.brightest
        self.random = np.random.default_rng(0)
        self.number = np.full(usable.shape, -1)
        self.number[usable] = np.arange(len(self.rho))
        self.place = np.nonzero(usable)
        self.lit = (all_lit & usable)[usable]
        normals, self.residual = on_sphere(self.rho, self.F)
        self.dim = ~self.lit & (self.residual > self.near)
        sample = self.random.choice(np.flatnonzero(self.lit), LIT_SAMPLE)
        self.lit_normals, self.lit_rho = np.ascontiguousarray(normals[sample]), np.ascontiguousarray(self.rho[sample].T)
        self.lights: tuple[Light, ...] = ()

    def missing(self, lights: tuple[Light, ...]) -> float:
        """|F − Σ b aᵀ| / |F|."""
        rest = without(self.F, lights, tuple(range(len(lights))))
        return float(np.linalg.norm(rest) / np.linalg.norm(self.F))

    def complete(self) -> tuple[Light, ...] | None:
        """Those of the lights found that together are all the light there is; None: no choice of them is."""
        choices = (c for k in range(1, len(self.lights) + 1) for c in combinations(self.lights, k))
        return next((choice for choice in choices if self.missing(choice) < COMPLETE), None)

    def with_the_rest(self, least: float, share: float = 0.0) -> tuple[Light, ...] | None:
        """Lights found and one more, which is all that is missing beside them; None where that is not one light.

        In units of F the rest of completeness has rank one then, a second singular value below ``least``. It takes the
        place of a light found amiss if need be. Where it is not surely one, it must explain as many pixels as those
        found do, and a ``share`` of all that miss a light.
        """
        best, surely = None, least <= SURELY_ONE
        for k in range(1, len(self.lights) + 1):
            for choice in combinations(self.lights, k):
                rest = without(self.F, choice, tuple(range(k)))
                _, s, vt = np.linalg.svd(np.linalg.solve(self.F, rest))
                a = vt[0] if vt[0, 2] > 0 else -vt[0]
                b = rest @ a
                if s[1] < least and s[0] > COMPLETE and self.possible(np.array([[*b, *a]])).all():
                    best, least = (choice, b, a), s[1]
        if best is None:
            return None
        whole = (*best[0], self._rest(best[1], best[2], best[0]))
        if surely:
            return whole
        explained = self._explains(whole)
        enough = explained >= share * self.dim.sum() and explained >= self._explains(self.lights)
        return whole if enough else None

    def _rest(self, b: np.ndarray, a: np.ndarray, others: tuple[Light, ...]) -> Light:
        """The light b aᵀ that is left beside the ``others``, fitted to pixels that miss it, if there are some."""
        shadowed = np.flatnonzero(self.dim)
        some = self.rho[shadowed[:: max(1, len(shadowed) // REFINE_SAMPLE)]]

        def near(base: np.ndarray, b: np.ndarray, a: np.ndarray) -> np.ndarray:
            return shadowed[on_sphere(self.rho[shadowed], base - np.outer(b, a))[1] < self.near]

        bases = [without(self.F, others, off) for off in ((), *((j,) for j in range(len(others))))]
        base, own = max(((base, near(base, b, a)) for base in bases), key=lambda each: len(each[1]))
        best = self._judged(base, own, b, a) if len(own) else Light(a, b, 0, 1.0, 0.0)

        def settled(start: tuple[np.ndarray, float]) -> tuple[np.ndarray, np.ndarray]:
            both = refined(some, start[0], np.concatenate([b, a]), start[1] * self.brightest, self.near)
            return both, near(start[0], both[:3], both[3:])

        starts = [(base, width) for base in bases for width in COARSE]
        for (base, _), (both, own) in zip(starts, in_threads(settled, starts)):
            if len(own) > max(MORE * best.support, LEAST_PIXELS) and self.possible(both[None]).all():
                light = self._judged(base, own, both[:3], both[3:])
                best = light if self.missing((*others, light)) < COMPLETE else best
        return best

    def _explains(self, lights: tuple[Light, ...]) -> int:
        """How many pixels some set of up to three of the ``lights`` explains, were it missing."""
        out, near = np.zeros(len(self.rho), bool), max(self.near, EXPLAINED * self.brightest)
        for count in range(1, 4):
            for off in combinations(range(len(lights)), count):
                out |= on_sphere(self.rho, without(self.F, lights, off))[1] < near
        return int((out & self.dim).sum())

    def shadowed(self) -> np.ndarray:
        """Pixels (H, W) that no set of the lights known so far explains, single ones left out."""
        image = np.zeros(self.usable.shape, bool)
        image[self.usable] = self.dim & (self.residual > self.near)
        return ndimage.binary_opening(image, np.ones((2, 2)))

    def add_all(self, candidates: list[Light]) -> None:
        """The clearest of the candidates, then what others still explain beside it, the clearest first."""
        self._add(candidates[0])
        for light in candidates[1:]:
            if self.complete() is not None or len(self.lights) == MOST_LIGHTS:
                break
            known = any(light.direction @ other.direction > 0.98 for other in self.lights)
            left = 0 if known else (self.shadowed()[self.usable] & (self._distance(light) < self.near)).sum()
            if left > 0.5 * light.support:
                self._add(light)

    def _distance(self, light: Light) -> np.ndarray:
        return on_sphere(self.rho, self.F - np.outer(light.colour, light.direction))[1]

    def _add(self, light: Light) -> None:
        self.lights = (*self.lights, light)
        newest = len(self.lights) - 1
        for more in range(3):
            for others in combinations(range(newest), more):
                _, distance = on_sphere(self.rho, without(self.F, self.lights, (*others, newest)))
                self.residual = np.minimum(self.residual, distance)

    def possible(self, both: np.ndarray) -> np.ndarray:
        """Whether each (b, a) of ``both`` (K, 6) may be a light, (K,).

        In front, no darkness, behind no pixel that sees all lights, and no more than the light that such pixels get.
        """
        b, a = both[:, :3], both[:, 3:]
        cosine = a @ self.lit_normals.T
        rest = np.min([self.lit_rho[c] - b[:, c, None] * cosine for c in range(3)], axis=0)
        bright = (a[:, 2] >= -0.02) & (b.min(axis=1) >= -0.1 * b.max(axis=1))
        behind = (cosine < -FAR_SIDE).mean(axis=1)
        too_much = (rest < -0.03 * self.brightest - WITHIN * self.noise).mean(axis=1)
        return bright & (behind <= FAR_SHARE) & (too_much < FAR_SHARE)  # type: ignore[no-any-return]

    def candidates(self, shadowed: np.ndarray) -> list[Light]:
        """Lights that explain many of the ``shadowed`` pixels as a surface, alone or beside one known; best first."""
        found: list[Light] = []
        for off in ((), *((j,) for j in range(len(self.lights)))):
            base = without(self.F, self.lights, off)
            if np.linalg.cond(base) < WORST_CONDITION:
                found += self._beside(base, shadowed)
            if any(light.curl < CURL and light.support > 0.1 * shadowed.sum() for light in found):
                break
        return sorted(found, key=lambda light: -light.support / (1 + (light.curl / CURL) ** 2))

    def _beside(self, base: np.ndarray, shadowed: np.ndarray) -> list[Light]:
        """Lights whose absence from the matrix ``base`` (3, 3) explains pixels of ``shadowed``."""
        index = self.number[shadowed]
        guesses = self._guesses(base, shadowed)
        if not len(guesses):
            return []
        sample = self.rho[self.random.choice(index, min(SAMPLE, len(index)), replace=False)]

        guesses = guesses[self.possible(guesses)]
        best_first = np.argsort(-light_fit.support(sample, base, guesses, 8 * self.near), kind="stable")
        starts = _distinct(guesses[best_first])[:REFINED]
        some = self.rho[self.random.choice(index, min(REFINE_SAMPLE, len(index)), replace=False)]
        few, least = some[:SAMPLE], max(LEAST_PIXELS, LEAST_SHARE * len(self.rho))

        def settled(start: np.ndarray) -> tuple[float, np.ndarray]:
            ends = np.array([refined(few, base, start, width * self.brightest, self.near) for width in COARSE])
            near = [(on_sphere(few, base - np.outer(end[:3], end[3:]))[1] < self.near).mean() for end in ends]
            return max(near), ends[int(np.argmax(near))]

        def lights(end: np.ndarray) -> list[Light]:
            end = refined(some, base, end, self.near, self.near, rounds=POLISHED)
            own = index[on_sphere(self.rho[index], base - np.outer(end[:3], end[3:]))[1] < self.near]
            if len(own) < least:
                return []
            partners = np.array([np.concatenate(fold) for fold in folds(base, end[:3], end[3:])])
            return [self._judged(base, own, both[:3], both[3:]) for both in partners[self.possible(partners)]]

        ends = [end for end in in_threads(settled, starts) if end[0] * len(index) > WORTH_POLISHING * least]
        ends.sort(key=lambda end: -end[0])
        most = MOST_CURL * (NOISY if self.noisy else 1.0)
        found = in_threads(lights, _distinct(np.array([end for _, end in ends]).reshape(-1, 6)))
        return [light for own in found for light in own if light.curl < most]

    def _judged(self, base: np.ndarray, own: np.ndarray, b: np.ndarray, a: np.ndarray) -> Light:
        n, _ = on_sphere(self.rho[own], base - np.outer(b, a))
        rows, columns = (index[own] for index in self.place)
        box = slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1)
        normals = np.zeros((box[0].stop - box[0].start, box[1].stop - box[1].start, 3))
        normals[rows - box[0].start, columns - box[1].start] = n
        ray = None if self.ray is None else self.ray[box]
        curl = relative_curl(of_relief(normals, ray), normals[..., 2] != 0, smooth=self.noisy)
        return Light(a, b, len(own), curl, float((n @ a < 0).mean()))

    def _guesses(self, base: np.ndarray, shadowed: np.ndarray) -> np.ndarray:
        """(b, a) (K, 6): the best few of each of some windows of shadowed pixels, refined to their window."""
        directions = fibonacci(COLOURS)
        colours = directions @ base.T
        real = colours.min(axis=1) > -0.1 * colours.max(axis=1)
        size = np.linalg.norm(colours[real], axis=1, keepdims=True)
        rows, columns = np.nonzero(shadowed)
        windows = []
        for k, pick in enumerate(self.random.choice(len(rows), min(WINDOWS, len(rows)), replace=False)):
            half = HALF_WIDTHS[k % len(HALF_WIDTHS)]
            around = np.s_[
                max(rows[pick] - half, 0) : rows[pick] + half + 1,
                max(columns[pick] - half, 0) : columns[pick] + half + 1,
            ]
            inside = self.number[around][shadowed[around]]
            if len(inside) >= FEWEST_IN_WINDOW:
                windows.append(inside)
        if not windows or not real.any():
            return np.empty((0, 6))
        counts = np.array([len(window) for window in windows])
        padded = np.zeros((len(windows), counts.max()), np.int64)
        for row, window in zip(padded, windows):
            row[: len(window)] = self.random.permutation(window)
        length = self.rho @ np.linalg.inv(base).T
        out = np.empty((len(windows), BEST_OF_WINDOW, 6))
        c, b = np.ascontiguousarray(directions[real] / size), np.ascontiguousarray(colours[real] / size)
        lit = self.lit_normals[:CHECKED]

        def scan(few: slice) -> None:
            light_fit.scan(padded[few], counts[few], length, self.rho, c, b, base, lit, FAR_SIDE, self.near, out[few])

        in_threads(scan, (slice(k, k + AT_ONCE) for k in range(0, len(windows), AT_ONCE)))
        return out.reshape(-1, 6)[np.isfinite(out[..., 0].ravel())]


def _distinct(both: np.ndarray) -> list[np.ndarray]:
    """Those of the (b, a) (K, 6) that are not nearly as one before."""
    kept: list[np.ndarray] = []
    for one in both:
        if not any(alike(one, other) for other in kept):
            kept.append(one)
    return kept


def relative_curl(normals: np.ndarray, region: np.ndarray, *, smooth: bool = False) -> float:
    """How far slopes are from closing around squares of 2×2 pixels, over how much they vary there: median.

    ``normals`` (H, W, 3) within ``region`` (H, W). 0 on a surface, about 0.4 on vectors that have nothing to do with
    one, 1 where the region holds too few squares. ``smooth``: of means over 3×3 pixels, against noise.
    """
    region = region & (normals[..., 2] > FLATTEST)
    n3 = np.where(region, normals[..., 2], 1.0)
    p, q = (np.where(region, -normals[..., i] / n3, 0.0) for i in (0, 1))
    if smooth:
        region = ndimage.binary_erosion(region, np.ones((3, 3)))
        p, q = ndimage.uniform_filter(p, 3), ndimage.uniform_filter(q, 3)
    whole = region[:-1, :-1] & region[:-1, 1:] & region[1:, :-1] & region[1:, 1:]
    if whole.sum() < FEWEST_FOR_CURL:
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
