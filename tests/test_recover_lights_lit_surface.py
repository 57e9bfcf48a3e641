"""The lights of a noisy picture, found together with the surface."""

from functools import cache

import numpy as np
import pytest
from synthesis import angles_deg, problem_of_colours, solution_of
from test_recover_methods_initial import NOISE, TOWARD, seldom_all_lit

from huesphere.recover.lights.bundle_adjustment import LitBlocks
from huesphere.recover.lights.lit_surface import LitSurface, _clusters, _fewer, lit_surface
from huesphere.recover.lights.parameters import LIGHTS

OFF_DEG = 6.0  # that F is turned by, to begin with


def turned(F: np.ndarray, degrees: float) -> np.ndarray:
    """F (3, 3) of normals that come out turned by so much about an axis across the view."""
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return F @ np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])


@cache
def found() -> LitSurface:
    observation, _, all_lit, F = seldom_all_lit()
    problem = problem_of_colours(observation.rgb, observation.mask, NOISE)
    return lit_surface(problem, solution_of(turned(F, OFF_DEG), all_lit, OFF_DEG))


def test_the_lights_are_found_in_noise_and_undo_the_turn_of_what_was_known():
    _, normals, all_lit, F = seldom_all_lit()
    surface = found()
    cosine = TOWARD @ surface.toward.T
    assert np.degrees(np.arccos(np.clip(cosine.max(axis=1), -1, 1))).max() < 4.0  # every light that there is
    n = normals[all_lit]
    again = n @ F.T @ np.linalg.inv(surface.F).T
    assert np.median(angles_deg(again / np.linalg.norm(again, axis=1, keepdims=True), n)) < 1.0
    assert surface.explained > 0.9
    assert surface.loss < LIGHTS.believed_loss


def test_the_surface_is_right_where_no_light_is_seen_by_all():
    observation, normals, all_lit, _ = seldom_all_lit()
    others = observation.mask & ~all_lit
    assert np.median(angles_deg(found().normals[others], normals[others])) < 1.5
    assert np.isnan(found().normals[~observation.mask]).all()


def test_colours_come_in_the_units_of_the_picture():
    observation, _, all_lit, F = seldom_all_lit()
    dark = lit_surface(
        problem_of_colours(observation.rgb / 8, observation.mask, NOISE / 8),
        solution_of(turned(F, OFF_DEG) / 8, all_lit, OFF_DEG),
    )
    np.testing.assert_allclose(dark.F * 8, found().F, rtol=1e-6)
    np.testing.assert_allclose(dark.covariance * 64, found().covariance, rtol=1e-5)


def test_too_small_a_core_is_said_so():
    observation, _, all_lit, F = seldom_all_lit()
    problem = problem_of_colours(observation.rgb, observation.mask, NOISE)
    with pytest.raises(np.linalg.LinAlgError, match="no attempt"):
        lit_surface(problem, solution_of(F, np.zeros_like(all_lit)))


def test_lights_that_lie_on_one_another_are_merged_and_faint_ones_dropped():
    toward = np.array([[0.0, 0.0, 1.0], [np.sin(0.05), 0.0, np.cos(0.05)], [0.6, 0.0, 0.8], [0.0, 0.6, 0.8]])
    colour = np.array([[0.3, 0.1, 0.0], [0.1, 0.1, 0.0], [0.1, 0.2, 0.3], [1e-4, 0.0, 0.0]])
    fewer = _fewer(LitBlocks(np.zeros((1, 2)), toward, colour, 0.0), 8.0, 0.01)
    assert len(fewer.toward) == 2
    assert fewer.colour[0] == pytest.approx([0.4, 0.2, 0.0])
    assert angles_deg(fewer.toward[0], np.array([np.sin(1 / 60), 0.0, np.cos(1 / 60)])) < 0.01
    with pytest.raises(np.linalg.LinAlgError, match="no light"):
        _fewer(LitBlocks(np.zeros((1, 2)), toward, 0 * colour, 0.0), 8.0, 0.01)


def test_clusters_are_means_by_strength_the_strongest_first():
    grid = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, 1.0], [0.8, 0.0, 0.6]])
    grid /= np.linalg.norm(grid, axis=1, keepdims=True)
    clusters = _clusters(grid, np.array([1.0, 1.0, 0.5]), np.cos(np.radians(20)))
    middle = grid[0] + grid[1]
    assert clusters == pytest.approx(np.array([middle / np.linalg.norm(middle), grid[2]]))
