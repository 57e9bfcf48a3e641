"""Whether a residual is a function of the normal: it is under wide lights, and not by noise or by place."""

import numpy as np
import pytest
from scipy import ndimage
from synthesis import dome

from huesphere.recover.ellipsoid.lack_of_fit import lack_of_fit
from huesphere.recover.ellipsoid.parameters import ELLIPSOID
from huesphere.recover.parameters import overridden

F = np.array([[0.50, 0.20, 0.70], [-0.30, 0.40, 0.60], [0.10, -0.45, 0.55]])
C = np.linalg.inv(F @ F.T)
NORMALS, MASK = dome(128, elongation=1.2, bumps=0.2, cap=0.8)


def colours(residual: np.ndarray, noise: float = 1e-4) -> np.ndarray:
    """Picture of a dome whose colours are a share ``residual`` (H, W) off the ellipsoid, with noise."""
    rgb = (NORMALS @ F.T) * (1 + residual)[..., None]
    return rgb + noise * np.random.default_rng(0).standard_normal(rgb.shape)


def of_normal() -> np.ndarray:
    """Half a percent of the colour, of degree 2 in the normal, but no ellipsoid's (which are all of degree 2 in ρ)."""
    return 0.005 * (NORMALS[..., 0] ** 2 - NORMALS[..., 1] ** 2) * NORMALS[..., 2] ** 2


def of_place() -> np.ndarray:
    smooth = ndimage.gaussian_filter(np.random.default_rng(1).standard_normal(MASK.shape), 3)
    return 0.005 * smooth / smooth.std()


def test_a_residual_that_depends_on_the_normal_is_significant():
    found = lack_of_fit(colours(of_normal()), MASK, C)
    assert found.significant
    assert found.share > 0.9


def test_noise_is_not():
    found = lack_of_fit(colours(np.zeros(MASK.shape), noise=3e-3), MASK, C)
    assert not found.significant
    assert found.amount < 0.2 * found.noise


def test_a_residual_of_the_place_is_not():
    found = lack_of_fit(colours(of_place()), MASK, C)
    assert not found.significant
    assert found.share < 0.4


def test_a_residual_well_below_the_noise_is_not():
    assert not lack_of_fit(colours(0.1 * of_normal(), noise=3e-3), MASK, C).significant


def test_it_depends_on_no_exposure_and_no_rotation_of_the_normals():
    one = lack_of_fit(colours(of_normal()), MASK, C)
    other = lack_of_fit(7 * colours(of_normal()), MASK, C / 49)
    assert (other.share, other.amount, other.noise) == pytest.approx((one.share, one.amount, one.noise), rel=1e-6)
    turn = np.linalg.qr(np.random.default_rng(2).standard_normal((3, 3)))[0]
    turned = lack_of_fit(colours(of_normal()) @ turn.T, MASK, turn @ C @ turn.T)
    assert turned.share == pytest.approx(one.share, rel=1e-6)  # C^½ρ are the normals in another frame


def test_thresholds_are_read_when_it_is_asked():
    found = lack_of_fit(colours(of_normal()), MASK, C)
    with overridden(ELLIPSOID, least_explained_share=1.1):
        assert not found.significant
    assert found.significant
