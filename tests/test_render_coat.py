"""Coats under light from all around: energy, and a sky that is nothing but ambient light."""

import numpy as np
import pytest

from huesphere.configs.load import load_config
from huesphere.render.picture import assemble
from huesphere.render.transport import trace
from huesphere.scenes.build import build_scene

COAT = "surface={kind: coated, reflectance: 1.0, roughness: 0.3}"


def coated(mi, *overrides):
    """(colours (n, 3), layers) of direct light on a coated ellipsoid."""
    settings = ["camera.resolution=[16,16]", "shape={kind: ellipsoid, detail: 16}", COAT, *overrides]
    scene = build_scene(load_config("sphere_quick", overrides=settings))
    traced = trace(scene, mi, reach="direct", target_rms=2e-2, max_bounces=None, seed=0, progress=lambda *_: None)
    picture = assemble(scene, traced, "direct", mi)
    return picture.colour[traced.pixels.row, traced.pixels.col], picture.layers


def test_a_coat_in_a_white_furnace_sends_back_less_than_arrives_and_most_of_it(mi):
    _, layers = coated(mi, "lights=[{kind: ambient, spectrum: E}]")
    diffuse, highlight = (layers.images[0, k][layers.material >= 0] for k in (0, 1))
    total = diffuse + highlight
    assert total.max() < 1.01
    assert total.min() > 0.6  # a rough coat loses what its microfacets reflect more than once
    # Fresnel's reflectance at normal incidence, ((n − 1) / (n + 1))², is the least that the coat reflects.
    assert highlight.min() > 0.03


def test_a_uniform_sky_on_a_convex_shape_is_ambient_light(mi):
    sky = "lights=[{kind: sky, zenith: E, horizon: E, ground: E}]"
    domes, _ = coated(mi, sky)
    ambient, _ = coated(mi, "lights=[{kind: ambient, spectrum: E}]")
    assert np.sqrt(np.mean((domes / domes.mean() - ambient / ambient.mean()) ** 2)) < 0.03


def test_light_from_around_states_its_error(mi):
    settings = ["lights=[{kind: sky, zenith: E, horizon: A}]"]
    first, layers = coated(mi, *settings)
    inside = layers.material >= 0
    stated = np.sqrt(np.mean(layers.standard_error[inside] ** 2)) / first.mean()
    assert 1e-5 < stated < 2e-2


def test_a_map_under_a_coat_leaves_its_highlight_alone(mi):
    lights = "lights=[{direction: [0.3, 0.2, 1], spectrum: E}]"
    texture = "surface={kind: coated, reflectance: 1.0, roughness: 0.3, texture: {kind: noise}}"
    (plain, one), (varied, other) = coated(mi, lights), coated(mi, lights, texture)
    assert (one.images == other.images).all()
    inside = one.material >= 0
    weight = other.weights[0][inside][:, None]
    base = one.rgb(0, "direct")[inside] - np.einsum("n,k->nk", one.images[0, 1][inside], one.colours[0, 1, 0])
    assert varied - plain == pytest.approx((weight - 1) * base, abs=1e-5 * float(plain.max()))
