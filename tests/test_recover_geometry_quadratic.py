"""The quadratic form as six numbers: Eqs. (9) and (10)."""

import numpy as np
import pytest

from huesphere.recover.geometry.quadratic import FACTOR, MONOMIALS, PRODUCTS, design, elements_of, matrix_of

RNG = np.random.default_rng(0)


def test_the_design_matrix_times_the_elements_is_the_quadratic_form():
    A, rgb = RNG.normal(size=(3, 3)), RNG.normal(size=(20, 3))
    C = A @ A.T
    assert design(rgb) @ elements_of(C) == pytest.approx(np.einsum("ni,ij,nj->n", rgb, C, rgb))


def test_elements_and_matrix_are_each_others_inverse():
    z = RNG.normal(size=(4, 6))
    assert elements_of(matrix_of(z)) == pytest.approx(z)
    assert matrix_of(z) == pytest.approx(matrix_of(z).swapaxes(1, 2))


def test_the_fifteen_moments_make_up_the_normal_matrix():
    """PRODUCTS says which of fifteen sums of four colours each entry of MᵀM is: equal entries have equal numbers."""
    rgb = RNG.normal(size=(50, 3))
    gram = design(rgb).T @ design(rgb) / np.outer(FACTOR, FACTOR)
    assert (PRODUCTS == PRODUCTS.T).all()
    assert set(PRODUCTS.ravel()) == set(range(15))
    for number in range(15):
        equal = gram[number == PRODUCTS]
        assert equal == pytest.approx(equal[0])
    assert len(MONOMIALS) == len(FACTOR) == 6
