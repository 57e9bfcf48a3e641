"""The symmetric root of C: definition, agreement with the matrix square root, and failure."""

import numpy as np
import pytest
from scipy.linalg import sqrtm

from huesphere.recover.geometry.root import roots, symmetric_root


def positive_definite(seed):
    A = np.random.default_rng(seed).normal(size=(3, 3))
    return A @ A.T + 0.01 * np.eye(3)


@pytest.mark.parametrize("seed", range(5))
def test_the_root_is_symmetric_positive_definite_and_squares_to_C(seed):
    C = positive_definite(seed)
    G = symmetric_root(C)
    assert pytest.approx(G.T) == G
    assert pytest.approx(C) == G.T @ G
    assert np.linalg.eigvalsh(G)[0] > 0
    assert pytest.approx(sqrtm(C).real) == G


def test_the_two_roots_differ_in_the_sign_of_the_determinant():
    plus, minus = roots(positive_definite(0))
    assert np.linalg.det(plus) > 0 > np.linalg.det(minus)
    assert minus.T @ minus == pytest.approx(plus.T @ plus)


def test_a_matrix_that_is_no_ellipsoid_is_refused():
    with pytest.raises(ValueError, match="positive definite"):
        symmetric_root(np.diag([1.0, 1.0, -0.1]))
