"""Pixels that miss a light by less than noise: found by all of them together, left alone where there are none."""

import numpy as np
import pytest
from synthesis import dome, shade

from huesphere.recover.ellipsoid.distance import signed_distance
from huesphere.recover.ellipsoid.fit import fit_accepted
from huesphere.recover.ellipsoid.hidden_lights import _gains, without_hidden_lights
from huesphere.recover.geometry.sphere import fibonacci

NOISE = 3e-3
DIRECTIONS = np.array([[0.5, 0, 1], [-0.3, 0.5, 1], [-0.2, -0.5, 1], [1.2, 1.1, 0.6]])
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
COLOURS = np.array([[1.0, 0.1, 0.1], [0.1, 0.9, 0.1], [0.2, 0.1, 0.8], [0.05, 0.03, 0.02]])


@pytest.fixture(scope="module")
def scene():
    """(rgb, pixels within noise of the ellipsoid, all-lit, true C): a fourth light of 5 %, 70° off axis."""
    normals, mask = dome(128, elongation=1.1, bumps=0.1, cap=0.9)
    observation, F = shade(normals, mask, COLOURS, directions=DIRECTIONS, noise=NOISE)
    rgb, C = observation.rgb.astype(float), np.linalg.inv(F @ F.T)
    lit = normals @ DIRECTIONS.T > 0
    near = np.zeros(mask.shape, bool)
    near[mask] = np.abs(signed_distance(rgb[mask], C)) < 4 * NOISE
    return rgb, near & lit[..., :3].all(axis=-1), lit.all(axis=-1), C


def refitted(rgb: np.ndarray, where: np.ndarray) -> np.ndarray:
    return fit_accepted(rgb[where], np.ones(int(where.sum()), bool), noise=NOISE).C


def off(C: np.ndarray, true: np.ndarray) -> float:
    return float(np.linalg.norm(np.linalg.solve(true, C) - np.eye(3)))


def test_pixels_that_miss_a_hidden_light_are_left_out_and_c_is_right(scene):
    rgb, inlier, all_lit, true = scene
    assert 0.1 < (inlier & ~all_lit).sum() / inlier.sum() < 0.6  # outliers that no cut on single pixels removes
    before = refitted(rgb, inlier)
    C, kept, found = without_hidden_lights(rgb, inlier, before, noise=NOISE, channel_noise=NOISE)
    assert found >= 1
    assert (kept & ~all_lit).sum() < 0.2 * (inlier & ~all_lit).sum()
    assert (kept & all_lit).sum() > 0.7 * (inlier & all_lit).sum()
    assert off(C, true) < 0.5 * off(before, true)


def test_a_pure_ellipsoid_is_left_as_it_is(scene):
    rgb, inlier, all_lit, _ = scene
    pure = inlier & all_lit
    before = refitted(rgb, pure)
    C, kept, found = without_hidden_lights(rgb, pure, before, noise=NOISE, channel_noise=NOISE)
    assert found == 0
    assert np.array_equal(kept, pure)
    assert C is before


def test_noise_along_the_ellipsoid_is_not_taken_for_lights():
    """Under lights of nearly one colour single normals are known to 10°, and |N|² scatters more than the distance."""
    normals, mask = dome(160, elongation=1.1, bumps=0.1, cap=0.6)
    alike = np.array([[1.0, 0.95, 0.9], [0.95, 1.0, 0.92], [0.93, 0.96, 1.0], [0.99, 0.97, 0.95]])
    near_axis = DIRECTIONS * [0.3, 0.3, 1]
    observation, F = shade(normals, mask, alike, directions=near_axis, noise=1e-3)
    where = mask & (normals @ near_axis.T > 0).all(axis=-1)
    rgb, C = observation.rgb.astype(float), np.linalg.inv(F @ F.T)
    assert np.sqrt(np.trace(C)) * 1e-3 > np.radians(5)
    _, kept, found = without_hidden_lights(rgb, where, C, noise=1e-3, channel_noise=1e-3)
    assert found == 0
    assert kept.sum() == where.sum()


def test_the_scale_of_the_noise_does_not_matter():
    rng = np.random.default_rng(0)
    n = rng.normal(loc=(0, 0, 1.5), size=(3000, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    sigma, a = rng.uniform(0.01, 0.1, 3000), fibonacci(100)
    off = rng.normal(size=3000) + 0.3 * np.minimum(n @ a[30], 0.0) / sigma
    gain = _gains(n, off, sigma, a)
    assert gain.max() > 100
    for scale in (1e-18, 1e12):
        assert _gains(n, off, scale * sigma, a) == pytest.approx(gain, rel=1e-4, abs=1e-3)
