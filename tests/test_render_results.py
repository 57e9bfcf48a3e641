"""Results outside the run folder: runs that may not be written are recovered and evaluated with --out."""

import csv
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from test_eval_fabricated_run import evaluated, fabricate_run, rotation

from huesphere.configs.errors import InputError
from huesphere.eval.score import methods_on_disk, read_items
from huesphere.recover.run import recover_run
from huesphere.render.dataset import read_observation, write_observation
from huesphere.render.results import require_writable, results_root


@pytest.fixture
def run(tmp_path) -> Path:
    folder = tmp_path / "run"
    fabricate_run(folder, {"bump/linear": {"robust": rotation("x", 2.0)}}, size=32)
    return folder


def listed(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_estimates_and_report_go_elsewhere_and_the_run_is_left_alone(run, tmp_path):
    before, out = listed(run), tmp_path / "mine"
    done = evaluated(run, "--method", "least-squares", "--method", "robust", "--out", out)
    assert done.returncode == 0, done.stderr
    assert f"report: {out}/report/index.html" in done.stdout
    assert listed(run) == before
    with (out / "report/metrics.csv").open() as file:
        assert {row["method"] for row in csv.DictReader(file)} == {"least-squares", "robust"}
    assert recover_run(run, ["least-squares"], out=out) == []
    assert methods_on_disk(read_items(run, out)[0]) == ("least-squares", "robust")
    assert methods_on_disk(read_items(run)[0]) == ("robust",)
    done = evaluated(run, "--export", "npz", tmp_path / "npz", "--out", out)
    assert "estimate/least-squares/normals" in np.load(tmp_path / "npz/bump/linear.npz")


def test_results_of_another_run_are_not_mixed_with_those_there(run, tmp_path):
    other = shutil.copytree(run, tmp_path / "other")
    path = other / "bump/linear/observation.exr"
    observation = read_observation(path)
    write_observation(path, observation.__class__(observation.rgb * 0.5, observation.mask, observation.camera))
    recover_run(run, ["least-squares"], out=tmp_path / "mine")
    kept = listed(tmp_path / "mine")
    with pytest.raises(InputError, match="an estimate of another picture of this name, expected another --out"):
        recover_run(other, ["least-squares"], out=tmp_path / "mine")
    assert listed(tmp_path / "mine") == kept
    recover_run(other, ["least-squares"], out=tmp_path / "mine", overwrite=True)
    assert listed(tmp_path / "mine") != kept


def test_places_that_are_no_folder_for_results_are_refused(run, tmp_path):
    (tmp_path / "file").write_text("")
    assert results_root(run, None) == results_root(run, run) == run
    for out, message in ((tmp_path / "file", "got a file"), (shutil.copytree(run, tmp_path / "b"), "another run")):
        with pytest.raises(InputError, match=message):
            results_root(run, out)


def test_a_run_that_may_not_be_written_names_the_option_before_work_starts(run, monkeypatch):
    monkeypatch.setattr(os, "access", lambda path, mode: False)  # root may write everywhere
    with pytest.raises(InputError, match=r"run/bump/linear/estimates: may not be written, expected --out DIR"):
        recover_run(run, ["least-squares"])
    monkeypatch.undo()
    require_writable(run / "not/yet/there")
