"""Refitting an ellipsoid to its own pixels: strips along terminators go, and the noise's bias with them."""

import numpy as np
import pytest
from scipy import ndimage
from synthesis import dome

from huesphere.recover.ellipsoid.fit import reweighted
from huesphere.recover.ellipsoid.parameters import ELLIPSOID
from huesphere.recover.ellipsoid.refit import refit_inliers
from huesphere.recover.parameters import overridden
from huesphere.recover.status import RecoveryFailure

F = np.array([[0.5, 0.2, 0.7], [-0.3, 0.4, 0.6], [0.1, -0.45, 0.55]])
TRUE = np.linalg.inv(F @ F.T)
NOISE = 3e-3


def picture(noise: float = NOISE) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(rgb, mask, all-lit) of a dome, a part of which loses a light gradually."""
    n, mask = dome(120)
    lost = np.maximum(0, n @ [0.8, 0.0, -0.6])[..., None] * [0.5, 0.3, 0.1]
    grain = noise * np.random.default_rng(0).standard_normal(n.shape)
    return np.where(mask[..., None], n @ F.T - lost + grain, 0), mask, mask & (lost[..., 0] == 0)


def error(C: np.ndarray) -> float:
    return float(np.linalg.norm(C - TRUE) / np.linalg.norm(TRUE))


def test_the_strip_along_a_terminator_is_rejected_where_a_cut_on_residuals_keeps_it():
    rgb, mask, all_lit = picture()
    found = refit_inliers(rgb, mask, 1.002 * TRUE)
    by_cut = np.zeros_like(mask)
    by_cut[mask] = reweighted(rgb[mask], TRUE).accepted
    outliers = mask & ~all_lit
    assert (found.inlier & outliers).sum() < 0.3 * (by_cut & outliers).sum()
    assert (found.inlier & all_lit).sum() > 0.9 * all_lit.sum()


def test_c_is_nearer_to_the_truth_than_that_of_the_cut_and_noise_is_read():
    rgb, mask, _ = picture(0.02)
    found = refit_inliers(rgb, mask, 1.002 * TRUE)
    assert found.unbiased
    assert error(found.fit.C) < 0.5 * error(reweighted(rgb[mask], TRUE).C)
    assert found.noise == pytest.approx(0.02, rel=0.1)
    assert found.correlated < found.noise


def test_it_converges_to_one_ellipsoid_from_starts_about_it():
    rgb, mask, _ = picture()
    one, other = (refit_inliers(rgb, mask, scale * TRUE).fit.C for scale in (0.998, 1.002))
    assert np.linalg.norm(one - other) < 0.01 * np.linalg.norm(one)


def test_an_error_of_the_model_is_a_correlated_residual():
    rgb, mask, _ = picture()
    smooth = ndimage.gaussian_filter(np.random.default_rng(1).standard_normal(mask.shape), 4)
    found = refit_inliers(rgb * (1 + 0.02 * smooth / smooth.std())[..., None], mask, TRUE)
    assert found.correlated > found.noise


def test_colours_on_no_ellipsoid_are_refused():
    rng = np.random.default_rng(2)
    mask = np.zeros((40, 40), bool)
    mask[15:22, 15:22] = True
    with pytest.raises(RecoveryFailure, match="no-dominant-shell"):
        refit_inliers(np.where(mask[..., None], rng.uniform(size=(40, 40, 3)), 0.0), mask, np.eye(3))


def test_a_wider_cut_accepts_more():
    rgb, mask, _ = picture()
    usual = refit_inliers(rgb, mask, TRUE).inlier.sum()
    with overridden(ELLIPSOID, window_mean_cut=1.5):
        assert refit_inliers(rgb, mask, TRUE).inlier.sum() < 0.95 * usual
