"""Rotation matrices from vectors, and angles between rotations with and without the convex/concave ambiguity."""

import numpy as np
import pytest

from huesphere.recover.geometry.rotations import TWIN, rotation_angle, rotation_by, turn_between

VECTORS = np.random.default_rng(0).normal(size=(8, 3))


def test_a_quarter_turn_about_z_takes_x_to_y():
    assert rotation_by(np.array([0, 0, np.pi / 2])) @ [1.0, 0.0, 0.0] == pytest.approx([0.0, 1.0, 0.0], abs=1e-15)


@pytest.mark.parametrize("vector", VECTORS)
def test_a_small_rotation_is_the_cross_product(vector):
    n = np.array([0.3, -0.5, 0.8])
    small = 1e-6 * vector
    assert (rotation_by(small) @ n - n) / 1e-6 == pytest.approx(np.cross(vector, n), abs=1e-5)


@pytest.mark.parametrize("vector", VECTORS)
def test_the_angle_is_the_length_of_the_vector(vector):
    other = rotation_by(np.array([0.2, 0.7, -0.4]))
    length = np.linalg.norm(vector) % (2 * np.pi)
    assert rotation_angle(rotation_by(vector) @ other, other) == pytest.approx(min(length, 2 * np.pi - length))


def test_tiny_angles_are_told():
    """The arc cosine of the trace would give 0 or 2e-8 here."""
    assert rotation_angle(rotation_by(np.array([0, 3e-9, 0])), np.eye(3)) == pytest.approx(3e-9, rel=1e-6)


def test_the_other_solution_of_the_ambiguity_counts_as_the_same_and_a_reflection_does_not():
    a = rotation_by(VECTORS[0])
    assert turn_between(a, TWIN @ a) == pytest.approx(0, abs=1e-7)
    assert rotation_angle(a, TWIN @ a) == pytest.approx(np.pi)
    assert turn_between(a, -a) == np.pi
    assert turn_between(-a, -rotation_by(np.array([0.1, 0, 0])) @ a) == pytest.approx(0.1)
