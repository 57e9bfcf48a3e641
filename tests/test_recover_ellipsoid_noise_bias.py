"""Noise's bias of the normal equations: its expectation is subtracted, whatever the colours and the covariance."""

import numpy as np
import pytest

from huesphere.recover.ellipsoid.noise_bias import without_noise
from huesphere.recover.geometry.quadratic import design

V = np.array([[1.0, 0.3, 0.0], [0.3, 2.0, -0.4], [0.0, -0.4, 0.5]])


def test_expected_sums_of_pure_noise_vanish_once_corrected():
    rng = np.random.default_rng(0)
    y = rng.multivariate_normal(np.zeros(3), V, 400_000)
    M = design(y)
    gram, right = without_noise(M.T @ M, M.sum(axis=0), len(y), V)
    assert np.abs(gram / len(y)).max() < 0.02 * np.abs(M.T @ M / len(y)).max()
    assert np.abs(right / len(y)).max() < 0.02


def test_of_noisy_colours_the_sums_without_noise_are_left():
    rng = np.random.default_rng(1)
    clean = rng.uniform(-2, 2, (40, 3))
    copies = 20_000
    noisy = design(np.repeat(clean, copies, axis=0) + rng.multivariate_normal(np.zeros(3), V, 40 * copies))
    truth = design(clean)
    gram, right = without_noise(noisy.T @ noisy / copies, noisy.sum(axis=0) / copies, len(clean), V)
    biased = np.linalg.norm(noisy.T @ noisy / copies - truth.T @ truth)
    assert np.linalg.norm(gram - truth.T @ truth) < 0.02 * biased
    assert np.linalg.norm(right - truth.sum(axis=0)) < 0.02 * np.linalg.norm(noisy.sum(axis=0) / copies - right)


def test_in_one_channel_it_is_the_moments_of_a_gaussian():
    """E y² = x² + v and E y⁴ = x⁴ + 6 x² v + 3 v²: worked by hand."""
    x, v = 3.0, 0.5
    gram, right = np.zeros((6, 6)), np.zeros(6)
    gram[0, 0], right[0] = x**4 + 6 * x**2 * v + 3 * v**2, x**2 + v
    clean_gram, clean_right = without_noise(gram, right, 1, np.diag([v, 0.0, 0.0]))
    assert clean_gram[0, 0] == pytest.approx(x**4)
    assert clean_right[0] == pytest.approx(x**2)


def test_without_noise_nothing_is_subtracted():
    M = design(np.random.default_rng(2).uniform(size=(10, 3)))
    gram, right = without_noise(M.T @ M, M.sum(axis=0), 10, np.zeros((3, 3)))
    assert np.array_equal(gram, M.T @ M)
    assert np.array_equal(right, M.sum(axis=0))
