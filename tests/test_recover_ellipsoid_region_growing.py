"""The compiled steps of growth, each against a plain version of itself, and growth of an ellipsoid among two."""

import numpy as np
import pytest
from scipy import ndimage

from huesphere.recover.ellipsoid import region_growing as growing
from huesphere.recover.ellipsoid.candidates import bias_terms
from huesphere.recover.ellipsoid.distance import signed_distance
from huesphere.recover.ellipsoid.fit import fit_accepted
from huesphere.recover.ellipsoid.parameters import ELLIPSOID
from huesphere.recover.parameters import overridden

RNG = np.random.default_rng(0)
C = np.array([[2.0, 0.3, -0.2], [0.3, 1.5, 0.1], [-0.2, 0.1, 3.0]])
SIGMA = 0.01


def on_ellipsoid(C: np.ndarray, shape: tuple[int, int], seed: int) -> np.ndarray:
    """Colours (*shape, 3) on ρᵀCρ = 1 with noise SIGMA, of normals that vary over the picture."""
    rng = np.random.default_rng(seed)
    row, column = np.mgrid[: shape[0], : shape[1]]
    n = np.stack([row / shape[0] - 0.5, column / shape[1] - 0.5, 0.8 + 0 * row], axis=-1)
    n = n @ np.linalg.qr(rng.standard_normal((3, 3)))[0]
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    return n @ np.linalg.inv(np.linalg.cholesky(C)) + SIGMA * rng.standard_normal(n.shape)


def accepted(distance: np.ndarray, usable: np.ndarray) -> np.ndarray:
    weight = np.empty(distance.shape)
    growing.box_sums(usable.astype(float), 2, weight)
    work, near, out = np.empty((3, *distance.shape)), np.empty(distance.shape), np.empty(distance.shape, np.uint8)
    growing.accept(distance, weight, 3.0, growing.growth_settings(), near, work, out)
    return out.astype(bool)


def test_distances_are_sampson_s_over_their_standard_deviation():
    rgb, usable = RNG.uniform(0.2, 1.0, (6, 7, 3)), np.ones((6, 7), bool)
    usable[2, 3] = False
    out = np.empty((6, 7))
    growing.distances(rgb, usable, C, SIGMA**2 * np.eye(3), out)
    assert out[2, 3] == growing.FAR
    assert out[usable] == pytest.approx(signed_distance(rgb[usable], C) / SIGMA, rel=1e-9)


def test_independent_noise_is_accepted_and_a_shift_of_one_deviation_is_not():
    """A single distance of 1 is likely; a mean of 25 of them is five standard deviations."""
    usable = np.ones((60, 60), bool)
    noise = RNG.standard_normal(usable.shape)
    assert accepted(noise, usable).mean() > 0.98
    assert accepted(noise + 1.2, usable).mean() < 0.1


def test_a_pixel_among_outliers_is_not_accepted():
    usable, distance = np.ones((20, 20), bool), np.full((20, 20), 10.0)
    distance[10, 10] = 0.0
    assert not accepted(distance, usable).any()


def test_flooding_goes_as_far_as_it_may_and_through_accepted_pixels_only():
    open_, region = np.ones((9, 9), np.uint8), np.zeros((9, 9), np.uint8)
    open_[:, 6] = 0  # a wall
    region[4, 4] = 1
    count = growing.flood(open_, region, 3, np.empty(81, np.int64))
    row, column = np.mgrid[:9, :9]
    reached = (np.abs(row - 4) + np.abs(column - 4) <= 3) & (column < 6)
    assert np.array_equal(region.astype(bool), reached)
    assert count == reached.sum()


def test_the_fit_over_a_region_is_that_of_fit_accepted():
    rgb, region = on_ellipsoid(C, (40, 50), 1), np.zeros((40, 50), np.uint8)
    region[5:30, 10:45] = 1
    found = np.empty((3, 3))
    assert growing.fit_region(rgb, region, bias_terms(SIGMA**2 * np.eye(3)), found)
    inside = region.astype(bool)
    expected = fit_accepted(rgb[inside], np.ones(int(inside.sum()), bool), noise=SIGMA).C
    assert found == pytest.approx(expected, rel=1e-6)


def test_too_few_pixels_or_colours_in_a_plane_are_no_ellipsoid():
    rgb, region, found = on_ellipsoid(C, (20, 20), 2), np.zeros((20, 20), np.uint8), np.empty((3, 3))
    region[0, :11] = 1
    none = bias_terms(np.zeros((3, 3)))
    assert not growing.fit_region(rgb, region, none, found)
    region[:] = 1
    assert not growing.fit_region(rgb * [1.0, 1.0, 0.0], region, none, found)


def test_opening_keeps_whole_squares_only():
    image = (RNG.uniform(size=(40, 40)) < 0.8).astype(np.uint8)
    out = np.empty_like(image)
    growing.open3(image, out)
    assert np.array_equal(out.astype(bool), ndimage.binary_opening(image, np.ones((3, 3))))


def grown(final_cuts: tuple[float, ...] = ()) -> tuple[np.ndarray, np.ndarray]:
    """(C, region) from a seed in the left half of a picture whose right half lies on a smaller one."""
    rgb = np.concatenate([on_ellipsoid(C, (60, 40), 3), 0.8 * on_ellipsoid(C, (60, 40), 4)], axis=1)
    usable, weight, V = np.ones((60, 80), np.uint8), np.empty((60, 80)), SIGMA**2 * np.eye(3)
    growing.box_sums(usable.astype(float), 2, weight)
    found, region = 1.3 * C, np.zeros((60, 80), np.uint8)
    box, reaches = np.array([20, 40, 8, 28]), np.array(ELLIPSOID.growth_reaches_px)
    settings, cuts = growing.growth_settings(), np.array(final_cuts)
    region[20:40, 8:28] = 1
    growing.fit_region(rgb, region, bias_terms(V), found)
    growing.grow(rgb, usable, weight, V, bias_terms(V), box, found, reaches, cuts, settings, region)
    return found, region.astype(bool)


@pytest.mark.parametrize("final_cuts", [(), (4.0, 3.0)])
def test_a_seed_grows_over_its_own_half_and_stops_at_the_other(final_cuts):
    found, region = grown(final_cuts)
    assert region[:, :38].mean() > 0.85
    assert region[:, 42:].mean() < 0.03
    assert np.linalg.norm(found - C) < 0.05 * np.linalg.norm(C)


def test_a_region_below_the_least_size_fails():
    with overridden(ELLIPSOID, fewest_region_pixels=100_000):
        found, _ = grown()
    assert np.isnan(found).all()
