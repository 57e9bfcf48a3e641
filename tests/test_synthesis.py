"""The scenes that the tests of recovery are made of are what they claim to be."""

import numpy as np
import pytest
from synthesis import DIRECTIONS, cast_shadows, dome, light_colours


def test_the_domes_slopes_are_those_of_a_surface():
    from scipy.ndimage import binary_erosion

    normals, mask = dome(128, bumps=0.2, elongation=1.2, cap=0.7)
    p, q = -normals[..., 0] / normals[..., 2], -normals[..., 1] / normals[..., 2]
    p_y, q_x = -np.gradient(p, axis=0), np.gradient(q, axis=1)
    inside = binary_erosion(mask, iterations=2)
    assert np.abs(p_y - q_x)[inside].max() < 0.02 * np.abs(p_y)[inside].max()


def test_a_wall_shades_what_lies_behind_it_as_far_as_geometry_says():
    depth = np.zeros((40, 80))
    depth[:, 40] = 20.0  # a wall 20 high; light from the left at 45°
    hidden = cast_shadows(depth, np.ones_like(depth, bool), np.array([[-1.0, 0.0, 1.0]]) / np.sqrt(2))
    dark = np.flatnonzero(hidden[20, :, 0])
    assert dark.min() == 41
    assert dark.max() == pytest.approx(59, abs=1)


def test_light_colours_are_as_ill_conditioned_as_the_design_says():
    cond = np.linalg.cond(light_colours("natural").T @ DIRECTIONS)
    assert 95 <= cond <= 165  # measured with other placements and the same spectra
    assert np.linalg.cond(light_colours("gels").T @ DIRECTIONS) < 12
