"""Spherical harmonics of irradiance: published constants, orthonormality, derivatives, and irradiance by quadrature."""

from math import pi

import numpy as np
import pytest

from huesphere.recover.geometry.harmonics import Harmonics, clamped_cosine
from huesphere.recover.geometry.sphere import fibonacci

ALL = (0, 1, 2, 4)


@pytest.mark.parametrize(
    ("degree", "value"),
    [(0, pi), (1, 2 * pi / 3), (2, pi / 4), (3, 0), (4, -pi / 24), (5, 0), (6, pi / 64)],
)
def test_clamped_cosine_is_as_published(degree, value):
    """Ramamoorthi and Hanrahan 2001, after Eq. (19)."""
    assert clamped_cosine(degree) == pytest.approx(value)


def test_harmonics_are_orthogonal_and_as_long_as_what_the_cosine_leaves():
    n = fibonacci(40_000)
    values, _ = Harmonics(ALL).at(n)
    gram = 4 * pi * values.T @ values / len(n)
    lengths = [clamped_cosine(degree) ** 2 for degree in ALL for _ in range(2 * degree + 1)]
    assert gram == pytest.approx(np.diag(lengths), abs=2e-3)


def test_gradients_are_those_of_the_values():
    n, step, harmonics = fibonacci(50), 1e-6, Harmonics(ALL)
    for axis in range(3):
        shift = step * np.eye(3)[axis]
        differences = (harmonics.at(n + shift)[0] - harmonics.at(n - shift)[0]) / (2 * step)
        assert harmonics.at(n)[1][..., axis] == pytest.approx(differences, abs=1e-7)


def test_irradiance_of_one_distant_light_is_nearly_a_sum_of_nine():
    """The clamped cosine in degrees 0, 1, 2 is off by at most 9 % of its maximum (Basri and Jacobs 2003)."""
    n = fibonacci(5000)
    values, _ = Harmonics((0, 1, 2)).at(n)
    cosine = np.maximum(n @ [0.6, 0.0, 0.8], 0)
    left = cosine - values @ np.linalg.lstsq(values, cosine, rcond=None)[0]
    assert np.sqrt(np.mean(left**2)) < 0.05
    assert np.abs(left).max() < 0.12
