"""The prior on the surface: noise falls where it is smooth, detail stays, and without noise nothing happens."""

import numpy as np
import pytest
from synthesis import joint_fit

from huesphere.recover.depth import smoothness_prior
from huesphere.recover.depth.joint_fit import fit_again
from huesphere.recover.depth.smoothness_prior import denoised
from huesphere.recover.geometry.slopes import normals_of_slopes

SIZE = 64
TOWARD = np.array([[0.5, 0.2, 1.0], [-0.5, 0.2, 1.0], [0.0, -0.5, 1.0]])
F = np.array([[1.0, 0.8, 0.7], [0.8, 1.0, 0.75], [0.75, 0.8, 1.0]]) @ TOWARD / 3


@pytest.fixture(scope="module")
def surface():
    """Depth smooth on the left and rough on the right: (mask, normals, which pixels are rough)."""
    x, y = np.meshgrid(np.linspace(-1, 1, SIZE + 1), np.linspace(1, -1, SIZE + 1))  # of the corners of pixels
    grain = np.random.default_rng(1).standard_normal(x.shape) * 0.4
    z = 20 * np.exp(-(x**2) - y**2) + np.where(x > 0.1, grain, 0.0)
    above, below = z[:-1], z[1:]
    p = (above[:, 1:] - above[:, :-1] + below[:, 1:] - below[:, :-1]) / 2
    q = (above[:, 1:] + above[:, :-1] - below[:, 1:] - below[:, :-1]) / 2
    n = np.stack([-p, -q, np.ones_like(p)], axis=-1)
    x, y = x[:-1, :-1], y[:-1, :-1]
    return x**2 + y**2 < 0.9, n / np.linalg.norm(n, axis=-1, keepdims=True), x > 0.05


def fitted(mask, normals, noise, extra=0.0, first=F):
    rgb = np.where(mask[..., None], normals @ F.T, 0.0)
    rgb += extra + noise * np.random.default_rng(0).standard_normal(rgb.shape)
    start = np.where(mask[..., None], normals, np.nan)
    return joint_fit(rgb, mask, start, first, noise)


def error_deg(found, normals, where):
    return np.degrees(2 * np.arcsin(np.linalg.norm(found[where] - normals[where], axis=-1) / 2))


def test_noise_falls_where_the_surface_is_smooth_and_detail_stays(surface):
    mask, normals, rough = surface
    fit = fitted(mask, normals, 3e-3)
    denoised_surface = denoised(fit)
    smooth = mask & (np.roll(rough, -4, axis=1) == 0)
    before, after = (error_deg(one.normals, normals, smooth).mean() for one in (fit, denoised_surface))
    assert after < 0.8 * before  # long waves of depth, and F, keep theirs
    before, after = (error_deg(one.normals, normals, mask & rough).mean() for one in (fit, denoised_surface))
    assert after < 1.02 * before


def test_the_scale_is_of_the_place(surface):
    mask, normals, rough = surface
    fit = fitted(mask, normals, 3e-3)
    beside = fit.cells.pairs[0]
    place = rough[mask][beside[:, 0]]
    scale = denoised(fit).scale[: len(beside)]
    assert np.median(scale[place]) > 5 * np.median(scale[~place])


def test_without_noise_nothing_moves(surface):
    mask, normals, _ = surface
    fit = fitted(mask, normals, 1e-6)
    moved = error_deg(denoised(fit).normals, fit.normals, mask)
    assert np.median(moved) < 0.01
    assert np.median(moved) < 0.2 * np.median(error_deg(fit.normals, normals, mask)) + 1e-3


def test_most_of_the_errors_are_within_what_is_stated(surface):
    mask, normals, _ = surface
    denoised_surface = denoised(fitted(mask, normals, 1e-3))
    within = error_deg(denoised_surface.normals, normals, mask) < 1.7 * denoised_surface.uncertainty_deg[mask]
    assert within.mean() > 0.7


def test_a_shadow_that_nobody_told_does_not_turn_the_matrix(surface):
    mask, normals, _ = surface
    shadow = np.zeros((SIZE, SIZE, 1))
    shadow[20:30, 20:34] = 1.0
    lost = shadow * (normals @ np.outer([0.05, 0.02, 0.02], TOWARD[0]).T)
    fit = fitted(mask, normals, 1e-3, -lost)
    assert not fit.explained[22:28, 22:32].any()
    assert fit.explained[mask].mean() > 0.8
    assert np.linalg.norm(fit.F - F) < 0.02 * np.linalg.norm(F)


def test_begun_anew_from_the_denoised_surface_the_matrix_is_found(surface):
    mask, normals, _ = surface
    tilt = np.radians(8.0)
    turn = np.array([[np.cos(tilt), 0, np.sin(tilt)], [0, 1, 0], [-np.sin(tilt), 0, np.cos(tilt)]])
    fit = fitted(mask, normals, 1e-3, first=F @ turn)
    again = fit_again(fit, denoised(fit).slope)
    before, after = (np.linalg.norm(one.F - F) / np.linalg.norm(F) for one in (fit, again))
    assert after < 2e-3
    assert after < 0.1 * before
    assert again.loss < 0.5 * fit.loss


def test_the_stated_error_of_a_normal_is_that_of_its_slopes():
    """E|v| of two equal independent Gaussians is √(π/4) of the root mean square of |v|, which holds for any others."""
    rng = np.random.default_rng(0)
    slope, ray = 0.8 * rng.standard_normal((6, 2)), 0.3 * rng.standard_normal((6, 2))
    half = 1e-3 * rng.standard_normal((6, 2, 2))
    moved = slope[:, None] + np.einsum("pij,pkj->pki", half, rng.standard_normal((6, 20_000, 2)))
    there = normals_of_slopes(moved.reshape(-1, 2), np.repeat(ray, 20_000, axis=0)).reshape(6, -1, 3)
    squares = ((there - normals_of_slopes(slope, ray)[:, None]) ** 2).sum(axis=-1).mean(axis=1)
    stated = smoothness_prior._expected_deg(slope, ray, half @ half.swapaxes(1, 2))
    np.testing.assert_allclose(stated, np.degrees(np.sqrt(np.pi / 4 * squares)), rtol=0.03)


def test_perturbations_of_the_slopes_equations_have_the_covariance_that_noise_of_the_picture_gives():
    W = np.repeat([[2.0, -0.8, 0.5]], 20_000, axis=0)
    pull = smoothness_prior._random_right_sides(W, np.random.default_rng(0))
    covariance = np.einsum("pik,pjk->ij", pull, pull) / (len(W) * pull.shape[2])
    np.testing.assert_allclose(covariance, [[2.0, -0.8], [-0.8, 0.5]], atol=0.03)


def test_errors_under_the_prior_are_as_large_as_stated_in_the_mean(surface):
    """Where detail is rough they are mostly those of single pixels; elsewhere that of F, common to all, is as large."""
    mask, normals, rough = surface
    found = denoised(fitted(mask, normals, 3e-3))
    for where, least, most in ((mask & rough, 1.1, 1.5), (mask & ~rough, 0.75, 1.45)):
        error = error_deg(found.normals, normals, where).mean()
        assert least < found.uncertainty_deg[where].mean() / error < most
