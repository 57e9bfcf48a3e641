"""Transport: against plain arithmetic, closed forms, the stock renderer, and its own claim of accuracy."""

import numpy as np
import pytest
from scipy import ndimage, stats

from huesphere.configs.load import load_config
from huesphere.render.picture import assemble
from huesphere.render.reference import render_reference
from huesphere.render.spectral import component_colours, components_by_order, linear_model
from huesphere.render.transport import trace
from huesphere.scenes.build import build_scene

CONCAVE = "shape={kind: bowl, opening: 80, detail: 64}"


def make(*overrides, config="sphere_quick"):
    config = load_config(config, overrides=["camera.resolution=[64,64]", *overrides])
    return config, build_scene(config)


def run(mi, scene, *, seed=0, target=2e-3, reach="full", max_bounces=None):
    return trace(
        scene,
        mi,
        reach=reach,
        target_rms=target,
        max_bounces=max_bounces,
        seed=seed,
        progress=lambda *_: None,
    )


def direct(traced):
    return traced.images[:, :, 0].mean(axis=0)


def test_sphere_normals_are_position_over_radius_in_the_declared_frame(mi):
    _, scene = make("shape={kind: sphere, detail: 96}")
    traced = run(mi, scene, reach="direct")
    row, col = traced.pixels.row, traced.pixels.col
    x = (col + 0.5 - 32) * scene.view.pixel_size  # right
    y = (32 - row - 0.5) * scene.view.pixel_size  # up
    z = np.sqrt(np.maximum(0, 1 - x**2 - y**2))  # toward the camera
    inner = z > 0.3
    normals = traced.pixels.points.normal
    assert np.abs(normals - np.stack([x, y, z], axis=1))[inner].max() < 1e-3
    assert np.abs(traced.pixels.points.position[:, 2] - z)[inner].max() < 1e-3


def test_linear_is_plain_arithmetic(mi):
    _, scene = make()
    traced = run(mi, scene, reach="direct")
    expected = 0
    for light in scene.lights:
        colour = [np.sum(light.spectrum * scene.reflectances[0] * curve) for curve in scene.sensitivity.T]
        expected = expected + np.outer(np.maximum(0, traced.pixels.points.normal @ light.direction), colour)
    picture = assemble(scene, traced, "linear").colour[traced.pixels.row, traced.pixels.col]
    assert np.abs(picture / expected.max() - expected / expected.max()).max() < 1e-6


def test_pixels_that_see_every_light_obey_the_linear_model(mi):
    _, scene = make()
    traced = run(mi, scene, reach="direct")
    lit = (traced.facing > 0).all(axis=0)
    picture = assemble(scene, traced, "direct").colour[traced.pixels.row, traced.pixels.col]
    expected = traced.pixels.points.normal @ linear_model(scene).T  # Eq. (6)
    assert np.abs(picture - expected)[lit].max() < 1e-5 * expected.max()


def test_a_convex_shape_has_no_cast_shadow_and_no_indirect_light(mi):
    _, scene = make("shape={kind: ellipsoid, semi_axes: [1.0, 0.7, 0.8]}")
    traced = run(mi, scene)
    lost = 1 - direct(traced)[traced.facing > 0.02] / traced.facing[traced.facing > 0.02]
    assert np.mean(lost) < 1e-4
    assert traced.images[:, :, 1:].max() < 1e-3


def test_a_wall_casts_its_shadow_where_geometry_says(mi):
    # A right-angled groove along y, lit from the right at 60° off axis: the right wall shades part of the left one.
    light = "lights=[{direction: [0.8660254, 0, 0.5], spectrum: E}]"
    _, scene = make("shape={kind: v_groove, angle: 90, detail: 16}", light)
    traced = run(mi, scene, reach="direct")
    position, normal = traced.pixels.points.position, traced.pixels.points.normal
    left = normal[:, 0] > 0
    # The left wall is z = c − x; the ray that grazes the rim of the right wall meets it at the shadow's edge.
    rim = scene.mesh.vertices[np.argmax(scene.mesh.vertices[:, 0])]
    slope = 0.5 / 0.8660254
    c = np.mean(position[left, 2] + position[left, 0])
    x_edge = (c - rim[2] + slope * rim[0]) / (1 + slope)
    lit = direct(traced)[0] > 0.5 * traced.facing[0]
    boundary = position[left & lit, 0].max()
    assert boundary == pytest.approx(x_edge, abs=1.5 * scene.view.pixel_size)


def test_bowl_of_an_integrating_sphere_has_its_closed_form(mi):
    # Inside a sphere every patch dA is seen from every point with the form factor dA / 4πR². Under light along the axis
    # T_0 = cosθ, and T_1 = ∫ cosθ dA / 4πR² is the same everywhere: in a half sphere ∫ cosθ dA = πR², so T_1 = 1/4, and
    # T_{k+1} = T_k · ½, the share of the sphere that is there.
    _, scene = make("shape={kind: bowl, opening: 90, detail: 96}", "lights=[{direction: [0,0,1], spectrum: E}]")
    traced = run(mi, scene, target=1e-3)
    inner = traced.pixels.points.normal[:, 2] > 0.2
    first, second = (traced.images.mean(axis=0)[0, k][inner] for k in (1, 2))
    assert first.mean() == pytest.approx(0.25, rel=2e-3)
    assert second.mean() == pytest.approx(0.125, rel=2e-3)
    assert first.std() < 0.01


def test_bounces_end_where_they_are_told_to(mi):
    _, scene = make(CONCAVE)
    assert run(mi, scene, max_bounces=1, target=2e-2).components.names == ("direct", "one_bounce")


def test_indirect_light_is_never_more_than_arrives(mi):
    _, scene = make(CONCAVE, "surface.reflectance=1.0")
    traced = run(mi, scene, target=1e-2, max_bounces=6)
    totals = traced.images.mean(axis=0).mean(axis=2)  # (L, orders)
    assert (np.diff(totals, axis=1) < 0).all()


def test_same_seed_same_bits_and_another_seed_other_bits(mi):
    _, scene = make(CONCAVE)
    first, again, other = (run(mi, scene, seed=s, target=1e-2).images for s in (3, 3, 4))
    assert (first == again).all()
    assert first.shape != other.shape or (first != other).any()


@pytest.mark.parametrize("target", [1e-2, 4e-3])
def test_claimed_error_is_the_error_over_independent_seeds(mi, target):
    _, scene = make(CONCAVE, "surface.reflectance=0.8")
    runs = [run(mi, scene, seed=s, target=target) for s in range(4)]
    pictures = np.stack([assemble(scene, r, "full").colour[r.pixels.row, r.pixels.col] for r in runs])
    mean = pictures.mean(axis=(0, 1))
    true = np.sqrt(np.mean(pictures.var(axis=0, ddof=1) / mean**2))
    claimed = np.sqrt(np.mean([r.error**2 for r in runs]))
    assert claimed <= target
    assert claimed == pytest.approx(true, rel=0.15)


@pytest.mark.parametrize("transport", ["direct", "one-bounce", "full"])
def test_equal_to_the_stock_spectral_path_tracer_within_its_noise(mi, transport):
    # Strong interreflection: a deep bowl of albedo 0.9. The stock picture comes in independent batches, whose spread is
    # its noise; each pixel's difference is a t statistic, and the worst of them is held against all that are tested.
    _, scene = make(CONCAVE, "surface.reflectance=0.9", "camera.pixel=area", "camera.resolution=[32,32]")
    traced = run(mi, scene, target=1e-3)
    ours = assemble(scene, traced, transport).colour
    batches = np.stack(
        [render_reference(mi, scene, transport, samples=256, seed=s, max_bounces=None) for s in range(16)]
    )
    inside = ndimage.binary_erosion(traced.mask(), iterations=2)
    error = batches.std(axis=0, ddof=1) / np.sqrt(len(batches))
    seen = inside[..., None] & (error > 0)
    t = (ours - batches.mean(axis=0))[seen] / error[seen]
    p = 2 * stats.t.sf(np.abs(t), df=len(batches) - 1)
    assert p.min() * p.size > 1e-3, f"worst pixel p = {p.min():.1e} of {p.size}"
    # And the mean over the object, where noise is small enough to see a bias of a few parts in a thousand.
    assert ours[inside].mean(axis=0) == pytest.approx(batches.mean(axis=0)[inside].mean(axis=0), rel=4e-3)


def test_colour_of_an_order_is_the_integral_of_the_power_of_the_reflectance():
    _, scene = make("surface.reflectance=light skin", config="mozart_5lights")
    b = component_colours(scene, components_by_order(scene.reflectances[0], 2))
    light, surface = scene.lights[1].spectrum, scene.reflectances[0]
    assert b[1, 2, 0] == pytest.approx([(light * surface**3 * q).sum() for q in scene.sensitivity.T])
