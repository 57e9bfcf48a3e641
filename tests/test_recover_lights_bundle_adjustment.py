"""Distant lights and the surface that they light, fitted together to blocks of pixels."""

import numpy as np
import pytest
from synthesis import angles_deg, problem_of_colours
from test_recover_methods_initial import COLOURS, NOISE, TOWARD, seldom_all_lit

from huesphere.recover.geometry.slopes import normals_by_slopes, normals_of_slopes
from huesphere.recover.geometry.sphere import across, fibonacci
from huesphere.recover.lights.bundle_adjustment import Bundle, F_by_lights, LitBlocks, prior_on_F


def true_blocks(bundle):
    """The blocks of the dome under its true lights."""
    observation, normals, _, _ = seldom_all_lit()
    n = type(bundle.cells)(np.where(observation.mask[..., None], normals, 0.0), observation.mask, bundle.block).mean
    return LitBlocks(-n[:, :2] / np.maximum(n[:, 2:], 0.1), TOWARD, COLOURS * exposure() / bundle.brightest, np.inf)


def exposure():
    """By which the picture's colours are those of the lights."""
    _, _, _, F = seldom_all_lit()
    return float(np.mean(F / (COLOURS.T @ TOWARD)))


def bundle_of(blocks=600):
    observation, _, all_lit, _ = seldom_all_lit()
    return Bundle(problem_of_colours(observation.rgb, observation.mask, NOISE), all_lit, blocks)


def test_derivatives_are_those_of_the_colours():
    rng = np.random.default_rng(0)
    toward, colour = fibonacci(40)[:3], rng.uniform(0.1, 1.0, (3, 3))

    def F_of(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return (b.T @ (a / np.linalg.norm(a, axis=1, keepdims=True))).ravel()

    change, step = F_by_lights(LitBlocks(np.zeros((1, 2)), toward, colour, 0.0)), 1e-6
    for k in range(3):
        for channel in range(3):
            more = colour.copy()
            more[k, channel] += step
            np.testing.assert_allclose(
                (F_of(toward, more) - F_of(toward, colour)) / step, change[3 * k + channel], atol=1e-6
            )
        for i in range(2):
            moved = toward.copy()
            moved[k] += step * across(toward)[i][k]
            np.testing.assert_allclose(
                (F_of(moved, colour) - F_of(toward, colour)) / step, change[9 + 2 * k + i], atol=1e-5
            )
    slope, ray = rng.normal(size=(20, 2)), 0.2 * rng.normal(size=(20, 2))
    for i in range(2):
        there = normals_of_slopes(slope + step * np.eye(2)[i], ray)
        np.testing.assert_allclose(
            (there - normals_of_slopes(slope, ray)) / step, normals_by_slopes(slope, ray)[..., i], atol=1e-5
        )


def test_the_prior_on_F_weighs_turns_and_stretches_apart():
    rng = np.random.default_rng(0)
    F, turn = rng.normal(size=(3, 3)), np.diag([1e-3, 2e-3, 4e-3])
    known = prior_on_F(F, turn, 0.05)
    omega = np.array([0.3, -0.2, 0.5])
    by_turn = -F @ np.cross(np.eye(3), omega)  # F (𝟙 − [ω]×), for [ω]× v = ω × v
    assert by_turn.ravel() @ known.precision @ by_turn.ravel() == pytest.approx(omega @ np.linalg.solve(turn, omega))
    stretch = np.array([[0.1, 0.2, 0.0], [0.2, -0.1, 0.3], [0.0, 0.3, 0.4]])
    longer = (F @ stretch).ravel()
    assert longer @ known.precision @ longer == pytest.approx((stretch**2).sum() / 0.05**2)


def test_each_step_of_the_fit_leaves_less():
    observation, _, all_lit, _ = seldom_all_lit()
    bundle = Bundle(problem_of_colours(observation.rgb, observation.mask, NOISE), all_lit, 600)
    n = bundle.cells.smoothed(bundle.cells.mean, 1.0)  # any start of the right shape
    start = LitBlocks(-0.1 * n[:, :2], TOWARD, COLOURS / observation.rgb.max(), np.inf)
    losses = [bundle.fit(start, 0.1, 1e-2, steps, core_sees_all=True).loss for steps in (1, 3, 9)]
    assert losses[0] > losses[1] > losses[2]


def test_the_true_surface_under_the_true_lights_leaves_little_more_than_noise():
    bundle = bundle_of(2500)
    residual = bundle.residual(true_blocks(bundle))[bundle.trusted]
    assert np.median(np.linalg.norm(residual, axis=1)) < 6e-3


def test_the_fit_brings_lights_back_that_were_turned_and_dimmed():
    bundle = bundle_of()
    true = true_blocks(bundle)
    toward = true.toward + 0.06 * np.random.default_rng(0).standard_normal(true.toward.shape)
    start = LitBlocks(true.slope, toward / np.linalg.norm(toward, axis=1, keepdims=True), 0.9 * true.colour, np.inf)
    end = bundle.fit(start, 0.05, 5e-3, 25, core_sees_all=True)
    before, after = (angles_deg(lit.toward, TOWARD) for lit in (start, end))
    assert np.median(after) < 0.5 * np.median(before)
    assert np.linalg.norm(end.F - true.F) < 0.3 * np.linalg.norm(start.F - true.F)
    assert np.allclose(np.linalg.norm(end.toward, axis=1), 1)


def test_blocks_near_the_silhouette_and_unseen_ones_are_not_trusted():
    bundle = bundle_of()
    assert 0 < bundle.trusted.mean() < 1
    assert bundle.trust[bundle.trusted].min() == 1
    assert bundle.trust[~bundle.trusted].max() < 1e-3
    observation, _, all_lit, _ = seldom_all_lit()
    problem = problem_of_colours(observation.rgb, observation.mask, NOISE)
    half = problem.usable & (np.arange(problem.mask.shape[1]) < problem.mask.shape[1] // 2)
    unseen = Bundle(type(problem)(**{**vars(problem), "usable": half}), all_lit, 600)
    assert unseen.trusted.sum() < 0.7 * bundle.trusted.sum()


def test_the_covariance_grows_as_the_square_of_the_noise():
    bundle = bundle_of()
    end = bundle.fit(true_blocks(bundle), 0.03, 3e-3, 10, core_sees_all=False)
    once, twice = (
        np.trace(bundle.covariance(end, sigma)[: end.colour.size, : end.colour.size]) for sigma in (3e-3, 6e-3)
    )
    assert 2 < twice / once < 8
