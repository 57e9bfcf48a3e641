"""Depth and F fitted together: derivatives, recovery of a perturbed F, its covariance, and robustness."""

import numpy as np
import pytest
from synthesis import joint_fit

from huesphere.recover.depth.joint_fit import Colours, Information
from huesphere.recover.geometry.slopes import normals_of_slopes

F = np.array([[0.5, 0.1, 0.35], [-0.3, 0.45, 0.4], [-0.1, -0.5, 0.45]])
SIZE = 40


def dome(size=SIZE):
    """(mask, normals) of a smooth surface whose normals are those of a depth at the corners of pixels."""
    x, y = np.meshgrid(np.linspace(-1, 1, size + 1), np.linspace(1, -1, size + 1))
    z = 0.35 * size * np.exp(-(x**2) - 0.8 * y**2) + 0.6 * np.sin(5 * x) * np.cos(4 * y)
    p = (z[:-1, 1:] - z[:-1, :-1] + z[1:, 1:] - z[1:, :-1]) / 2
    q = (z[:-1, 1:] + z[:-1, :-1] - z[1:, 1:] - z[1:, :-1]) / 2
    n = np.stack([-p, -q, np.ones_like(p)], axis=-1)
    return (x**2 + y**2)[:-1, :-1] < 0.9, n / np.linalg.norm(n, axis=-1, keepdims=True)


def fitted(noise, first=F, seed=0, spoiled=None):
    mask, normals = dome()
    rgb = np.where(mask[..., None], normals @ F.T, 0.0)
    rgb = rgb + noise * np.random.default_rng(seed).standard_normal(rgb.shape)
    if spoiled is not None:
        rgb[spoiled] *= 0.7
    start = np.where(mask[..., None], normals, np.nan)
    return joint_fit(rgb, mask, start, first, noise)


@pytest.mark.parametrize("weights", ["cauchy", "geman-mcclure"])
@pytest.mark.parametrize("perspective", [False, True])
def test_the_right_sides_are_half_the_gradient_of_the_loss(weights, perspective):
    rng = np.random.default_rng(0)
    P = 12
    slope, ray = rng.normal(size=(P, 2)), (0.3 if perspective else 0.0) * rng.normal(size=(P, 2))
    lost = 0.05 * rng.normal(size=(P, 3, 3))
    rho = np.einsum("pij,pj->pi", F - lost, normals_of_slopes(slope, ray)) + 0.3 * rng.normal(size=(P, 3))
    A = rng.normal(size=(P, 3, 3))
    colours = Colours(20 * rho, 20 * lost, 0.1 * np.eye(3) + A @ A.swapaxes(1, 2), ray)
    information = Information(P)
    assert information.at(colours, slope, 20 * F, weights) == pytest.approx(colours.loss(slope, 20 * F, weights))
    step = 1e-5
    for cell, axis in ((0, 0), (5, 1)):
        move = np.zeros_like(slope)
        move[cell, axis] = step
        gradient = (
            (colours.loss(slope + move, 20 * F, weights) - colours.loss(slope - move, 20 * F, weights)) / step / 2
        )
        assert -2 * information.g[cell, axis] == pytest.approx(gradient, rel=1e-4)
    for k in (0, 4, 8):
        move = step * np.eye(9)[k].reshape(3, 3)
        gradient = (
            (colours.loss(slope, 20 * F + move, weights) - colours.loss(slope, 20 * F - move, weights)) / step / 2
        )
        assert -2 * information.h[k] == pytest.approx(gradient, rel=1e-4)


def test_a_wrong_first_matrix_is_corrected():
    first = F * 1.01
    fit = fitted(1e-3, first)
    assert np.linalg.norm(fit.F - F) < 0.2 * np.linalg.norm(first - F)
    assert np.allclose(fit.F, fit.scaled * fit.noise)


def test_the_covariance_of_the_matrix_covers_its_errors():
    """Mahalanobis distances of nine unknowns: 9 on average, or less, for two covariances are added up."""
    squared = []
    for seed in range(6):
        fit = fitted(2e-3, seed=seed)
        error = ((fit.F - F) / fit.noise).ravel()
        squared.append(error @ np.linalg.pinv(fit.covariance, rcond=1e-10, hermitian=True) @ error)
    assert 0.5 < np.mean(squared) < 14


def test_the_residual_of_noise_is_as_expected_and_all_pixels_are_explained():
    fit = fitted(1e-3)
    mask, _ = dome()
    # Two of three channels are left when one depth a pixel is fitted: the median of |e| is that of χ with two.
    assert np.nanmedian(fit.misfit) == pytest.approx(np.sqrt(2 * np.log(2)), rel=0.08)
    assert fit.explained[mask].mean() > 0.97
    assert np.isnan(fit.normals[~mask]).all()


def test_pixels_that_another_light_darkens_are_left_out_and_do_not_move_the_matrix():
    mask, _ = dome()
    spoiled = np.zeros_like(mask)
    spoiled[14:20, 16:24] = True
    fit = fitted(1e-3, spoiled=spoiled)
    assert fit.explained[spoiled].mean() < 0.1
    assert np.linalg.norm(fit.F - F) < 0.01 * np.linalg.norm(F)
