"""The noise of a picture: read from second differences, and as a camera reports it."""

import numpy as np
import pytest
from scipy import ndimage
from synthesis import dome, light_colours, shade

from huesphere.recover.pixels.noise import (
    LAPLACIAN,
    LOW_QUANTILE,
    PURE_NOISE,
    camera_noise,
    channel_noise,
    picture_noise,
)
from huesphere.render.dataset import CameraInfo


@pytest.mark.parametrize("sigma", [1e-3, 1e-2])
def test_noise_is_read_from_the_picture_of_a_surface(sigma):
    normals, mask = dome(128, bumps=0.2)
    observation, _ = shade(normals, mask, light_colours("gels"), noise=sigma)
    assert picture_noise(observation.rgb.astype(float), mask) == pytest.approx(sigma, rel=0.15)


@pytest.mark.parametrize("window", PURE_NOISE)
def test_the_table_is_what_pure_noise_gives_to_three_percent(window):
    grain = ndimage.convolve(np.random.default_rng(0).standard_normal((3, 600, 600)), LAPLACIAN[None])
    power = ndimage.uniform_filter((grain**2).mean(axis=0), window)
    assert np.sqrt(np.quantile(power, LOW_QUANTILE)) == pytest.approx(PURE_NOISE[window], rel=0.03)


def test_second_differences_keep_the_size_of_noise_and_no_plane():
    rng = np.random.default_rng(1)
    mask = np.ones((80, 80), bool)
    row, column = np.mgrid[:80, :80]
    plane = np.stack([0.01 * row + 0.02 * column] * 3, axis=-1)
    assert channel_noise(plane, mask) < 1e-12
    assert channel_noise(plane + 0.03 * rng.standard_normal(plane.shape), mask) == pytest.approx(0.03, rel=0.05)


def test_half_a_picture_of_texture_raises_the_noise_of_the_calm_tenth_little_and_that_of_all_pixels_much():
    rng = np.random.default_rng(2)
    rgb = 1e-3 * rng.standard_normal((100, 100, 3))
    rgb[:, 50:] += 0.1 * rng.standard_normal((100, 50, 3))
    mask = np.ones((100, 100), bool)
    assert picture_noise(rgb, mask) < 1.2e-3
    assert channel_noise(rgb, mask) > 3e-3


def test_a_picture_of_a_few_pixels_has_no_known_noise():
    few = np.zeros((20, 20), bool)
    few[8:12, 8:12] = True
    assert np.isnan(picture_noise(np.ones((20, 20, 3)), few))
    few[8:10] = False
    few[10:12, 8] = False
    assert channel_noise(np.ones((20, 20, 3)), few) == 0.0


def test_a_camera_s_variances_add_up():
    """Read noise, level over full well, and a twelfth of the squared step: worked by hand."""
    assert camera_noise(CameraInfo(read_noise=3e-3), 0.5) == pytest.approx(3e-3)
    assert camera_noise(CameraInfo(full_well=10_000), 0.25) == pytest.approx(np.sqrt(0.25 / 10_000))
    assert camera_noise(CameraInfo(bits=8), 0.5) == pytest.approx(1 / 255 / np.sqrt(12))
    both = camera_noise(CameraInfo(read_noise=3e-3, full_well=10_000), 0.25)
    assert both == pytest.approx(np.hypot(3e-3, np.sqrt(0.25 / 10_000)))
