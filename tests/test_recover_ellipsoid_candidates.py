"""The ellipsoid of few pixels: found among others, refitted without bias, and judged by integrability."""

from dataclasses import replace

import numpy as np
import pytest
from synthesis import angles_deg, dome, shade

from huesphere.recover.cues.linear_integrability import judge_integrability
from huesphere.recover.cues.silhouette import silhouette_of
from huesphere.recover.ellipsoid.candidates import (
    Candidate,
    bias_terms,
    credit_of,
    grow_candidates,
    refine,
    working_grid,
)
from huesphere.recover.ellipsoid.distance import signed_distance
from huesphere.recover.ellipsoid.fit import least_median_of_squares
from huesphere.recover.ellipsoid.noise_bias import without_noise
from huesphere.recover.ellipsoid.region_growing import box_sums
from huesphere.recover.ellipsoid.selection import Grid, most_likely_first
from huesphere.recover.geometry.root import symmetric_root
from huesphere.recover.methods.table import METHODS
from huesphere.recover.problem import Problem

ROBUST = METHODS["robust"]
COLOURS = np.array([[1.0, 0.1, 0.1], [0.1, 0.9, 0.1], [0.2, 0.1, 0.8], [0.7, 0.6, 0.1]])
WIDE = np.array([[2.0, 0, 1], [-1.0, 1.7, 1], [-1.0, -1.7, 1], [1.7, 1.3, 1]])
WIDE /= np.linalg.norm(WIDE, axis=1, keepdims=True)


def problem_of(rgb: np.ndarray, usable: np.ndarray, noise: float) -> Problem:
    """The picture in parallel projection, all of whose object is usable."""
    return Problem(rgb.astype(float), usable, usable, np.zeros_like(usable), None, noise, np.zeros(rgb.shape))


@pytest.fixture(scope="module")
def wide():
    """(observation, normals, all-lit pixels, true C): a dome under four lights 63–65° off axis, 0.3 % noise."""
    normals, mask = dome(112, elongation=1.1, bumps=0.15, cap=0.95)
    observation, F = shade(normals, mask, COLOURS, directions=WIDE, noise=3e-3)
    return observation, normals, (normals @ WIDE.T > 0).all(axis=-1) & mask, np.linalg.inv(F @ F.T)


def aligned_error(C: np.ndarray, observation, normals: np.ndarray, where: np.ndarray) -> float:
    n = observation.rgb[where].astype(float) @ symmetric_root(C)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    U, _, Vt = np.linalg.svd(n.T @ normals[where])
    return float(np.median(angles_deg(n @ (U @ Vt), normals[where])))


def test_the_ellipsoid_is_found_where_fewer_than_half_the_pixels_are_on_it(wide):
    observation, normals, all_lit, C_true = wide
    rgb, mask = observation.rgb.astype(float), observation.mask
    assert all_lit.sum() < 0.4 * mask.sum()
    found = grow_candidates(problem_of(rgb, mask, 3e-3))[0]
    best = aligned_error(C_true, observation, normals, all_lit)
    assert aligned_error(found.C, observation, normals, all_lit) < 1.2 * best + 0.2
    assert aligned_error(least_median_of_squares(rgb[mask]), observation, normals, all_lit) > 3.0
    assert (found.inlier & ~all_lit).sum() < 0.2 * found.inlier.sum()


def test_refining_the_true_ellipsoid_leaves_it_true(wide):
    observation, _, all_lit, C_true = wide
    C, inlier = refine(problem_of(observation.rgb, observation.mask, 3e-3), C_true)
    assert np.linalg.norm(C - C_true) < 0.05 * np.linalg.norm(C_true)
    assert (inlier & all_lit).sum() > 0.7 * all_lit.sum()


def test_candidates_do_not_depend_on_exposure_or_channel_order(wide):
    observation, _, _, _ = wide
    rgb, mask = observation.rgb.astype(float), observation.mask
    order = [2, 0, 1]
    a = grow_candidates(problem_of(rgb, mask, 3e-3))[0].C
    b = grow_candidates(problem_of(7.0 * rgb[..., order], mask, 7.0 * 3e-3))[0].C * 49.0
    assert b == pytest.approx(a[np.ix_(order, order)], rel=1e-3, abs=1e-3 * np.abs(a).max())


def test_a_blend_is_judged_worse_than_the_true_ellipsoid(wide):
    observation, _, all_lit, C_true = wide
    rgb, mask = observation.rgb.astype(float), observation.mask
    true = judge_integrability(rgb, all_lit, C_true, noise=3e-3)
    blend = judge_integrability(rgb, mask, least_median_of_squares(rgb[mask]), noise=3e-3)
    assert true.frontal
    assert true.curl < 0.15
    assert blend.curl > 2 * true.curl or not blend.frontal


def test_an_ellipsoid_of_few_lights_that_much_of_the_picture_outshines_is_credited_less(wide):
    observation, normals, all_lit, C_true = wide
    rgb, mask = observation.rgb.astype(float), observation.mask
    lit = normals @ WIDE.T > 0
    exposure = np.linalg.norm(rgb[all_lit].mean(axis=0)) / np.linalg.norm(
        (normals[all_lit] @ WIDE.T @ COLOURS).mean(axis=0)
    )
    few = exposure * COLOURS[[0, 1, 3]].T @ WIDE[[0, 1, 3]]
    own = lit[..., [0, 1, 3]].all(axis=-1) & ~lit[..., 2] & mask
    assert np.abs(signed_distance(rgb[own], np.linalg.inv(few @ few.T))).mean() < 5e-3  # a true ellipsoid as well

    def share_left(C, inlier):
        alone = credit_of(problem_of(rgb, inlier, 3e-3), inlier, C)
        return credit_of(problem_of(rgb, mask, 3e-3), inlier, C) / alone

    assert share_left(C_true, all_lit) > 1 / 1.5
    assert share_left(np.linalg.inv(few @ few.T), own) < 1 / 1.5


def test_of_two_true_ellipsoids_the_one_that_the_silhouette_supports_is_taken():
    """Pixels that miss just the light from the right lie on a true ellipsoid too: let it score more in all else."""
    normals, mask = dome(112, elongation=1.1, bumps=0.15, cap=0.95)
    directions = np.array([[1.8, 0, 1], [-1.7, 0.2, 1], [0.1, 0.6, 1], [-0.2, -0.6, 1]])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    observation, F = shade(normals, mask, COLOURS, directions=directions, noise=3e-3)
    lit = normals @ directions.T > 0
    candidates = []
    exposure = np.linalg.norm(F) / np.linalg.norm(COLOURS.T @ directions)
    for score, seen, M in (
        (0.2, lit.all(axis=-1), F),
        (0.3, lit[..., 1:].all(axis=-1) & ~lit[..., 0], F - exposure * np.outer(COLOURS[0], directions[0])),
    ):
        inlier, C = seen & mask, np.linalg.inv(M @ M.T)
        support = float(inlier.sum() / mask.sum())
        candidates.append(Candidate(C, inlier, support, score / support))
    all_lit, runner_up = candidates
    grid = Grid(problem_of(observation.rgb, mask, 3e-3), 0.0, silhouette_of(mask, mask))
    assert most_likely_first(grid, [runner_up, all_lit])[0][0].C is all_lit.C


def test_bias_as_numbers_is_the_bias_as_formula():
    rng = np.random.default_rng(1)
    colours, A = rng.uniform(0.2, 1.0, (40, 3)), rng.standard_normal((3, 3))
    V = 1e-3 * A @ A.T
    x, y, z = colours.T
    M = np.stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z], axis=-1)
    gram, right = M.T @ M, M.sum(axis=0)
    terms = bias_terms(V)
    expected = without_noise(gram, right, len(M), V)
    assert gram + np.einsum("a,aij->ij", right, terms[:6]) + len(M) * terms[6] == pytest.approx(expected[0])
    assert right + len(M) * terms[7, 0] == pytest.approx(expected[1])


def test_a_flat_part_of_a_noise_free_picture_breaks_nothing():
    """Normal equations of a patch of one colour, which LAPACK may give up as singular: they propose no ellipsoid."""
    normals, mask = dome(112, elongation=1.1, bumps=0.15, cap=0.95)
    observation, _ = shade(normals, mask, COLOURS, directions=WIDE, noise=1e-4)
    rgb = observation.rgb.astype(float)
    rgb[30:70, 30:70] = [0.347, 0.8, 0.6]
    assert grow_candidates(problem_of(rgb, mask, 1e-4))


def test_box_sums_are_those_of_a_convolution():
    image = np.random.default_rng(0).uniform(size=(9, 14))
    out = np.empty_like(image)
    box_sums(image, 2, out)
    padded = np.pad(image, 2)
    direct = [[padded[i : i + 5, j : j + 5].sum() for j in range(14)] for i in range(9)]
    assert out == pytest.approx(np.array(direct))


def test_large_pictures_are_searched_on_block_means():
    rgb, usable = np.ones((300, 302, 3)), np.ones((300, 302), bool)
    usable[0, 0] = False
    small, block = working_grid(problem_of(rgb, usable, 0.02))
    assert (block, small.rgb.shape, small.usable.sum()) == (2, (150, 151, 3), 150 * 151 - 1)
    assert small.noise == pytest.approx(0.01)
    once = problem_of(rgb[:50, :50], usable[:50, :50], 0.02)
    assert working_grid(once)[1] == 1
    assert working_grid(once)[0].rgb is once.rgb


def test_robust_gives_normals_where_the_report_is_lost(wide):
    observation, _, all_lit, C_true = wide
    estimate = ROBUST(observation)
    C = estimate.solution.C
    assert np.linalg.norm(C - C_true) < 0.05 * np.linalg.norm(C_true)
    assert (estimate.inlier & ~all_lit).sum() < 0.2 * estimate.inlier.sum()


def test_robust_says_so_when_the_rotation_is_left_open():
    """Few pixels see every light: either the normals are right, or the status is not ok."""
    normals, mask = dome(96, bumps=0.1, cap=0.95)
    directions = WIDE * [1.6, 1.6, 1.0]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    observation, _ = shade(normals, mask, COLOURS, directions=directions, noise=5e-3)
    estimate = ROBUST(replace(observation))
    right = estimate.valid.any() and np.median(angles_deg(estimate.normals, normals)[estimate.valid]) < 10
    assert right or estimate.status != "ok"
