"""Form factors as dot products (report 2.5) against closed forms from Howell's catalogue, and their limits."""

import numpy as np
import pytest

from huesphere.eval.studies.form_factor import Patch, above_horizon, dot_product_vector, form_factor


def test_a_rectangle_above_one_of_its_corners_is_that_of_the_catalogue():
    # Howell's B-3: element parallel to a rectangle a × b at distance c, below one corner.
    a, b, c = 1.2, 0.7, 0.9
    X, Y = a / c, b / c
    known = (
        X / np.sqrt(1 + X**2) * np.arctan(Y / np.sqrt(1 + X**2))
        + Y / np.sqrt(1 + Y**2) * np.arctan(X / np.sqrt(1 + Y**2))
    ) / (2 * np.pi)
    patch = Patch(np.array([0.0, 0.0, c]), np.array([0.0, b, 0.0]), np.array([a, 0.0, 0.0]))  # u × v points down
    up = np.array([0.0, 0.0, 1.0])
    assert dot_product_vector(patch) @ up == pytest.approx(known, rel=1e-12)
    assert form_factor(patch, up) == pytest.approx(known, rel=1e-5)


def test_a_patch_as_large_as_the_sky_fills_it():
    wide = Patch(np.array([-1e4, -1e4, 1.0]), np.array([0.0, 2e4, 0.0]), np.array([2e4, 0.0, 0.0]))
    assert dot_product_vector(wide) @ [0, 0, 1] == pytest.approx(1.0, abs=1e-6)


def test_a_patch_that_turns_its_back_sends_nothing_by_integration():
    away = Patch(np.array([-0.5, -0.5, 1.0]), np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))  # u × v points up
    assert form_factor(away, np.array([0.0, 0.0, 1.0])) == 0


def test_below_the_horizon_the_dot_product_falls_short():
    patch = Patch(np.array([-0.5, -0.5, 1.0]), np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0]))
    tilted = np.array([np.sin(1.3), 0.0, np.cos(1.3)])
    assert not above_horizon(patch, tilted)
    assert dot_product_vector(patch) @ tilted < form_factor(patch, tilted) - 1e-3
