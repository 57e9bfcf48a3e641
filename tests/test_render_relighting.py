"""Relighting: the same picture that a new trace would give, without one."""

import numpy as np
import pytest

from huesphere.configs.errors import InputError
from huesphere.configs.load import load_config
from huesphere.render import open_item, relight
from huesphere.render.dataset import read_observation
from huesphere.render.run import render_config

BASE = ["camera.resolution=[32,32]", "shape={kind: bowl, opening: 75, detail: 32}", "render.target_rms=0.01"]


def render(folder, *overrides):
    config = load_config("sphere_quick", overrides=[*BASE, "render.transport=[full]", *overrides])
    render_config(config, folder, engine="auto", overwrite=False, progress=lambda *_: None, log=lambda _: None)
    return folder / "sphere_quick/full"


@pytest.fixture(scope="module")
def item(tmp_path_factory):
    return render(tmp_path_factory.mktemp("item"))


def test_without_changes_it_is_the_picture_itself(item):
    assert np.abs(relight(item).rgb - read_observation(item / "observation.exr").rgb).max() < 1e-6


@pytest.mark.parametrize(
    "change",
    ["lights.0.spectrum=D65", "lights.1.intensity=0.2", "camera.sensitivity=CIE 1931", "surface.reflectance=0.4"],
)
def test_it_is_what_a_new_trace_gives(item, tmp_path, change):
    traced = read_observation(render(tmp_path, change) / "observation.exr").rgb
    relit = relight(open_item(item), [change]).rgb
    # Two traces to 1e-2 each, of rays that may differ in number.
    assert np.sqrt(np.mean((relit - traced) ** 2)) < 2e-2 * traced.mean()


@pytest.mark.parametrize("change", ["lights.0.direction=[1,0,1]", "shape.detail=64", "camera.resolution=[8,8]"])
def test_what_moves_something_is_refused(item, change):
    with pytest.raises(InputError, match="cannot change without tracing again"):
        relight(item, [change])


def test_a_sky_that_loses_its_ground_is_refused_for_it_has_a_source_less(tmp_path):
    folder = render(tmp_path, "lights=[{kind: sky, ground: 0.5}]", "render.target_rms=0.2")
    brighter = relight(folder, ["lights.0.ground=0.25", "lights.0.zenith=D65", "camera.exposure=1"])
    assert np.isfinite(brighter.rgb).all()
    with pytest.raises(InputError, match="cannot change without tracing again"):
        relight(folder, ["lights.0.ground=null"])


def test_of_several_reflectances_the_lights_may_change_and_the_reflectances_may_not(tmp_path):
    checker = "surface.checker={reflectance: 0.2, size: 0.3}"
    folder = render(tmp_path / "one", checker)
    traced = read_observation(render(tmp_path / "other", checker, "lights.0.spectrum=D65") / "observation.exr").rgb
    relit = relight(folder, ["lights.0.spectrum=D65"]).rgb
    assert np.sqrt(np.mean((relit - traced) ** 2)) < 2e-2 * traced.mean()
    with pytest.raises(InputError, match="cannot change without tracing again"):
        relight(folder, ["surface.checker.reflectance=0.3"])
