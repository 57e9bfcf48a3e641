"""Residuals and normal equations over all pixels: as the dense design matrix gives them, in both versions."""

import numpy as np
import pytest

from huesphere.recover.ellipsoid import normal_equations as passes
from huesphere.recover.ellipsoid.normal_equations import normal_equations, residuals
from huesphere.recover.geometry.quadratic import design, elements_of

C = np.array([[2.0, 0.3, -0.2], [0.3, 1.5, 0.1], [-0.2, 0.1, 3.0]])
T = np.array([[1.0, 0.2, 0.0], [0.2, 2.0, -0.3], [0.0, -0.3, 0.7]])


def colours(count: int, kind: type = np.float64) -> np.ndarray:
    return np.ascontiguousarray(np.random.default_rng(0).uniform(0.0, 1.0, (count, 3)), kind)


def test_residuals_are_the_quadratic_form_less_one():  # Eq. (10)
    rho = colours(10_000)  # more than two blocks
    assert residuals(rho, C) == pytest.approx(design(rho) @ elements_of(C) - 1, rel=1e-12, abs=1e-12)


def test_sums_are_those_of_the_dense_design_matrix_over_the_kept_pixels():  # Eq. (9)
    rho = colours(10_000)
    keep = np.arange(len(rho)) % 3 > 0
    M = design(rho[keep] @ T.T)
    gram, right = normal_equations(rho, T, keep)
    assert gram == pytest.approx(M.T @ M, rel=1e-12)
    assert right == pytest.approx(M.sum(axis=0), rel=1e-12)


def test_without_pixels_the_sums_are_zero():
    gram, right = normal_equations(colours(10), T, np.zeros(10, bool))
    assert not gram.any()
    assert not right.any()


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_the_compiled_version_equals_the_readable_one(monkeypatch, kind):
    rho = colours(3000, kind)
    keep = np.arange(len(rho)) % 3 > 0
    readable = residuals(rho, C), *normal_equations(rho, T, keep)
    monkeypatch.setattr(passes, "COMPILED_FROM", 0)
    compiled = residuals(rho, C), *normal_equations(rho, T, keep)
    for a, b in zip(readable, compiled):
        assert b == pytest.approx(a, rel=1e-10, abs=1e-12)
