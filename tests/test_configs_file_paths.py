"""Files in configs: the same data wherever they lie, and files found again after a move."""

import copy
import os
import shutil
from argparse import ArgumentTypeError
from pathlib import Path

import numpy as np
import pytest

from huesphere.configs.commandline import path_argument
from huesphere.configs.errors import InputError
from huesphere.configs.file_paths import PathAsWritten, absolute_path, expanded
from huesphere.configs.load import load_config, load_configs
from huesphere.render.dataset import open_run, read_observation
from huesphere.render.plan import Shard, make_plan
from huesphere.render.relighting import geometry_of, relight
from huesphere.render.run import render_configs

SCENE = """\
shape: {kind: depth_map, path: scans/one.npy}
surface: {reflectance: {csv: tables/skin.csv}}
lights: [{direction: [0.2, 0.1, 1]}]
camera: {resolution: [16, 16], read_noise: 0.01}
render: {transport: [linear]}
"""
SWEEP = SCENE + "sweep: {shape.path: [scans/one.npy, scans/two.npy]}\n"


@pytest.fixture
def project(tmp_path) -> Path:
    """A folder with two scans, a table and two configs."""
    folder = tmp_path / "project"
    (folder / "scans").mkdir(parents=True)
    (folder / "tables").mkdir()
    y, x = np.mgrid[-1:1:20j, -1:1:20j]
    np.save(folder / "scans/one.npy", -4 * (x**2 + y**2))
    np.save(folder / "scans/two.npy", -3 * (x**2 + 2 * y**2))
    (folder / "tables/skin.csv").write_text('"wavelength","share"\n"380","0.3"\n"780","0.6"\n')
    (folder / "c.yaml").write_text(SCENE)
    (folder / "sweep.yaml").write_text(SWEEP)
    return folder


def made(configs, run: Path, **options) -> list[str]:
    said: list[str] = []
    render_configs(configs, run, progress=lambda share, what: None, log=said.append, **options)
    return said


def test_names_seeds_and_shards_do_not_depend_on_the_folder(project, tmp_path):
    other = shutil.copytree(project, tmp_path / "elsewhere/deep")
    ours, theirs = (load_configs(str(folder / "sweep.yaml")) for folder in (project, other))
    assert (
        [c.name for c in ours] == ["sweep-path_scans-one.npy", "sweep-path_scans-two.npy"] == [c.name for c in theirs]
    )
    assert [c.camera.seed for c in ours] == [c.camera.seed for c in theirs]
    assert len({c.camera.seed for c in ours}) == 2
    assert [geometry_of(c) for c in ours] == [geometry_of(c) for c in theirs]
    assert [c.shape.path for c in theirs] == [str(other / f"scans/{name}.npy") for name in ("one", "two")]
    for n in (1, 2):
        mine, yours = (
            make_plan(configs, tmp_path / "run", overwrite=False, retry_failed=False, shard=Shard(n, 2)).ids
            for configs in (ours, theirs)
        )
        assert mine == yours


def test_absolute_paths_in_a_sweep_give_names_of_files_and_the_same_seeds(project, tmp_path):
    other = shutil.copytree(project, tmp_path / "job-17")
    seeds, names = [], []
    for folder in (project, other):
        sweep = f"sweep.shape.path=[{folder}/scans/one.npy, {folder}/scans/two.npy]"
        configs = load_configs(str(project / "c.yaml"), overrides=[sweep])
        seeds.append([c.camera.seed for c in configs])
        names.append([c.name for c in configs])
    assert names == [["c-path_one.npy", "c-path_two.npy"]] * 2
    assert seeds[0] == seeds[1]


def test_other_contents_have_another_seed(project):
    before = [c.camera.seed for c in load_configs(str(project / "sweep.yaml"))]
    np.save(project / "scans/two.npy", np.load(project / "scans/two.npy") * 1.5)
    after = [c.camera.seed for c in load_configs(str(project / "sweep.yaml"))]
    assert (after[0] == before[0], after[1] == before[1]) == (True, False)


def test_a_moved_project_goes_on_and_its_items_render_again(project, tmp_path):
    made(load_configs(str(project / "sweep.yaml")), project / "run")
    first = read_observation(project / "run/sweep-path_scans-one.npy/linear/observation.exr")
    moved = Path(shutil.move(project, tmp_path / "moved"))
    assert made(load_configs(str(moved / "sweep.yaml")), moved / "run") == [
        "sweep-path_scans-one.npy/linear: already there",
        "sweep-path_scans-two.npy/linear: already there",
    ]
    item = open_run(moved / "run")[0]
    assert item.config().shape.path == str(moved / "scans/one.npy")
    assert str(tmp_path) not in (item.folder / "config.yaml").read_text()
    assert relight(item).rgb.shape == (16, 16, 3)
    made([load_config(str(item.folder / "config.yaml"))], tmp_path / "again")
    again = read_observation(tmp_path / "again/sweep-path_scans-one.npy/linear/observation.exr")
    np.testing.assert_array_equal(again.rgb, first.rgb)


@pytest.mark.parametrize("place", ["archive/2026/run", "run2"])
def test_a_run_that_moves_alone_finds_the_files_that_it_was_made_from(project, tmp_path, place):
    made([load_config(str(project / "c.yaml"))], project / "run")
    (project / place).parent.mkdir(parents=True, exist_ok=True)
    shutil.move(project / "run", project / place)
    config = load_config(str(project / place / "c/linear/config.yaml"))
    assert config.shape.path == str(project / "scans/one.npy")
    np.save(project / "scans/one.npy", np.zeros((20, 20)))  # other contents: not the file that is meant
    if place != "run2":
        config = load_config(str(project / place / "c/linear/config.yaml"))
        assert config.shape.path != str(project / "scans/one.npy")


def test_a_file_from_elsewhere_keeps_its_absolute_path_and_that_of_an_override_is_of_the_current_folder(
    project, tmp_path, monkeypatch
):
    monkeypatch.chdir(project / "scans")
    config = load_config(str(project / "c.yaml"), overrides=["shape.path=two.npy"])
    assert config.shape.path == str(project / "scans/two.npy")
    run = tmp_path / "far/away/run"
    made([config], run)
    text = (run / "c/linear/config.yaml").read_text()
    assert f"path: {project / 'scans/two.npy'}" in text
    assert load_config(str(run / "c/linear/config.yaml")).shape == config.shape


def test_changed_contents_are_another_config_and_a_copy_is_not(project, tmp_path):
    config = load_config(str(project / "c.yaml"))
    made([config], tmp_path / "run")
    shutil.copy(project / "scans/one.npy", project / "copy.npy")
    same = load_config(str(project / "c.yaml"), overrides=[f"shape.path={project / 'copy.npy'}"])
    assert made([same], tmp_path / "run") == ["c/linear: already there"]
    np.save(project / "scans/one.npy", np.load(project / "scans/two.npy"))
    with pytest.raises(InputError, match=r"made by another config.*the contents of .*one\.npy"):
        made([config], tmp_path / "run")
    other = load_config(str(project / "c.yaml"), overrides=[f"shape.path={project / 'scans/two.npy'}"])
    with pytest.raises(InputError, match=r"changed shape\.path"):
        made([other], tmp_path / "run")


def test_home_and_variables_are_expanded_unless_a_file_is_called_so(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("SCANS", str(tmp_path / "scans"))
    assert expanded("~/a.obj", tmp_path) == str(tmp_path / "home/a.obj")
    assert expanded("${SCANS}/a.obj", tmp_path) == expanded("$SCANS/a.obj", tmp_path) == str(tmp_path / "scans/a.obj")
    (tmp_path / "$SCANS").mkdir()
    assert expanded("$SCANS", tmp_path) == "$SCANS"
    with pytest.raises(InputError, match=r"\$NO_SUCH_ONE/a\.obj: the variable NO_SUCH_ONE is not set"):
        expanded("$NO_SUCH_ONE/a.obj", tmp_path)
    with pytest.raises(InputError, match="no home folder of this user"):
        expanded("~no-such-user/a.obj", tmp_path)


def test_paths_of_the_command_line_are_expanded(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    assert path_argument("~/run") == tmp_path / "run"
    assert path_argument("run") == Path("run")
    with pytest.raises(ArgumentTypeError, match="the variable NO_SUCH_ONE is not set"):
        path_argument("$NO_SUCH_ONE/run")


def test_paths_in_a_config_are_expanded(project, monkeypatch):
    monkeypatch.setenv("HOME", str(project))
    monkeypatch.setenv("TABLES", "tables")
    (project / "e.yaml").write_text(
        SCENE.replace("scans/one.npy", "~/scans/one.npy").replace("tables/", "$TABLES/").replace("linear", "direct")
    )
    config = load_config(str(project / "e.yaml"), overrides=["shape.path=~/scans/two.npy"])
    assert config.shape.path == str(project / "scans/two.npy")
    assert config.surface.reflectance.csv == str(project / "tables/skin.csv")


def test_a_link_keeps_the_name_by_which_it_is_known(tmp_path):
    (tmp_path / "store").mkdir()
    (tmp_path / "store/0a1b.npy").write_bytes(b"")
    os.symlink(tmp_path / "store/0a1b.npy", tmp_path / "scan.npy")
    assert absolute_path("scan.npy", tmp_path) == tmp_path / "scan.npy"


def test_a_path_as_written_survives_a_copy():
    path = copy.deepcopy({"path": PathAsWritten("../a/./b.obj", "/x/a/b.obj")})["path"]
    assert (str(path), path.absolute, path.label) == ("../a/./b.obj", "/x/a/b.obj", "../a/b.obj")
