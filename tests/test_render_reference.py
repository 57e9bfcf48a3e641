"""What only the stock integrator can render: light by light, and taken apart by the length of its paths."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from huesphere.configs.errors import InputError
from huesphere.configs.load import load_config
from huesphere.render import open_item
from huesphere.render.dataset import read_observation, read_truth
from huesphere.render.layers import PARTS, read_layers
from huesphere.render.picture import assemble
from huesphere.render.reference import render_lights, render_parts, render_reference
from huesphere.render.run import render_config
from huesphere.render.transport import trace
from huesphere.scenes.build import build_scene
from huesphere.scenes.lights.sky import DomeLight

BOWL = "shape={kind: bowl, opening: 75, detail: 32}"
COATED = "surface={kind: coated, reflectance: light skin, roughness: 0.3}"
SHARED = {"max_bounces": None}


def load(*overrides):
    return load_config("sphere_quick", overrides=["camera.resolution=[24,24]", "render.samples=96", *overrides])


def test_parts_add_to_the_picture_that_has_the_same_seed(mi):
    scene = build_scene(load(BOWL, "surface.reflectance=0.8"))
    for transport, count in (("direct", 1), ("one-bounce", 2), ("full", 3)):
        parts = render_parts(mi, scene, transport, samples=16, seed=3, **SHARED)
        assert len(parts) == count
        assert min(part.min() for part in parts) >= 0
        whole = render_reference(mi, scene, transport, samples=16, seed=3, **SHARED)
        assert np.abs(sum(parts) - whole).max() < 1e-6 * whole.max()


def test_a_convex_shape_gets_no_part_but_direct_light_not_even_noise(mi):
    scene = build_scene(load("shape={kind: ellipsoid, detail: 32}", COATED))
    direct, bounce, rest = render_parts(mi, scene, "full", samples=16, seed=0, **SHARED)
    assert direct.max() > 0
    assert bounce.max() == rest.max() == 0


def test_samples_in_several_launches_are_one_picture(mi, monkeypatch):
    scene = build_scene(load(BOWL, "surface.reflectance=0.8"))
    whole = render_reference(mi, scene, "direct", samples=1000, seed=0, **SHARED)
    monkeypatch.setattr("huesphere.render.reference.PATHS_AT_ONCE", 24 * 24 * 300)  # 300, 300, 300 and 100
    pieces = render_reference(mi, scene, "direct", samples=1000, seed=0, **SHARED)
    assert (pieces != whole).any()
    # Colour noise of a pixel at 1000 samples is some 2 % of the mean; independent, over √576 pixels.
    assert pieces.mean(axis=(0, 1)) == pytest.approx(whole.mean(axis=(0, 1)), rel=4e-3)


def test_a_light_alone_does_not_know_of_the_others(mi):
    lights = ["{direction: [0.3,0.2,1], spectrum: FL2}", "{direction: [-0.5,0.1,1], spectrum: A, intensity: 0.5}"]
    scene = build_scene(load(BOWL, COATED, f"lights=[{', '.join(lights)}]"))
    both = render_lights(mi, scene, "full", samples=600, seed=0, **SHARED)
    assert both.shape == (2, 3, 24, 24, 3)
    whole = render_reference(mi, scene, "full", samples=600, seed=1, **SHARED)
    assert both.sum(axis=(0, 1)).mean(axis=(0, 1)) == pytest.approx(whole.mean(axis=(0, 1)), rel=2e-2)
    dimmed = build_scene(load(BOWL, COATED, f"lights=[{lights[0]}, {lights[1].replace('0.5}', '0.25}')}]"))
    again = render_lights(mi, dimmed, "full", samples=600, seed=0, **SHARED)
    # Not bit for bit: threads add up samples in any order.
    assert np.abs(again[0] - both[0]).max() < 1e-5 * both.max()
    assert np.abs(again[1] - both[1] / 2).max() < 1e-5 * both.max()


@pytest.mark.parametrize("profile", ["uniform", "zenith", "horizon", "ground"])
def test_a_convex_shape_under_a_dome_has_its_closed_form(mi, profile):
    # Nothing in the way: the stock picture is the closed form of DomeLight.unoccluded, whose integral is tested apart.
    scene = build_scene(load("shape={kind: sphere, detail: 48}", "camera.pixel=area"))
    light = DomeLight("sky", scene.lights[0].spectrum, np.array([0.6, 0.0, 0.8]), profile)
    scene = replace(scene, lights=(light,))
    traced = trace(scene, mi, reach="linear", target_rms=1e-2, max_bounces=None, seed=0, progress=lambda *_: None)
    expected = assemble(scene, traced, "linear").colour
    picture = render_reference(mi, scene, "direct", samples=1024, seed=0, **SHARED)
    inside = ndimage.binary_erosion(traced.mask(), iterations=2)
    assert picture[inside].mean(axis=0) == pytest.approx(expected[inside].mean(axis=0), rel=5e-3)
    assert np.sqrt(np.mean((picture - expected)[inside] ** 2)) < 0.03 * picture.max()  # colour noise


@pytest.fixture(scope="module")
def items(tmp_path_factory):
    """Folders of a coated bowl, and of a matte one by the reference engine, in all transports but linear."""
    run = tmp_path_factory.mktemp("stock")
    for name, engine, surface in (("coated", "auto", [COATED]), ("matte", "reference", [])):
        config = load(BOWL, *surface, f"name={name}", "render.transport=[direct,one-bounce,full]")
        render_config(config, run, engine=engine, overwrite=False, progress=lambda *_: None, log=lambda _: None)
    return run


@pytest.mark.parametrize("transport", ["direct", "one-bounce", "full"])
@pytest.mark.parametrize("name", ["coated", "matte"])
def test_layers_of_each_light_add_to_the_picture(items, name, transport):
    folder = items / name / transport
    layers, seen = read_layers(folder / "layers.exr"), read_observation(folder / "observation.exr")
    assert layers.stock == (name == "matte" or transport != "direct")
    assert np.abs(layers.picture() - seen.rgb).max() < 1e-6
    parts = sum(layers.rgb(i, part) for i in range(3) for part in PARTS)
    assert np.abs(parts - seen.rgb).max() < 1e-6
    assert all(layers.rgb(i, "direct")[seen.mask].mean() > 0.05 for i in range(3))
    assert (layers.rgb(0, "rest").max() > 0) == (transport == "full")


def test_direct_light_of_a_coat_is_exact_however_the_rest_is_rendered(items):
    exact, stock = (read_layers(items / "coated" / t / "layers.exr") for t in ("direct", "full"))
    assert (stock.images[:, :2] == exact.images).all()
    assert stock.names[:2] == exact.names == ("direct", "highlight")
    truth = read_truth(items / "coated/full/truth.exr")
    share = truth.extra["highlight_share"][truth.mask]
    assert 0 < share.mean() < read_truth(items / "coated/direct/truth.exr").extra["highlight_share"][truth.mask].mean()


@pytest.mark.parametrize("name", ["coated", "matte"])
def test_colours_cannot_be_relit(items, name):
    with pytest.raises(InputError, match="own integrator gives colours"):
        open_item(items / name / "full")


@pytest.mark.slow
def test_a_coated_bowl_is_the_stock_integrators_whole_picture(mi, tmp_path):
    # Our direct light and the stock integrator's bounces, against all of it by the stock integrator: in the mean.
    config = load(BOWL, COATED, "render.samples=4096", "camera.pixel=area", "camera.exposure=1", "name=coated")
    config = config.model_copy(update={"render": config.render.model_copy(update={"transport": ("full",)})})
    render_config(config, tmp_path, engine="auto", overwrite=False, progress=lambda *_: None, log=lambda _: None)
    ours = read_observation(tmp_path / "coated/full/observation.exr")
    whole = render_reference(mi, build_scene(config), "full", samples=4096, seed=7, max_bounces=None)
    assert ours.rgb[ours.mask].mean(axis=0) == pytest.approx(whole[ours.mask].mean(axis=0), rel=1e-2)
