"""Candidates for the ellipsoid of the pixels that see every light, when these may be as few as a tenth of the object.

Pixels that miss a light lie on ellipsoids of their own, and global fits blend them. Small patches of the picture mostly
do not straddle two ellipsoids. So every small patch proposes one, and the best proposals grow to all pixels that lie on
them (``recover.ellipsoid.region_growing``). Each grown candidate has a score: its support, the share of the pixels that
lie on it, times its credit, how much its normals are those of a surface that faces the camera
(``recover.cues.linear_integrability``) and how well it explains its own and all pixels.
"""

from dataclasses import dataclass

import numpy as np

from huesphere.recover.cues.linear_integrability import judge_integrability
from huesphere.recover.ellipsoid.distance import signed_distance
from huesphere.recover.ellipsoid.fit import determination, whitening
from huesphere.recover.ellipsoid.noise_bias import without_noise
from huesphere.recover.ellipsoid.normal_equations import residuals
from huesphere.recover.ellipsoid.parameters import ELLIPSOID
from huesphere.recover.ellipsoid.region_growing import box_sums, grow, growth_settings
from huesphere.recover.geometry.blocks import block_means, whole_blocks
from huesphere.recover.geometry.quadratic import FACTOR, MONOMIALS, PRODUCTS, matrix_of
from huesphere.recover.geometry.threads import in_threads
from huesphere.recover.problem import Problem
from huesphere.recover.status import RecoveryFailure

# How many candidates with the most pixels go on to each step (candidates (refitted, then judged)).
CANDIDATES_KEPT = (30, 20)

# Candidates that differ by more than this are clearly two: the margin of the choice is that of the first candidate over
# the best of these (largest |eigenvalue - 1| of one C relative to the other).
DIFFERENT_ELLIPSOID = 0.4

# Candidates that differ by less than this are one candidate (largest |eigenvalue - 1| of one C relative to the other).
SAME_ELLIPSOID = 0.03

# At most SEEDS_PER_PLACE seeds are taken from patches whose centres are nearer to each other than this (times
# patch_spacing_px).
SEED_SEPARATION = 1.5

SEED_COUNT = 40  # Proposals that are grown.

# Half-width at which patches are spaced twice as far as patch_spacing_px (pixels at an object area of
# REFERENCE_AREA_PX).
PATCH_SPACING_DOUBLING_PX = 30.0

# The surface of a patch whose ellipsoid is longer than this allows curves too little to determine one (least over
# largest eigenvalue of C in whitened colours).
PATCH_AXIS_RATIO = 5e-4

PATCH_USABLE_SHARE = 0.7  # A patch proposes an ellipsoid only if a larger share of its pixels is usable.

REFERENCE_AREA_PX = 11_000  # object area for which sizes of patches are stated; they scale with the root of the area
LEAST_HALF_WIDTH, LEAST_SPACING = 3, 2  # pixels: least sizes of patches on small objects
SEEDS_PER_PLACE = 2  # seeds from patches that are neighbours: one ellipsoid on either side of an edge
RANKED_PIXELS = 1000  # pixels on which proposals are ranked: size of the work


@dataclass(frozen=True)
class Candidate:
    """One candidate ellipsoid ρᵀCρ = 1, in picture units, on the grid on which it was found."""

    C: np.ndarray  # (3, 3)
    inlier: np.ndarray  # (h, w) bool, the pixels that lie on it
    support: float  # share of the usable pixels that lie on it
    credit: float  # 0 … 1, how much its normals are those of a surface that faces the camera

    @property
    def score(self) -> float:
        """Support times credit: what candidates are sorted by."""
        return self.support * self.credit


def bias_terms(V: np.ndarray) -> np.ndarray:
    """What noise of covariance V (3, 3) adds to normal equations, negated, (8, 6, 6): for compiled code.

    The unbiased MᵀM is MᵀM + Σ_a right_a · terms[a] + count · terms[6], and the unbiased Mᵀ1 is
    Mᵀ1 + count · terms[7, 0], with right = Mᵀ1 of ``count`` pixels. The same result as
    ``recover.ellipsoid.noise_bias.without_noise``, which is linear in right and count.
    """
    zero, units = np.zeros((6, 6)), np.eye(6)
    constant, right = without_noise(zero, np.zeros(6), 1, V)
    linear = [without_noise(zero, unit, 1, V)[0] - constant for unit in units]
    last = zero.copy()
    last[0] = right
    return np.stack([*linear, constant, last])


def working_grid(problem: Problem) -> tuple[Problem, int]:
    """(the picture as means over square blocks, side of a block in pixels), small enough to search; or as it is, and 1.

    The pixels of the grid, usable and object alike, are the blocks that are wholly usable. A mean has less noise than a
    pixel, by the side of the block.
    """
    rgb, usable = problem.rgb, problem.usable
    block = max(1, round(np.sqrt(usable.sum() / ELLIPSOID.working_area_px)))
    if block > 1:
        usable = whole_blocks(usable, block)
        rgb = np.where(usable[..., None], block_means(rgb, block), 0.0)
    ray, noise = None if problem.ray is None else block_means(problem.ray, block), problem.noise / block
    grid = Problem(rgb, usable, usable, np.zeros_like(usable), ray, noise, removed=np.zeros_like(rgb))
    return grid, block


def clear_margin(candidates: list[Candidate]) -> float:
    """Score of the first candidate over that of the best clearly different one; inf if there is none."""
    first, *rest = candidates
    others = [c.score for c in rest if ellipsoid_difference(first.C, c.C) > DIFFERENT_ELLIPSOID]
    return first.score / max(max(others), 1e-300) if others else float("inf")


def grow_candidates(problem: Problem, *, extra: list[np.ndarray] | None = None) -> list[Candidate]:
    """Every candidate that grows in the picture, the one with the highest score first.

    ``extra``: ellipsoids C (3, 3) from elsewhere, picture units, which are grown as well. Raises RecoveryFailure:
    no-dominant-shell where no patch proposes an ellipsoid, rank-deficient-colours.
    """
    usable = problem.usable
    white = _whitened(problem)
    T = white.T
    C, boxes = _seeds(white, usable)
    if extra:
        inverse = np.linalg.inv(T)
        C = np.concatenate([C, [inverse.T @ E @ inverse for E in extra]])
        boxes = np.concatenate([boxes, _whole_picture(usable, len(extra))])
    if not len(C):
        raise RecoveryFailure("no-dominant-shell", "no patch of the picture lies on an ellipsoid")
    refitted, judged = CANDIDATES_KEPT
    inliers = _grow(white, usable, C, boxes, reaches=ELLIPSOID.growth_reaches_px)
    C = C[_distinct(C, inliers, refitted)]
    inliers = _grow(white, usable, C, _whole_picture(usable, len(C)), final_cuts=ELLIPSOID.final_mean_cuts)
    total = usable.sum()

    def judge(k: int) -> Candidate:
        own, inlier = T.T @ C[k] @ T, inliers[k].astype(bool)
        return Candidate(own, inlier, float(inlier.sum() / total), credit_of(problem, inlier, own))

    return sorted(in_threads(judge, _distinct(C, inliers, judged)), key=lambda candidate: -candidate.score)


def _whole_picture(usable: np.ndarray, count: int) -> np.ndarray:
    """(count, 4): boxes (row, row end, column, column end) that each hold the whole picture."""
    return np.tile([0, usable.shape[0], 0, usable.shape[1]], (count, 1))


def _distinct(C: np.ndarray, inliers: np.ndarray, most: int) -> list[int]:
    """Indices of at most ``most`` candidates with the most pixels, without copies of a larger one and failed ones."""
    kept: list[int] = []
    for k in np.argsort(-inliers.sum(axis=(1, 2), dtype=np.int64), kind="stable"):
        if np.isfinite(C[k]).all() and all(ellipsoid_difference(C[k], C[other]) > SAME_ELLIPSOID for other in kept):
            kept.append(int(k))
            if len(kept) == most:
                break
    return kept


def credit_of(problem: Problem, inlier: np.ndarray, C: np.ndarray) -> float:
    """The credit 0 … 1 of the ellipsoid C (3, 3), picture units, by its pixels ``inlier`` (h, w).

    It is a product of factors 1 / (1 + (value / halving)²), and of ``not_frontal_credit`` where no rotation makes the
    normals face the camera. The values are: curl, normalised curl and off-axis angle of the normals; scatter, the
    excess over 1 of the root mean square distance of the inliers in units of the noise; 1 − R² with the robust R² of
    the report's 4.2 over all usable pixels; and the residual r of the outermost usable pixels. Pixels that miss some of
    the lights of the right ellipsoid lie inside it, most of them not far from it. So an ellipsoid from which half of
    the pixels are far, or outside which some are, is probably that of pixels that see few lights.
    """
    judgement = judge_integrability(problem.rgb, inlier, C, noise=problem.noise, ray=problem.ray)
    distance = signed_distance(problem.rgb[inlier], C) / max(problem.noise, 1e-300)
    distance = np.clip(distance, -ELLIPSOID.growing_distance_cut, ELLIPSOID.growing_distance_cut)
    r = residuals(problem.rgb[problem.usable], C)
    outside = float(np.quantile(r, ELLIPSOID.outside_quantile))
    credit = 1 / (1 + (judgement.curl / ELLIPSOID.curl_halving_credit) ** 2)
    credit = credit / (1 + (judgement.normalised_curl / ELLIPSOID.normalised_curl_halving_credit) ** 2)
    credit /= 1 + (judgement.off_axis_deg / ELLIPSOID.off_axis_halving_credit_deg) ** 2
    credit /= 1 + (max(0.0, float(np.sqrt(np.mean(distance**2))) - 1) / ELLIPSOID.scatter_halving_credit) ** 2
    credit /= 1 + ((1 - determination(r)) / ELLIPSOID.unexplained_halving_credit) ** 2
    credit /= 1 + (max(0.0, outside) / ELLIPSOID.outside_halving_credit) ** 2
    return credit * (1.0 if judgement.frontal else ELLIPSOID.not_frontal_credit)


def refine(problem: Problem, C: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(C (3, 3), its pixels (H, W)): C refitted in rounds to those of the usable pixels that lie on it, picture units.

    The rounds are those that a candidate ends with; here they serve the picture at its full size as well. Raises
    RecoveryFailure: no-dominant-shell where no pixels are left.
    """
    usable = problem.usable
    white = _whitened(problem)
    inverse = np.linalg.inv(white.T)
    own = np.ascontiguousarray((inverse.T @ C @ inverse)[None])
    inliers = _grow(white, usable, own, _whole_picture(usable, 1), final_cuts=ELLIPSOID.final_mean_cuts)
    if not np.isfinite(own).all():
        raise RecoveryFailure(
            "no-dominant-shell", "the ellipsoid found on block means has no pixels in the whole picture"
        )
    return white.T.T @ own[0] @ white.T, inliers[0].astype(bool)


def ellipsoid_difference(A: np.ndarray, B: np.ndarray) -> float:
    """max |eig(A⁻¹B) − 1|: relative difference of ρᵀAρ and ρᵀBρ in the direction in which it is largest."""
    from scipy.linalg import eigh

    return float(np.abs(eigh(B, A, eigvals_only=True) - 1).max())


@dataclass(frozen=True)
class _White:
    """Colours of the picture whitened to second moments 𝟙, and the noise in them."""

    rgb: np.ndarray  # (h, w, 3), 0 where not usable
    T: np.ndarray  # (3, 3) from the picture's colours to the whitened ones
    V: np.ndarray  # (3, 3) covariance of the noise of the whitened colours
    bias: np.ndarray  # (8, 6, 6), of ``bias_terms``


def _whitened(problem: Problem) -> _White:
    """The whitened picture."""
    T = whitening(problem.rgb[problem.usable])
    V = problem.noise**2 * (T @ T.T)
    return _White(np.where(problem.usable[..., None], problem.rgb @ T.T, 0.0), T, V, bias_terms(V))


def _grow(
    white: _White,
    usable: np.ndarray,
    C: np.ndarray,
    boxes: np.ndarray,
    *,
    reaches: tuple[int, ...] = (),
    final_cuts: tuple[float, ...] = (),
) -> np.ndarray:
    """Pixels (K, h, w) uint8 of the ellipsoids C (K, 3, 3), changed in place, that grow from ``boxes`` (K, 4)."""
    settings = growth_settings()
    weight = np.empty(usable.shape)
    box_sums(usable.astype(float), ELLIPSOID.averaging_window_px // 2, weight)
    inliers = np.zeros((len(C), *usable.shape), np.uint8)
    flags, steps, cuts = usable.astype(np.uint8), np.array(reaches, np.int64), np.array(final_cuts, np.float64)

    def one(k: int) -> None:
        grow(white.rgb, flags, weight, white.V, white.bias, boxes[k], C[k], steps, cuts, settings, inliers[k])

    in_threads(one, range(len(C)))
    return inliers


def _seeds(white: _White, usable: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(C (K, 3, 3), boxes (K, 4)) of the patches whose ellipsoids lie nearest to most of the picture."""
    scale = np.sqrt(usable.sum() / REFERENCE_AREA_PX)
    sums = _tables(white.rgb, usable)
    z_all, box_all = [], []
    for half in ELLIPSOID.patch_half_widths_px:
        half = max(LEAST_HALF_WIDTH, round(half * scale))
        spacing = ELLIPSOID.patch_spacing_px * scale * (1 + half / (PATCH_SPACING_DOUBLING_PX * scale))
        z, box = _fit_boxes(sums, half, max(LEAST_SPACING, round(spacing)), white)
        z_all.append(z)
        box_all.append(box)
    z, box = np.concatenate(z_all), np.concatenate(box_all)
    if not len(z):
        return np.empty((0, 3, 3)), box
    rows, columns = np.nonzero(usable)
    some = np.random.default_rng(0).choice(len(rows), min(RANKED_PIXELS, len(rows)), replace=False)
    cost = _cost(white.rgb[rows[some], columns[some]], z, white.V)
    chosen: list[int] = []
    middle = (box[:, :2].sum(axis=1) / 2, box[:, 2:].sum(axis=1) / 2)
    near = (SEED_SEPARATION * ELLIPSOID.patch_spacing_px * scale) ** 2
    for k in np.argsort(cost, kind="stable"):
        close = sum((middle[0][k] - middle[0][c]) ** 2 + (middle[1][k] - middle[1][c]) ** 2 < near for c in chosen)
        if close < SEEDS_PER_PLACE:
            chosen.append(int(k))
        if len(chosen) == SEED_COUNT:
            break
    return np.ascontiguousarray(matrix_of(z[chosen])), box[chosen]


def _tables(white: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Summed-area tables (22, h + 1, w + 1): count, 6 products of two colours, 15 of four (as ``quartic_sums``)."""
    x, y, z = np.moveaxis(white, -1, 0)
    two = [x * x, y * y, z * z, x * y, x * z, y * z]
    xx, yy, zz, xy, xz, yz = two
    four = [xx * xx, yy * yy, zz * zz, xx * xy, xx * xz, xy * yy, yy * yz, xz * zz, yz * zz]
    four += [xx * yy, xx * zz, yy * zz, xx * yz, xy * yz, xy * zz]
    tables = np.zeros((22, white.shape[0] + 1, white.shape[1] + 1))
    tables[:, 1:, 1:] = np.stack([usable.astype(float), *two, *four]).cumsum(axis=1).cumsum(axis=2)
    return tables


def _patch_sums(sums: np.ndarray, half: int, step: int) -> tuple[np.ndarray, np.ndarray]:
    """(sums (K, 22), boxes (K, 4)) of the square patches of half-width ``half`` that are usable for the most part."""
    height, width = sums.shape[1] - 1, sums.shape[2] - 1
    centres = np.meshgrid(np.arange(half // 2, height, step), np.arange(half // 2, width, step), indexing="ij")
    r, c = centres[0].ravel(), centres[1].ravel()
    box = np.stack([(r - half).clip(0), (r + half).clip(0, height), (c - half).clip(0), (c + half).clip(0, width)], -1)
    total = sums[:, box[:, 1], box[:, 3]] - sums[:, box[:, 0], box[:, 3]]
    total = (total - sums[:, box[:, 1], box[:, 2]] + sums[:, box[:, 0], box[:, 2]]).T
    full = total[:, 0] > PATCH_USABLE_SHARE * 4 * half * half
    return total[full], box[full]


def _fit_boxes(sums: np.ndarray, half: int, step: int, white: _White) -> tuple[np.ndarray, np.ndarray]:
    """(z (K, 6), boxes (K, 4)) of the square patches whose colours lie on an ellipsoid to within noise. Eq. (10)"""
    total, box = _patch_sums(sums, half, step)
    count, second, fourth = total[:, 0], total[:, 1:7], total[:, 7:]
    gram = FACTOR[:, None] * FACTOR * fourth[:, PRODUCTS]
    right = FACTOR * second
    V, bias = white.V, white.bias
    clean = gram + np.einsum("ka,aij->kij", right, bias[:6]) + count[:, None, None] * bias[6]
    clean_right = right + count[:, None] * bias[7, 0]
    sound = np.isfinite(clean).all(axis=(1, 2)) & np.isfinite(clean_right).all(axis=1)
    if not sound.all():  # the noise of a picture of a few pixels is not known
        return np.empty((0, 6)), box[:0]
    if not len(clean):
        return np.empty((0, 6)), box
    definite = np.linalg.eigvalsh(clean)[:, 0] > 1e-12 * np.trace(clean, axis1=1, axis2=2)
    ridge = 1e-12 * np.trace(gram, axis1=1, axis2=2)[:, None, None] + 1e-300  # a patch of one colour has no inverse
    clean = np.where(definite[:, None, None], clean, gram + ridge * np.eye(6))
    clean_right = np.where(definite[:, None], clean_right, right)
    z = np.linalg.solve(clean, clean_right[..., None])[..., 0]
    C = matrix_of(z)
    eigenvalues = np.linalg.eigvalsh(C)
    # Sum of r² against what noise makes of it, 4 tr(CVC S) with S the second moments: both from the same sums.
    squared = np.einsum("ki,kij,kj->k", z, gram, z) - 2 * np.einsum("ki,ki->k", z, right) + count
    expected = 4 * np.einsum("kij,jl,klm,kmi->k", C, V, C, matrix_of(second))
    good = eigenvalues[:, 0] > PATCH_AXIS_RATIO * eigenvalues[:, 2]
    good &= squared < ELLIPSOID.patch_residual_cut**2 * expected
    return z[good], box[good]


def _cost(colours: np.ndarray, z: np.ndarray, V: np.ndarray) -> np.ndarray:
    """Mean of min(1, (d / cut)²) over the whitened colours (n, 3) for each ellipsoid z (K, 6), (K,).

    d is the distance in standard deviations of the noise of covariance V (3, 3).
    """
    rows, columns = zip(*MONOMIALS)
    M = colours[:, rows] * colours[:, columns] * FACTOR
    C = matrix_of(z)
    slope = np.einsum("kij,jl,klm->kim", C, V, C)[:, rows, columns]
    with np.errstate(invalid="ignore", divide="ignore"):
        squared = (M @ z.T - 1) ** 2 / (4 * (M @ slope.T))
    return np.minimum(1.0, np.nan_to_num(squared, nan=np.inf) / ELLIPSOID.proposal_distance_cut**2).mean(axis=0)
