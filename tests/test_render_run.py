"""`render` from command line to disk: the contract of docs/format.md, resuming, refusing, and clear errors."""

import json
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml

from huesphere.configs.errors import InputError
from huesphere.render.cli import main
from huesphere.render.dataset import lights_seen, read_observation, read_truth
from huesphere.render.exr import read_exr
from huesphere.render.layers import read_layers
from huesphere.render.manifest import item_folder, read_manifest

BIN = Path(sys.executable).parent
SMALL = ["--config", "sphere_quick", "--set", "camera.resolution=[40,32]", "--set", "render.target_rms=0.02"]

TINY = ["--set", "camera.resolution=[4,4]"]


def render(*arguments, cwd):
    return subprocess.run([BIN / "render", *map(str, arguments)], cwd=cwd, capture_output=True, text=True, timeout=170)


@pytest.fixture
def rendered(mi, tmp_path, monkeypatch, capsys):
    """The same in ``tmp_path`` and in this process, which has loaded Mitsuba already: that takes seconds."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments) -> subprocess.CompletedProcess[str]:
        words = ["render", *map(str, arguments)]
        monkeypatch.setattr(sys, "argv", words)
        with pytest.raises(SystemExit) as end:
            main()
        return subprocess.CompletedProcess(words, end.value.code, *capsys.readouterr())

    return run


@pytest.fixture(scope="module")
def bowl_run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bowl")
    shape = ["--set", "shape={kind: bowl, opening: 75, detail: 48}"]
    done = render(*SMALL, *shape, "--transport", "linear,direct,one-bounce,full", cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder / "run"


def test_manifest_lists_every_file_with_its_hash(bowl_run):
    import hashlib

    manifest = read_manifest(bowl_run)
    assert {i["id"].split("/")[1] for i in manifest["items"]} == {"linear", "direct", "one-bounce", "full"}
    for item in manifest["items"]:
        assert item["status"] == "done"
        names = {Path(entry["path"]).name for entry in item["files"]}
        assert {"config.yaml", "observation.exr", "truth.exr", "layers.exr", "preview.png"} <= names
        for entry in item["files"]:
            assert hashlib.sha256((bowl_run / entry["path"]).read_bytes()).hexdigest() == entry["sha256"]


def test_auto_exposure_puts_the_bright_end_at_nine_tenths(bowl_run):
    seen = read_observation(bowl_run / "sphere_quick/full/observation.exr")
    assert np.percentile(seen.rgb[seen.mask], 99.9) == pytest.approx(0.9, abs=1e-3)


@pytest.mark.parametrize("transport", ["linear", "direct", "one-bounce", "full"])
def test_layers_add_to_the_picture_to_float_precision(bowl_run, transport):
    folder = bowl_run / "sphere_quick" / transport
    layers = read_layers(folder / "layers.exr")
    seen = read_observation(folder / "observation.exr")
    assert np.abs(layers.picture() - seen.rgb).max() < 1e-6
    parts = sum(layers.rgb(i, part) for i in range(3) for part in ("direct", "one_bounce", "rest"))
    assert np.abs(parts - seen.rgb).max() < 1e-6


def test_more_transport_is_more_light(bowl_run):
    # Exposure differs between items: compare light at unit exposure, through the direct layer that they share.
    def total(transport):
        layers = read_layers(bowl_run / "sphere_quick" / transport / "layers.exr")
        return layers.picture().sum() / layers.rgb(0, "direct").sum()

    assert total("direct") < total("one-bounce") < total("full")


def test_truth_counts_the_lights_that_a_pixel_sees(bowl_run):
    truth = read_truth(bowl_run / "sphere_quick/direct/truth.exr")
    seen = lights_seen(truth)[truth.mask]
    assert seen.min() >= 0
    assert seen.max() == 3
    assert truth.cast_shadow.max() > 0.9  # a deep bowl shades itself
    linear = read_truth(bowl_run / "sphere_quick/linear/truth.exr")
    assert linear.cast_shadow.max() == 0


def test_true_linear_model_explains_pixels_that_see_every_light(bowl_run):
    folder = bowl_run / "sphere_quick/direct"
    truth, seen = read_truth(folder / "truth.exr"), read_observation(folder / "observation.exr")
    lit = truth.mask & (lights_seen(truth) == 3)
    assert np.abs(seen.rgb[lit] - truth.normals[lit] @ np.array(truth.facts["F"]).T).max() < 1e-5


def test_depth_is_in_pixels_and_its_slope_is_the_normal(bowl_run):
    truth = read_truth(bowl_run / "sphere_quick/linear/truth.exr")
    inner = slice(12, 20), slice(14, 26)
    p = np.gradient(truth.depth, axis=1)[inner]
    q = -np.gradient(truth.depth, axis=0)[inner]
    n = truth.normals[inner]
    assert np.abs(p + n[..., 0] / n[..., 2]).max() < 0.02
    assert np.abs(q + n[..., 1] / n[..., 2]).max() < 0.02


def test_config_on_disk_is_the_resolved_one(bowl_run):
    config = yaml.safe_load((bowl_run / "sphere_quick/full/config.yaml").read_text())
    assert config["camera"]["resolution"] == [40, 32]
    assert config["render"]["transport"] == ["full"]


def test_a_second_call_keeps_what_is_there_and_another_config_is_refused(bowl_run, rendered, tmp_path):
    shutil.copytree(bowl_run, tmp_path / "run")
    shape = ["--set", "shape={kind: bowl, opening: 75, detail: 48}", "--transport", "linear"]
    before = (tmp_path / "run/manifest.json").read_text()
    again = rendered(*SMALL, *shape)
    assert again.returncode == 0
    assert "already there" in again.stdout
    assert (tmp_path / "run/manifest.json").read_text() == before
    other = rendered(*SMALL, *shape, "--set", "surface.reflectance=0.2")
    assert other.returncode == 2
    assert "made by another config" in other.stderr
    assert "reflectance: 0.2" in other.stderr
    forced = rendered(*SMALL, *shape, "--set", "surface.reflectance=0.2", "--overwrite")
    assert forced.returncode == 0, forced.stderr


def test_camera_noise_has_its_own_seed_and_its_stated_size(rendered, tmp_path):
    pictures = []
    for seed in (0, 1):
        noise = ["--set", "camera.read_noise=0.01", "--set", f"camera.seed={seed}", "--out", f"run{seed}"]
        assert rendered(*SMALL, *noise, "--transport", "direct").returncode == 0
        pictures.append(read_observation(tmp_path / f"run{seed}/sphere_quick/direct/observation.exr"))
    difference = (pictures[0].rgb - pictures[1].rgb)[pictures[0].mask]
    assert difference.std() == pytest.approx(0.01 * np.sqrt(2), rel=0.05)
    assert pictures[0].camera.read_noise == 0.01


def test_bits_quantise_and_clip(rendered, tmp_path):
    assert (
        rendered(*SMALL, "--set", "camera.bits=6", "--set", "camera.exposure=20", "--transport", "direct").returncode
        == 0
    )
    seen = read_observation(tmp_path / "run/sphere_quick/direct/observation.exr")
    assert np.abs(seen.rgb * 63 - np.round(seen.rgb * 63)).max() < 1e-4
    assert seen.rgb.max() <= 1
    assert seen.camera.saturation == 1.0
    assert len(seen.camera.chromaticities) == 8


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--config", "nothing.yaml"], "no such config"),
        (["--confg", "sphere_quick"], "did you mean --config"),
        ([], "--config is missing"),
        (["--config", "sphere_quick", "--set", "camera.bitz=8"], "did you mean 'bits'"),
        (["--config", "sphere_quick", "--shape", "none.npz"], "none.npz: no such depth map"),
        (["--config", "sphere_quick", "--set", "lights.0.spectrum=D66"], "did you mean 'D65'"),
        (["--config", "sphere_quick", "--set", "surface.reflectance=1.5"], "surface.reflectance"),
        (["--config", "sphere_quick", "--seed", "x"], "--seed"),
        (["--config", "sphere_quick", "--set", "camera.view_height=99", *TINY], "sees nothing of the object"),
        (["--config", "sphere_quick", "--set", "camera.view_height=99", "--transport", "full", *TINY], "sees nothing"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(tmp_path, arguments, message):
    done = render(*arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert message in done.stderr
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "run").exists()


def test_help_starts_at_once(tmp_path):
    started = time.monotonic()
    assert render("--help", cwd=tmp_path).returncode == 0
    assert time.monotonic() - started < 1.5  # 0.1 s on a quiet machine


def test_packaged_configs_are_listed(tmp_path):
    assert "mozart_5lights.yaml" in render("--list", cwd=tmp_path).stdout


# ---- reading what is damaged ----


def test_truncated_exr_is_one_line(bowl_run, tmp_path):
    whole = (bowl_run / "sphere_quick/full/observation.exr").read_bytes()
    (tmp_path / "cut.exr").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"cut\.exr"):
        read_observation(tmp_path / "cut.exr")


def test_truth_is_no_observation(bowl_run):
    with pytest.raises(InputError, match="no channel 'R'"):
        read_observation(bowl_run / "sphere_quick/full/truth.exr")


def test_foreign_files_are_no_pictures(tmp_path):
    (tmp_path / "x.exr").write_text("hello")
    with pytest.raises(InputError, match="not a readable OpenEXR"):
        read_exr(tmp_path / "x.exr")


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"format_version": 9, "items": []}', '{"format_version": 1, "items": [{}]}']
)
def test_damaged_manifest_is_one_line(tmp_path, text):
    (tmp_path / "manifest.json").write_text(text)
    with pytest.raises(InputError, match=r"manifest\.json"):
        read_manifest(tmp_path)


def test_item_ids_cannot_lead_out_of_the_run(tmp_path):
    (tmp_path / "manifest.json").write_text(
        json.dumps({"format_version": 1, "items": [{"id": "../other", "status": "done", "files": []}]})
    )
    with pytest.raises(InputError, match="leads out"):
        read_manifest(tmp_path)
    assert item_folder(tmp_path, "a/full") == tmp_path / "a/full"
