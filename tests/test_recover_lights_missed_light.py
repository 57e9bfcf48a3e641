"""Sums that the fits of one missed light share, against the matrices that they stand for."""

import numpy as np

from huesphere.recover.lights.missed_light import add_equation, cofactors, matrix_without


def test_the_matrix_without_a_light_lacks_its_outer_product():
    rng = np.random.default_rng(0)
    base, both, M = rng.normal(size=(3, 3)), rng.normal(size=6), np.empty((3, 3))
    matrix_without(base, both, M)
    assert np.allclose(M, base - np.outer(both[:3], both[3:]), rtol=1e-14)


def test_cofactors_are_the_inverse_times_the_determinant_and_stay_finite_where_there_is_no_inverse():
    rng = np.random.default_rng(1)
    M, K = rng.normal(size=(3, 3)), np.empty((3, 3))
    cofactors(M, K)
    assert np.allclose(K, np.linalg.det(M) * np.linalg.inv(M).T, rtol=1e-12)
    M[2] = M[0] - 2 * M[1]
    cofactors(M, K)
    across = np.array([1.0, -2.0, -1.0])  # of the plane of all M n
    assert np.linalg.matrix_rank(K, tol=1e-12) == 1
    assert np.allclose(np.cross(K @ rng.normal(size=3), across), 0, atol=1e-12)


def test_added_equations_are_the_weighted_normal_equations():
    rng = np.random.default_rng(2)
    J, r, weight = rng.normal(size=(20, 6)), rng.normal(size=20), rng.random(20)
    H, g = np.zeros((6, 6)), np.zeros(6)
    for row in range(20):
        add_equation(H, g, J[row], r[row], weight[row])
    assert np.allclose(np.tril(H), np.tril(J.T @ (weight[:, None] * J)))
    assert np.allclose(g, J.T @ (weight * r))
    assert not np.triu(H, 1).any()
