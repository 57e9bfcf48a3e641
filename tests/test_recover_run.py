"""The command: run folders, single pictures, what is left alone, and how it ends."""

import json
import resource
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_recover_io_picture import write_png
from test_recover_methods import relief

from huesphere.configs.errors import InputError
from huesphere.recover import cli
from huesphere.recover.depth.integration import depth_from_normals
from huesphere.recover.io.estimate import read_estimate
from huesphere.recover.methods.table import METHODS
from huesphere.recover.one_picture import recover_picture
from huesphere.recover.run import recover_run
from huesphere.render.dataset import CameraInfo, write_observation


@pytest.fixture
def run(tmp_path) -> Path:
    """A run folder with one finished item, one that failed, and a config that names one method."""
    run = tmp_path / "run"
    items = []
    for name, status in (("a/linear", "done"), ("a/full", "failed")):
        folder = run / name
        folder.mkdir(parents=True)
        items.append({"id": name, "status": status, "seed": 0, "seconds": 0.0, "files": []})
        if status == "done":
            write_observation(folder / "observation.exr", relief(64)[0])
            (folder / "config.yaml").write_text("recover: {methods: [least-squares]}\n")
    (run / "manifest.json").write_text(json.dumps({"format_version": 1, "versions": {}, "items": items}))
    return run


def command(monkeypatch, capsys, *words: str) -> tuple[int, str, str]:
    monkeypatch.setattr(sys, "argv", ["recover", *words])
    with pytest.raises(SystemExit) as end:
        cli.main()
    said = capsys.readouterr()
    return int(end.value.code or 0), said.out, said.err


def test_a_run_folder_gets_the_methods_of_its_config(run):
    made = recover_run(run)
    assert [(item, e.method, e.status in ("ok", "uncertain")) for item, e in made] == [
        ("a/linear", "least-squares", True)
    ]
    estimate, _ = read_estimate(run / "a/linear/estimates", "least-squares")
    assert estimate.seconds > 0
    assert estimate.valid.any()


def test_estimates_are_made_once_and_again_when_the_picture_changes(run):
    assert len(recover_run(run, ["drew-kontsevich"])) == 1
    assert recover_run(run, ["drew-kontsevich"]) == []
    assert len(recover_run(run, ["drew-kontsevich"], overwrite=True)) == 1
    observation = relief(64)[0]
    write_observation(run / "a/linear/observation.exr", replace(observation, rgb=observation.rgb * np.float32(0.5)))
    assert len(recover_run(run, ["drew-kontsevich"])) == 1


def test_several_processes_make_the_same_and_a_bad_picture_does_not_stop_the_others(run):
    manifest = json.loads((run / "manifest.json").read_text())
    for name in ("c/linear", "d/linear", "e/linear"):
        shutil.copytree(run / "a/linear", run / name)
        manifest["items"].append(manifest["items"][0] | {"id": name})
    (run / "manifest.json").write_text(json.dumps(manifest))
    (run / "c/linear/observation.exr").write_text("no picture")
    with pytest.raises(InputError, match=r"c/linear/observation\.exr: not a readable"):
        recover_run(run, jobs=2)
    one, other = (read_estimate(run / name / "estimates", "least-squares")[0] for name in ("a/linear", "e/linear"))
    assert np.array_equal(one.normals, other.normals, equal_nan=True)
    assert one.verdict != "failed"


def test_a_failed_method_is_written_as_failed(run):
    grey = relief(64)[0]
    write_observation(run / "a/linear/observation.exr", replace(grey, rgb=grey.rgb[..., :1].repeat(3, axis=-1)))
    recover_run(run)
    estimate, _ = read_estimate(run / "a/linear/estimates", "least-squares")
    assert estimate.status == "rank-deficient-colours"
    assert not estimate.valid.any()
    assert np.isnan(estimate.normals).all()


def test_the_command_ends_with_0_and_says_what_it_did(run, monkeypatch, capsys):
    code, out, _ = command(monkeypatch, capsys, str(run), "--method", "weak-integrability")
    assert code == 0
    assert "a/linear  weak-integrability  ok" in out
    code, out, _ = command(monkeypatch, capsys, str(run), "--method", "weak-integrability")
    assert code == 0
    assert "nothing to do" in out


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["{run}", "--method", "weak-integrabilty"], "did you mean"),
        (["{run}", "--region", "0,0,5,5"], "--region is for a picture"),
        (["{run}/nowhere"], "no such run folder or picture"),
        (["{run}/a"], "no manifest.json"),
        (["{run}", "--region", "0,0,5"], "four whole numbers"),
        (["{run}", "--overwrit3"], "did you mean --overwrite"),
        (["{run}", "--dpeth"], "did you mean --depth"),
        (["{run}", "--depth", "coupled"], "coupled"),
        (["{run}/a/perspective.exr", "--depth"], "a picture in perspective"),
        ([], "source|RUN_DIR"),
    ],
)
def test_bad_input_is_one_line_and_2(run, monkeypatch, capsys, words, complaint):
    camera = CameraInfo(projection="perspective")
    write_observation(run / "a/perspective.exr", replace(relief(64)[0], camera=camera))
    code, _, err = command(monkeypatch, capsys, *(w.replace("{run}", str(run)) for w in words))
    assert code == 2
    assert err.count("\n") == 1
    assert any(c in err for c in complaint.split("|"))


def test_depth_is_added_to_estimates_that_are_there_and_is_the_surface(run, monkeypatch, capsys):
    recover_run(run, ["weak-integrability"])
    before, _ = read_estimate(run / "a/linear/estimates", "weak-integrability")
    code, out, _ = command(monkeypatch, capsys, str(run), "--method", "weak-integrability", "--depth")
    assert code == 0
    assert ", depth, " in " ".join(out.split())
    estimate, _ = read_estimate(run / "a/linear/estimates", "weak-integrability")
    assert estimate.seconds == before.seconds  # not made again
    assert np.array_equal(estimate.normals, before.normals, equal_nan=True)
    observation, normals, _ = relief(64)
    truth = depth_from_normals(normals, observation.mask, observation.mask)
    assert np.array_equal(np.isfinite(estimate.depth), observation.mask)
    assert np.nanstd(estimate.depth - truth) < 0.02 * np.nanstd(truth)
    assert recover_run(run, ["weak-integrability"], depth=True) == []
    assert recover_run(run, ["weak-integrability"]) == []


def test_a_failed_estimate_has_no_depth_and_is_not_made_again_for_it(run):
    grey = relief(64)[0]
    write_observation(run / "a/linear/observation.exr", replace(grey, rgb=grey.rgb[..., :1].repeat(3, axis=-1)))
    method = recover_run(run, depth=True)[0][1].method
    assert read_estimate(run / "a/linear/estimates", method)[0].depth is None
    assert recover_run(run, depth=True) == []


def test_depth_of_a_run_in_perspective_needs_its_focal_length(run):
    camera = CameraInfo(projection="perspective")
    write_observation(run / "a/linear/observation.exr", replace(relief(64)[0], camera=camera))
    with pytest.raises(InputError, match=r"camera\.focal_px"):
        recover_run(run, depth=True)
    camera = replace(camera, focal_px=900.0)
    write_observation(run / "a/linear/observation.exr", replace(relief(64)[0], camera=camera))
    assert ", depth, " in recover_run(run, ["weak-integrability"], depth=True)[0][1].line


def test_a_picture_is_recovered_beside_the_caller(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    observation, _, _ = relief(64)
    write_png(tmp_path / "photo.png", np.round(np.clip(observation.rgb, 0, 1) * 65535).astype(np.uint16))
    write_png(tmp_path / "mask.png", (observation.mask * 255).astype(np.uint8)[..., None])
    words = ("photo.png", "--mask", "mask.png", "--encoding", "linear", "--depth")
    code, out, _ = command(monkeypatch, capsys, *words)
    assert code == 0
    assert "written: photo-huesphere" in out
    assert "every pixel" in out  # the steps of auto, the default
    assert max(map(len, out.splitlines())) <= 80
    estimate, _ = read_estimate(tmp_path / "photo-huesphere/estimates", "auto")
    assert estimate.status == "ok"
    assert np.isfinite(estimate.depth[observation.mask]).all()
    code, _, err = command(monkeypatch, capsys, *words)
    assert code == 2
    assert "--overwrite" in err


def test_an_unknown_method_is_refused_before_anything_is_written(tmp_path):
    write_png(tmp_path / "a.png", np.zeros((8, 8, 3), np.uint8))
    with pytest.raises(InputError, match="no such method"):
        recover_picture(tmp_path / "a.png", ["nonsense"], out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_help_starts_at_once_and_names_every_method(monkeypatch, capsys):
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-m", "huesphere.recover.cli", "--help"], capture_output=True, text=True, check=True
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    busy = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    assert busy < 0.8  # seconds of processor time, 0.1 on an idle machine; numba alone would take half a second
    assert all(name in done.stdout for name in METHODS)
    modules = "import sys, huesphere.recover.cli; sys.exit(bool({'numpy', 'scipy', 'numba'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", modules], check=False).returncode == 0
