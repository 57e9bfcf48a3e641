"""The effective albedos by which interreflection moves colours off their ellipsoid."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from huesphere.recover.interreflection.albedo import fit_albedo

TRUE_F = np.array([[0.9, 0.2, 0.7], [0.1, 0.8, 0.6], [-0.3, 0.1, 0.9]])


def colours(alpha, seed=0, count=1500):
    """(picture, gathered light) (P, 3) of a surface of effective albedos ``alpha`` (3,); direct light is F n."""
    rng = np.random.default_rng(seed)
    n = rng.normal(size=(count, 3)) + np.array([0, 0, 2.0])
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    gathered = rng.uniform(0.0, 0.3, (count, 1)) * rng.uniform(0.5, 1.0, (count, 3))
    return n @ TRUE_F.T + np.asarray(alpha) * gathered, gathered


@given(st.lists(st.floats(0.05, 0.95), min_size=3, max_size=3), st.floats(0.01, 100.0))
@settings(max_examples=8, deadline=None)
def test_albedos_are_found_in_any_exposure(alpha, exposure):
    rgb, gathered = colours(alpha)
    fit = fit_albedo(exposure * rgb, exposure * gathered)
    assert fit.alpha == pytest.approx(alpha, abs=1e-4)
    assert fit.after < 1e-4 * fit.before
    true_C = np.linalg.inv(TRUE_F @ TRUE_F.T) / exposure**2
    assert pytest.approx(true_C, abs=1e-3 * np.abs(true_C).max()) == fit.C


def test_without_gathered_light_nothing_is_known_of_the_albedos():
    rgb, gathered = colours((0.5, 0.5, 0.5))
    fit = fit_albedo(rgb, 0 * gathered)
    assert (fit.alpha == 0).all()
    assert np.isinf(fit.stderr).all()
    assert fit.before == fit.after


def test_albedos_stay_between_nothing_and_all():
    rgb, gathered = colours((1.3, -0.2, 0.5))
    alpha = fit_albedo(rgb, gathered).alpha
    assert (alpha >= 0).all()
    assert (alpha <= 1).all()


def test_stated_errors_are_those_that_noise_makes_and_fall_as_it_does():
    alpha = np.array([0.7, 0.4, 0.6])
    stated = []
    for noise in (1e-3, 4e-3):
        errors = []
        for seed in range(6):
            rgb, gathered = colours(alpha, seed)
            fit = fit_albedo(rgb + noise * np.random.default_rng(seed + 1000).standard_normal(rgb.shape), gathered)
            errors.append((fit.alpha - alpha) / fit.stderr)
        assert 0.4 < np.std(errors) < 2.0
        stated.append(fit.stderr.mean())
    assert stated[1] / stated[0] == pytest.approx(4.0, rel=0.15)
