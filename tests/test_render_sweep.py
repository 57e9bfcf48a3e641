"""Sweeps: which items they make, that those of one geometry are traced once, and that this changes no picture."""

import json
from pathlib import Path

import numpy as np
import pytest

from huesphere.configs.errors import InputError
from huesphere.configs.load import load_config, load_configs
from huesphere.render import group as group_module
from huesphere.render.dataset import read_observation
from huesphere.render.relighting import geometry_of
from huesphere.render.run import render_configs

BASE = """
shape: {kind: bowl, detail: 12}
lights:
  - {kind: distant, direction: [0.5, 0.2, 1.0], spectrum: A}
  - {kind: distant, direction: [-0.4, 0.3, 1.0], spectrum: D65}
camera: {resolution: [24, 24]}
render: {transport: [full], target_rms: 0.01}
"""


@pytest.fixture
def config_file(tmp_path):
    def write(sweep: str) -> str:
        path = tmp_path / "bowl.yaml"
        path.write_text(BASE + sweep)
        return str(path)

    return write


def rendered(configs, folder, monkeypatch=None) -> int:
    """Renders ``configs`` and returns how often geometry was traced."""
    traced = []
    if monkeypatch is not None:
        whole = group_module.trace_alike
        monkeypatch.setattr(
            group_module, "trace_alike", lambda scenes, *a, **k: traced.append(len(scenes)) or whole(scenes, *a, **k)
        )
    render_configs(configs, folder, engine="auto", overwrite=False, progress=lambda *_: None, log=lambda _: None)
    return len(traced)


def test_all_combinations_with_names_that_tell(config_file):
    path = config_file("sweep:\n  lights.0.intensity: [0.5, 2]\n  surface.reflectance: [light skin, 0.8]\n")
    configs = load_configs(path)
    assert [c.name for c in configs] == [
        "bowl-intensity_0.5-reflectance_light-skin",
        "bowl-intensity_0.5-reflectance_0.8",
        "bowl-intensity_2-reflectance_light-skin",
        "bowl-intensity_2-reflectance_0.8",
    ]
    assert [c.lights[0].intensity for c in configs] == [0.5, 0.5, 2, 2]
    assert configs[1].surface.reflectance == 0.8
    # what is set on the command line is no longer swept, and a sweep may come from there
    assert len(load_configs(path, overrides=["surface.reflectance=0.3"])) == 2
    assert len(load_configs(path, overrides=["sweep.camera.seed=[1,2,3]"])) == 12


def test_values_without_a_short_name_and_long_names_are_numbered(config_file):
    path = config_file("sweep:\n  lights.0.direction: [[1, 0, 1], [0, 1, 1]]\n  lights.1.direction: [[1, 1, 1]]\n")
    assert [c.name for c in load_configs(path)] == [
        "bowl-lights.0.direction_0-lights.1.direction_0",
        "bowl-lights.0.direction_1-lights.1.direction_0",
    ]
    path = config_file(f"sweep: {{camera.sensitivity: [{'x' * 90}, b]}}\n")
    assert [c.name for c in load_configs(path)] == ["bowl-00000", "bowl-00001"]


@pytest.mark.parametrize(
    ("sweep", "message"),
    [
        ("sweep: [1, 2]\n", "sweep, got list"),
        ("sweep: {camera.seed: 3}\n", "sweep.camera.seed"),
        ("sweep: {camera.seed: []}\n", "sweep.camera.seed"),
        ("sweep: {lights.7.intensity: [1]}\n", "index below 2"),
        ("sweep: {camera.sede: [1]}\n", "did you mean 'seed'"),
        ("sweep: {lights.0.intensity: [1, -1]}\n", "sweep.lights.0.intensity"),
        ("sweep: {camera.read_noise: {uniform: [0, 1]}}\n", "sweep.count is missing"),
        ("sweep: {count: 3, camera.read_noise: [0, 1]}\n", "sweep.count, got 3"),
        ("sweep: {count: 0, camera.read_noise: {uniform: [0, 1]}}\n", "sweep.count, got 0"),
        ("sweep: {count: 2, camera.read_noise: {unifrom: [0, 1]}}\n", "one of choice, uniform"),
        ("sweep: {count: 2, camera.read_noise: {uniform: [1, 0]}}\n", "sweep.camera.read_noise.uniform"),
        ("sweep: {count: 2, camera.read_noise: {log_uniform: [0, 1]}}\n", "must be positive"),
        ("sweep: {count: 2, camera.read_noise: {uniform: [2, 3]}}\n", "sweep.camera.read_noise"),
        ("sweep: {count: 2, camera.read_noise: {normal: [0, 1, 90, 91]}}\n", "almost no draw"),
        ("sweep: {count: 200000, camera.read_noise: {uniform: [0, 1]}}\n", "at most 100000"),
    ],
)
def test_what_is_no_sweep_is_told_in_one_line(config_file, sweep, message):
    with pytest.raises(InputError) as told:
        load_configs(config_file(sweep))
    assert message in str(told.value)
    assert "\n" not in str(told.value)


RANDOM = """sweep:
  count: 400
  seed: 5
  lights.0.direction: {cone: 40}
  lights.1.intensity: {log_uniform: [0.1, 10]}
  surface.reflectance: {choice: [0.3, light skin]}
  camera.read_noise: {normal: [1e-2, 5e-3, 0, 2e-2]}
  render.seed: {integer: [3, 5]}
"""


def test_draws_have_the_distributions_that_were_asked_for(config_file):
    configs = load_configs(config_file(RANDOM))
    assert [c.name for c in configs[:2]] == ["bowl-00000", "bowl-00001"]
    z = np.array([c.lights[0].direction for c in configs])[:, 2]
    assert z.min() >= np.cos(np.radians(40)) - 1e-5
    # Uniform over the cap: z is uniform; mean and spread of a uniform variable, five standard errors of the mean.
    low = np.cos(np.radians(40))
    assert z.mean() == pytest.approx((1 + low) / 2, abs=5 * (1 - low) / np.sqrt(12 * 400))
    logs = np.log10([c.lights[1].intensity for c in configs])
    assert np.abs(logs).max() <= 1
    assert logs.mean() == pytest.approx(0, abs=5 * 2 / np.sqrt(12 * 400))
    assert logs.std() == pytest.approx(2 / np.sqrt(12), rel=0.1)
    assert {c.surface.reflectance for c in configs} == {0.3, "light skin"}
    assert {c.render.seed for c in configs} == {3, 4, 5}
    noise = np.array([c.camera.read_noise for c in configs])
    assert 0 <= noise.min() <= noise.max() <= 2e-2
    assert len({c.camera.seed for c in configs}) == 400


def test_a_greater_count_adds_items_and_changes_none(config_file):
    few = load_configs(config_file(RANDOM), overrides=["sweep.count=7"])
    many = load_configs(config_file(RANDOM), overrides=["sweep.count=11"])
    assert many[:7] == few
    assert load_configs(config_file(RANDOM), overrides=["sweep.count=7", "sweep.seed=6"])[0] != few[0]


def test_lists_and_draws_together_share_their_draws(config_file):
    path = config_file(
        "sweep: {count: 3, surface.reflectance: [0.2, 0.8], lights.0.direction: {cone: 40},"
        " lights.1.intensity: [1, 2]}\n"
    )
    configs = load_configs(path)
    assert len(configs) == 12
    assert configs[0].name == "bowl-reflectance_0.2-intensity_1-00000"
    assert len({geometry_of(config) for config in configs}) == 3


def test_one_item_is_asked_for_where_one_is_meant(config_file):
    with pytest.raises(InputError, match="4 items"):
        load_config(config_file("sweep: {camera.seed: [1, 2, 3, 4]}\n"))


def test_what_is_traced_and_what_only_relit(config_file):
    path = config_file("")
    base = geometry_of(load_config(path))

    def same(*changes):
        return geometry_of(load_config(path, overrides=list(changes))) == base

    for free in ("lights.0.spectrum=D50", "lights.1.intensity=0", "surface.reflectance=0.2", "camera.read_noise=0.1"):
        assert same(free), free
    assert same("camera.sensitivity=CIE 1931", "camera.exposure=2", "name=other", "render.transport=[linear]")
    assert same("camera.bits=8", "camera.full_well=1000", "camera.encoding=srgb", "camera.seed=3")
    for fixed in ("lights.0.direction=[0,0,1]", "camera.resolution=[8,8]", "shape.detail=13", "render.seed=1"):
        assert not same(fixed), fixed
    assert not same("camera.projection=perspective")
    assert not same("camera.pixel=area")
    checker = "surface.checker={reflectance: 0.5}"
    two = geometry_of(load_config(path, overrides=[checker]))
    assert two != geometry_of(load_config(path, overrides=[checker, "surface.reflectance=0.2"]))
    skies = [geometry_of(load_config(path, overrides=[f"lights=[{{kind: sky, {g}}}]"])) for g in ("", "ground: 0.5")]
    assert skies[0] != skies[1]  # a ground is one source more
    assert geometry_of(load_config(path, overrides=["lights=[{kind: sky, ground: A, zenith: D50}]"])) == skies[1]


def test_a_sweep_is_traced_once_and_shows_what_each_item_would_alone(config_file, tmp_path, monkeypatch, mi):
    path = config_file("sweep:\n  lights.0.spectrum: [A, FL2]\n  surface.reflectance: [0.9, 0.3]\n")
    configs = load_configs(path)
    assert rendered(configs, tmp_path / "sweep", monkeypatch) == 1
    for config in configs:
        rendered([config], tmp_path / "alone")
        item = f"{config.name}/full/observation.exr"
        together, alone = (read_observation(tmp_path / run / item) for run in ("sweep", "alone"))
        seen = alone.mask
        # Neither error exceeds the target; a brighter member of the group asks for as many rays or more.
        error = (together.rgb - alone.rgb)[seen] / alone.rgb[seen].mean(axis=0)
        assert np.sqrt(np.mean(error**2)) < 0.015
    items = json.loads((tmp_path / "sweep/manifest.json").read_text())["items"]
    assert max(item["relative_rms"] for item in items) <= 0.01
    # Different light and surface: different pictures.
    first, last = (read_observation(tmp_path / "sweep" / f"{c.name}/full/observation.exr") for c in configs[::3])
    assert np.abs(first.rgb - last.rgb)[first.mask].mean() > 0.01


def test_geometries_are_traced_one_by_one_and_what_is_there_is_kept(config_file, tmp_path, monkeypatch, mi):
    configs = load_configs(config_file("sweep: {shape.detail: [10, 12], camera.seed: [0, 1]}\n"))
    assert rendered(configs, tmp_path / "run", monkeypatch) == 2
    made = {p: p.stat().st_mtime_ns for p in (tmp_path / "run").rglob("*.exr")}
    assert len(made) == 4 * 3
    assert rendered(configs, tmp_path / "run", monkeypatch) == 0
    assert made == {p: p.stat().st_mtime_ns for p in (tmp_path / "run").rglob("*.exr")}
    assert not list((tmp_path / "run").rglob(".*"))


def test_the_sweep_of_the_docs_is_one(tmp_path):
    text = (Path(__file__).parent.parent / "docs/jobs.md").read_text(encoding="utf-8")
    (tmp_path / "bowls.yaml").write_text(text.split("```yaml\n")[1].split("```")[0])
    configs = load_configs(str(tmp_path / "bowls.yaml"))
    assert len(configs) == 600
    assert len({geometry_of(config) for config in configs}) == 200
