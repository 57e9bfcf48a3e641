"""A shape given beside the config: what is set of it is used, and what says another shape is refused."""

import subprocess
import sys
from pathlib import Path

import pytest

from huesphere.configs.errors import InputError
from huesphere.configs.load import load_config, load_configs
from huesphere.configs.schema import DepthMap, MeshFile

RENDER = Path(sys.executable).parent / "render"


@pytest.mark.parametrize("name", ["sphere_quick", "mozart_5lights"])
def test_keys_of_the_shape_belong_to_the_file(tmp_path, name):
    settings = ["shape.rotation=[0, 0, 90]", "shape.smooth=5"]
    spec = load_config(name, shape=str(tmp_path / "a.obj"), overrides=settings).shape
    assert spec == MeshFile(kind="mesh", path=str(tmp_path / "a.obj"), rotation=(0, 0, 90), smooth=5)
    settings = ["shape.toward_camera=false", "shape.no_data=-1", "shape.depth_scale=2"]
    spec = load_config(name, shape=str(tmp_path / "a.npy"), overrides=settings).shape
    assert isinstance(spec, DepthMap)
    assert (spec.toward_camera, spec.no_data, spec.depth_scale) == (False, -1, 2)


@pytest.mark.parametrize(
    ("file", "setting", "message"),
    [
        ("a.obj", "shape.smoooth=3", "did you mean 'smooth'"),
        ("a.obj", "shape.depth_scale=3", "unknown key shape.depth_scale"),
        ("a.npy", "shape.rotation=[0,0,90]", "unknown key shape.rotation"),
        ("a.npy", "shape.towardcamera=false", "did you mean 'toward_camera'"),
        ("a.npy", "shape.detail=8", "unknown key shape.detail"),  # a key of the shape that is replaced
        ("a.npy", "shape={kind: bowl}", "both say which shape"),
        ("a.npy", "shape.kind=mesh", "both say which shape"),
        ("a.npy", "shape.path=b.npy", "both say which shape"),
        ("a.npy", "sweep.shape.path=[b.npy, c.npy]", "both say which shape"),
    ],
)
def test_what_does_not_belong_to_the_file_is_refused(tmp_path, file, setting, message):
    with pytest.raises(InputError, match=message):
        load_config("sphere_quick", shape=str(tmp_path / file), overrides=[setting])


def test_a_sweep_of_the_config_over_shapes_is_refused_and_one_over_its_keys_is_not(tmp_path):
    text = "shape: {kind: sphere}\nlights: [{direction: [0, 0, 1]}]\nsweep: {KEY: VALUES}\n"
    (tmp_path / "paths.yaml").write_text(text.replace("KEY", "shape.path").replace("VALUES", "[a.npy, b.npy]"))
    with pytest.raises(InputError, match=r"paths\.yaml.*a sweep over shape\.path"):
        load_configs(str(tmp_path / "paths.yaml"), shape="c.npy")
    (tmp_path / "scales.yaml").write_text(text.replace("KEY", "shape.depth_scale").replace("VALUES", "[1, 2]"))
    configs = load_configs(str(tmp_path / "scales.yaml"), shape="c.npy")
    assert [config.shape.depth_scale for config in configs] == [1, 2]


def test_an_option_and_a_setting_that_say_the_same_do_not_silence_each_other(tmp_path):
    words = ["--config", "sphere_quick", "--set", "camera.resolution=[8,8]", "--transport", "linear"]
    both = [RENDER, *words, "--set", "render.transport=[full]"]
    done = subprocess.run(both, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert "--transport and --set render.transport" in done.stderr
    seeds = [RENDER, *words, "--seed", "3", "--set", "camera.seed=5"]
    done = subprocess.run(seeds, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    config = load_config(str(tmp_path / "run/sphere_quick/linear/config.yaml"))
    assert (config.render.seed, config.camera.seed) == (3, 5)
