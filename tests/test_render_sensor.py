"""The camera: noise of its stated size and kind, clipping, quantisation, black level, display encoding."""

import numpy as np
import pytest

from huesphere.configs.schema import Camera
from huesphere.render.sensor import camera_info, expose, exposure_gain
from huesphere.scenes.encoding import encode_srgb

GREY = np.full((64, 64, 3), 0.25)


def test_an_ideal_camera_changes_nothing():
    assert (expose(GREY * 5, Camera()) == np.float32(1.25)).all()


def test_read_noise_has_its_standard_deviation():
    assert expose(GREY, Camera(read_noise=0.01)).std() == pytest.approx(0.01, rel=0.03)


def test_photon_noise_grows_with_the_square_root_of_light():
    spread = [expose(level * GREY, Camera(full_well=10_000)).std() for level in (0.5, 2)]
    assert spread[0] == pytest.approx(np.sqrt(0.125 / 10_000), rel=0.03)
    assert spread[1] / spread[0] == pytest.approx(2, rel=0.04)


def test_noise_follows_its_seed():
    first, again, other = (expose(GREY, Camera(read_noise=0.01, seed=s)) for s in (1, 1, 2))
    assert (first == again).all()
    assert (first != other).any()


def test_bits_give_that_many_levels():
    ramp = np.linspace(0, 1, 4096).reshape(1, -1, 1) * np.ones(3)
    assert len(np.unique(expose(ramp, Camera(bits=4)))) == 16


def test_a_black_level_keeps_noise_below_black():
    dark = np.zeros((64, 64, 3))
    clipped = expose(dark, Camera(bits=12, read_noise=0.01))
    kept = expose(dark, Camera(bits=12, read_noise=0.01, black_level=0.1))
    assert clipped.mean() > 0.003  # half of the noise is cut off
    assert abs(kept.mean()) < 3e-4
    assert kept.min() < -0.02


def test_display_encoding_is_srgb_in_eight_bits():
    # IEC 61966-2-1: linear 0.2140 is half of the display range.
    assert encode_srgb(np.array(0.21404)) == pytest.approx(0.5, abs=1e-4)
    seen = expose(GREY, Camera(encoding="srgb"))
    assert np.abs(seen * 255 - np.round(seen * 255)).max() < 1e-4
    assert camera_info(Camera(encoding="srgb")).encoding == "srgb"


def test_auto_exposure_puts_the_bright_percentile_at_its_level():
    colour = np.random.default_rng(0).random((10_000, 3))
    assert np.percentile(exposure_gain(colour, Camera()) * colour, 99.9) == pytest.approx(0.9)


@pytest.mark.parametrize("bits", [4, 8])
def test_quantisation_is_to_the_nearest_level_and_darkens_nothing(bits):
    """Errors of a ramp are uniform over one level: mean 0, at most half a level, variance a twelfth of it squared."""
    ramp = np.linspace(0, 1, 300_000).reshape(1, -1, 3)
    level = 1 / (2**bits - 1)
    error = (expose(ramp, Camera(bits=bits)).astype(float) - ramp) / level
    assert abs(error.mean()) < 1e-3
    assert np.abs(error).max() < 0.5 + 1e-3
    assert error.var() == pytest.approx(1 / 12, rel=0.02)


def test_display_encoding_rounds_to_the_nearest_of_its_levels_too():
    ramp = np.linspace(0, 1, 30_000).reshape(1, -1, 3)
    error = 255 * (expose(ramp, Camera(encoding="srgb")).astype(float) - encode_srgb(ramp))
    assert abs(error.mean()) < 0.01
    assert np.abs(error).max() < 0.5 + 1e-3
