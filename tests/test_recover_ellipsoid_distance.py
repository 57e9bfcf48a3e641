"""Distances to an ellipsoid, and their independent and spatially correlated parts."""

import numpy as np
import pytest
from scipy import ndimage

from huesphere.recover.ellipsoid.distance import residual_scales, signed_distance


def test_near_a_sphere_it_is_the_distance():
    n = np.random.default_rng(0).standard_normal((50, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    for size, off in ((2.0, 1e-4), (0.3, -1e-4)):
        assert signed_distance((size + off) * n, np.eye(3) / size**2) == pytest.approx(off, rel=1e-3)


def test_to_first_order_it_is_the_distance_along_the_surface_s_normal():
    axes = np.array([1.0, 0.4, 0.2])
    n = np.random.default_rng(1).standard_normal((50, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    on, across = n * axes, n / axes
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    for off in (1e-3, 1e-4):  # the error is of second order
        found = signed_distance(on + off * across, np.diag(axes**-2.0))
        assert found == pytest.approx(off, rel=30 * off)


def test_it_has_the_units_of_the_picture():
    rho, C = np.random.default_rng(2).uniform(0.2, 1.0, (20, 3)), np.diag([1.0, 2.0, 3.0])
    assert signed_distance(5 * rho, C / 25) == pytest.approx(5 * signed_distance(rho, C))


@pytest.mark.parametrize(("independent", "correlated"), [(1.0, 0.0), (0.2, 1.0), (1.0, 1.0)])
def test_noise_and_a_smooth_residual_are_told_apart(independent, correlated):
    rng = np.random.default_rng(3)
    smooth = ndimage.gaussian_filter(rng.standard_normal((300, 300)), 8)
    residual = independent * rng.standard_normal((300, 300)) + correlated * smooth / smooth.std()
    inlier = np.zeros((300, 300), bool)
    inlier[10:290, 20:280] = True
    white, shared = residual_scales(residual[inlier], inlier)
    assert white == pytest.approx(independent, rel=0.1)
    assert shared == pytest.approx(correlated, rel=0.15, abs=0.05)


def test_pixels_without_a_whole_window_have_one_scale():
    inlier = np.zeros((40, 40), bool)
    inlier[::3] = True
    white, shared = residual_scales(np.random.default_rng(4).standard_normal(int(inlier.sum())), inlier)
    assert white == pytest.approx(1.0, rel=0.15)
    assert shared == 0.0
