"""The colour ellipsoid: design, least squares, LMS, scale, cut, confidence, bias; report 2.1–2.2."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from huesphere.recover.ellipsoid.fit import (
    design,
    determination,
    dispersion,
    fit_accepted,
    kappa,
    least_median_of_squares,
    least_squares,
    residuals,
    reweighted,
)
from huesphere.recover.geometry.quadratic import elements_of, matrix_of
from huesphere.recover.status import RecoveryFailure

F_TRUE = np.array([[0.50, 0.20, 0.70], [-0.30, 0.40, 0.60], [0.10, -0.45, 0.55]])
C_TRUE = np.linalg.inv(F_TRUE @ F_TRUE.T)


def colours(count: int, *, noise: float = 0.0, outliers: float = 0.0, seed: int = 0) -> np.ndarray:
    """Colours F n of random normals toward the camera; a share ``outliers`` of them misses the first light."""
    rng = np.random.default_rng(seed)
    n = rng.standard_normal((count, 3)) * [1, 1, 0.6]
    n[:, 2] = np.abs(n[:, 2])
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    rho = n @ F_TRUE.T
    far = np.arange(count) < outliers * count
    rho[far] -= np.outer(np.abs(n[far, 0]), [0.4, 0.25, 0.1])
    return rho + noise * rng.standard_normal(rho.shape)


def test_the_design_matrix_times_z_is_the_quadratic_form():  # Eq. (9)–(10)
    rho = colours(20)
    assert design(rho) @ elements_of(C_TRUE) == pytest.approx(np.einsum("ni,ij,nj->n", rho, C_TRUE, rho), rel=1e-12)
    assert matrix_of(elements_of(C_TRUE)) == pytest.approx(C_TRUE)


def test_least_squares_is_exact_without_noise():
    assert least_squares(colours(500)) == pytest.approx(C_TRUE, rel=1e-9)


def test_least_squares_equals_the_dense_solution():
    rho = colours(3000, noise=0.01)
    z = np.linalg.lstsq(design(rho), np.ones(len(rho)), rcond=None)[0]
    assert elements_of(least_squares(rho)) == pytest.approx(z, rel=1e-8)


def test_lms_is_exact_with_two_fifths_outliers():
    assert least_median_of_squares(colours(4000, outliers=0.4)) == pytest.approx(C_TRUE, rel=1e-7)


def lqs(rho: np.ndarray, samples: int = 3000) -> float:
    """The least median of r² among exact fits of random sixes, over all pixels: how MASS::lqs searches."""
    rng = np.random.default_rng(1)
    M = design(rho)
    sixes = np.stack([rng.choice(len(M), 6, replace=False, shuffle=False) for _ in range(samples)])
    z = np.linalg.solve(M[sixes], np.ones((samples, 6, 1)))[..., 0]
    h = len(M) // 2 + 3
    return min(float(np.partition((M @ fit - 1) ** 2, h)[h]) for fit in z)


@pytest.mark.parametrize("noise", [1e-3, 1e-2])
@pytest.mark.parametrize("outliers", [0.1, 0.4])
def test_lms_median_is_no_worse_than_the_search_of_lqs(noise, outliers):
    rho = colours(5000, noise=noise, outliers=outliers)
    h = len(rho) // 2 + 3
    ours = float(np.partition(residuals(rho, least_median_of_squares(rho)) ** 2, h)[h])
    assert ours <= lqs(rho)


def test_lms_does_not_depend_on_the_seed_beyond_its_noise():
    rho = colours(20_000, noise=2e-3, outliers=0.3)
    fits = [least_median_of_squares(rho, seed=seed) for seed in range(4)]
    spread = max(np.linalg.norm(a - fits[0]) for a in fits) / np.linalg.norm(fits[0])
    assert spread < 5e-3
    assert np.array_equal(fits[1], least_median_of_squares(rho, seed=1))


def test_s0_is_the_standard_deviation_of_gaussian_residuals():  # report 2.2
    r = np.random.default_rng(0).normal(0, 0.03, 100_000)
    assert dispersion(r) == pytest.approx(0.03, rel=0.01)


def test_s0_of_a_worked_case():  # f (1 + 5/(N − 6)) √med r², f = 1/Φ⁻¹(3/4) ≃ 1.4826
    r = np.arange(1.0, 12.0)  # N = 11: the 8-th least, h = 5 + 3
    assert dispersion(r) == pytest.approx(1 / norm.ppf(0.75) * (1 + 5 / 5) * 8.0)
    assert determination(r) == pytest.approx(1 - 64.0)


def test_the_cut_accepts_what_lies_within_two_and_a_half_s0():
    rho = colours(5000, noise=2e-3, outliers=0.3)
    C = least_median_of_squares(rho)
    fit = reweighted(rho, C)
    r = residuals(rho, C)
    assert np.array_equal(fit.accepted, np.abs(r) <= 2.5 * dispersion(r))
    assert fit.s0 == pytest.approx(dispersion(r))
    assert fit.r2 > 0.9999


def test_the_cut_is_no_lottery_where_colours_are_exact_to_single_precision():
    rho = colours(5000).astype(np.float32)
    for exposure in (1.0, 0.2, 3.7):
        changed = rho * np.float32(exposure)
        assert reweighted(changed, least_median_of_squares(changed)).accepted.all()


def test_kappa_is_the_squared_ratio_of_ellipsoids():  # report 4.2
    assert kappa(1.1 * colours(50), C_TRUE) == pytest.approx(1.21)


def test_confidence_limits_cover_the_truth_as_often_as_they_say():
    # Noise of r alone, as the limits assume: colours moved along the ray from black.
    covered = []
    for seed in range(60):
        rho = colours(400, seed=seed)
        rho *= np.sqrt(1 + 0.02 * np.random.default_rng(seed + 999).standard_normal((400, 1)))
        fit = fit_accepted(rho, np.ones(400, bool))
        truth = elements_of(C_TRUE)
        covered += [c["low"] <= t <= c["high"] for c, t in zip(fit.coefficients, truth)]
    assert np.mean(covered) == pytest.approx(0.95, abs=0.04)


def test_a_coefficient_carries_name_limits_and_t():
    fit = reweighted(colours(2000, noise=1e-3), C_TRUE)
    assert [c["name"] for c in fit.coefficients] == ["c11", "c22", "c33", "c12", "c13", "c23"]
    for c in fit.coefficients:
        assert c["low"] < c["value"] < c["high"]
        assert c["t"] == pytest.approx(c["value"] / c["stderr"])


def test_noise_bias_is_taken_out():
    rho = colours(200_000, noise=0.02)
    everything = np.ones(len(rho), bool)
    plain = fit_accepted(rho, everything).C
    corrected = fit_accepted(rho, everything, noise=0.02).C
    error = [np.linalg.norm(C - C_TRUE) / np.linalg.norm(C_TRUE) for C in (plain, corrected)]
    assert error[1] < 0.1 * error[0]


@settings(max_examples=25, deadline=None)
@given(
    exposure=st.floats(1e-4, 1e4),
    channels=st.permutations(range(3)),
    balance=st.tuples(*[st.floats(0.2, 5.0)] * 3),
    seed=st.integers(0, 10),
)
@example(exposure=1.0, channels=[0, 2, 1], balance=(4.5, 1.0, 3.0), seed=0)  # a six that the nudge left singular
def test_the_shell_does_not_change_with_exposure_units_channel_or_pixel_order(exposure, channels, balance, seed):
    rho = colours(1500, noise=1e-3, outliers=0.25)
    units = exposure * np.array(balance)
    order = np.random.default_rng(seed).permutation(len(rho))
    changed = (rho * units)[:, channels][order]
    a, b = reweighted(rho, least_median_of_squares(rho)), reweighted(changed, least_median_of_squares(changed))
    assert np.mean(b.accepted == a.accepted[order]) > 0.999
    back = np.diag(units[list(channels)])
    assert back @ b.C @ back == pytest.approx(a.C[np.ix_(channels, channels)], rel=2e-3, abs=2e-3 * np.abs(a.C).max())


def test_collinear_colours_are_rank_deficient():
    rho = np.outer(np.linspace(0.1, 1, 200), [0.5, 0.3, 0.2])
    with pytest.raises(RecoveryFailure, match="rank-deficient-colours"):
        least_median_of_squares(rho)


def test_a_hyperboloid_is_no_ellipsoid():
    t, phi = np.random.default_rng(0).uniform([0.2, 0], [1.2, 6.28], (500, 2)).T
    rho = np.stack([np.sinh(t) * np.cos(phi), np.sinh(t) * np.sin(phi), np.cosh(t)], axis=1)
    with pytest.raises(RecoveryFailure, match="no-ellipsoid"):
        least_squares(rho)


def test_a_flat_patch_of_eight_bits_is_refused_or_fitted_but_never_an_error():
    rng = np.random.default_rng(0)
    for seed in range(6):
        levels = np.array([0.5, 0.4, 0.3]) + rng.integers(0, 2 + seed % 3, (900, 3)) / 255
        try:
            C = least_median_of_squares(levels)
        except RecoveryFailure:
            continue
        assert np.linalg.eigvalsh(C)[0] > 0
