"""Normals where the indirect light subtracted from a colour is uncertain."""

from dataclasses import replace

import numpy as np
from synthesis import problem_of_colours

from huesphere.recover.every_pixel.by_light_sets import LabelledPixels
from huesphere.recover.every_pixel.completion import NONE_FOUND, _won_back
from huesphere.recover.geometry.sphere import on_sphere
from huesphere.recover.pixels.parameters import PIXELS
from huesphere.recover.pixels.uncertain_component import nearest_normals_uncertain, without_uncertain_part

FLAT = np.array(
    [[0.023, 0.15, 0.835], [-0.004, 0.132, 0.784], [-0.009, 0.062, 0.462]]
)  # lights of much the same colour
TILTED = np.array([[0.9, 0.1, 0.8], [-0.2, 0.8, 0.7], [0.1, -0.6, 0.9]])
NOISE = 2e-5


def turned_deg(n, truth):
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(n, truth), axis=1), np.sum(n * truth, axis=1)))


def scene(seed=0, count=4000, F=FLAT):
    """(true normals, colours that hold a few percent too much or too little of g, g)."""
    rng = np.random.default_rng(seed)
    n = rng.normal(loc=(0, 0, 3), size=(count, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    g = rng.uniform(0.01, 0.05, (count, 1)) * (np.array([1.0, 0.6, 0.3]) + 0.03 * rng.standard_normal((count, 3)))
    wrong = 0.05 * rng.standard_normal((count, 1)) * g
    return n, n @ F.T + wrong + NOISE * rng.standard_normal((count, 3)), g


def test_an_error_along_the_subtracted_light_is_not_taken_for_shape():
    n, rho, g = scene()
    plain, _ = on_sphere(rho, FLAT)
    better = nearest_normals_uncertain(rho, FLAT, plain, g, NOISE)
    assert np.median(turned_deg(better, n)) < 0.25 * np.median(turned_deg(plain, n))


def test_where_nothing_was_subtracted_it_is_the_nearest():
    n, rho, g = scene(1, F=TILTED)
    plain, _ = on_sphere(rho, TILTED)
    assert turned_deg(nearest_normals_uncertain(rho, TILTED, n, 0 * g, NOISE), plain).max() < 1e-3


def test_the_metric_is_the_inverse_of_the_covariance():
    rng = np.random.default_rng(2)
    v, g = rng.standard_normal((2, 5, 3))
    for one, along, light in zip(without_uncertain_part(v, g, 0.3), v, g):
        covariance = 0.3**2 * np.eye(3) + PIXELS.subtracted_light_error**2 * np.outer(light, light)
        np.testing.assert_allclose(one, 0.3**2 * np.linalg.solve(covariance, along), rtol=1e-10)


def test_interpolated_pixels_are_recovered_where_only_what_was_subtracted_is_wrong():
    """Of a dome's interpolated pixels one half has a few percent too much subtracted, the other half misses light."""
    side = 40
    y, x = np.mgrid[:side, :side] / (side / 2) - 1
    n = np.stack([0.6 * x, -0.6 * y, np.sqrt(1 - 0.36 * (x**2 + y**2))], axis=-1)
    g = np.broadcast_to(0.04 * np.array([1.0, 0.6, 0.3]), n.shape)
    rng = np.random.default_rng(4)
    rgb = n @ TILTED.T + NOISE * rng.standard_normal(n.shape)
    uncertain, shadowed = np.zeros((2, side, side), bool)
    uncertain[8:20, 10:30], shadowed[22:32, 10:30] = True, True
    rgb[uncertain] += 0.05 * g[uncertain]
    rgb[shadowed] *= 0.5
    between = uncertain | shadowed
    bridge = np.where(between[..., None], [0.0, 0.0, 1.0], n)
    before = LabelledPixels(bridge, np.where(between, -1, 0), ~between, between, np.zeros_like(between))
    everywhere = np.ones_like(between)
    problem = replace(problem_of_colours(rgb, everywhere, NOISE), removed=g)
    after = _won_back(before, problem, TILTED, NONE_FOUND)
    inside = np.zeros_like(uncertain)
    inside[9:19, 11:29] = True
    assert after.explained[inside].all()
    assert (after.missed[inside] == 0).all()
    assert turned_deg(after.normals[inside], n[inside]).max() < 1
    assert not after.explained[shadowed].any()
