"""Ranks of patches, against the number of lights that their pixels see."""

import numpy as np
import pytest
from scipy import ndimage
from synthesis import DIRECTIONS, dome, light_colours, shade

from huesphere.recover.pixels.noise import channel_noise
from huesphere.recover.pixels.rank import rank_map


@pytest.mark.parametrize("noise", [0.0, 3e-4])
def test_rank_is_the_number_of_lights_seen(noise):
    n, mask = dome(160, cap=0.97)
    wide = DIRECTIONS[:3] * [3.0, 3.0, 1]
    wide /= np.linalg.norm(wide, axis=1, keepdims=True)
    observation, _ = shade(n, mask, light_colours("gels")[:3], directions=wide, noise=noise)
    seen = (n @ wide.T > 0).sum(axis=-1)
    rank = rank_map(observation.rgb, mask, noise=noise)
    clear = (ndimage.maximum_filter(seen, 9) == ndimage.minimum_filter(seen, 9)) & (rank >= 0)
    for lights in (2, 3):
        assert (rank[clear & (seen == lights)] == lights).mean() > 0.9
    assert (rank[clear] <= seen[clear]).mean() > 0.99


def test_a_plane_has_rank_one_and_noise_has_no_colour():
    rng = np.random.default_rng(0)
    mask = np.ones((40, 40), bool)
    plane = np.array([0.5, 0.4, 0.3]) + 1e-3 * rng.standard_normal((40, 40, 3))
    assert (rank_map(plane, mask)[4:-4, 4:-4] == 1).mean() > 0.99
    assert (rank_map(plane - [0.5, 0.4, 0.3], mask)[4:-4, 4:-4] == 0).mean() > 0.9
    assert channel_noise(plane, mask) == pytest.approx(1e-3, rel=0.1)


def test_rank_does_not_depend_on_exposure_or_order_of_channels():
    n, mask = dome(64)
    rgb = shade(n, mask, light_colours("gels"), noise=1e-3)[0].rgb.astype(float)
    usual = rank_map(rgb, mask)
    assert (rank_map(rgb[..., [2, 0, 1]] * 64, mask) == usual).all()
    assert (rank_map(rgb[:, ::-1], mask[:, ::-1]) == usual[:, ::-1]).all()
