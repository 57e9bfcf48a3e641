"""Run folders as they may come from others: nothing outside them is touched, and what is gone is told."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from fuzz_run_folders import ITEM, sound_run

from huesphere.configs.errors import InputError
from huesphere.configs.load import load_configs
from huesphere.eval.report import write_report
from huesphere.eval.score import read_items
from huesphere.recover.run import recover_run
from huesphere.render.dataset import open_run
from huesphere.render.manifest import put_items, read_manifest, remove_remains, require_all_items
from huesphere.render.plan import make_plan
from huesphere.render.verify import verified

BIN = Path(sys.executable).parent


@pytest.fixture
def run(tmp_path) -> Path:
    """A run folder with one finished item and an estimate of it."""
    shutil.copytree(sound_run(), tmp_path / "run")
    return tmp_path / "run"


@pytest.fixture
def victim(tmp_path) -> Path:
    """A folder of somebody else, with names that a run folder has too."""
    folder = tmp_path / "victim"
    for name in ("figures", "errors", "pictures", "linear"):
        (folder / name).mkdir(parents=True)
        (folder / name / "precious.txt").write_text("precious")
    (folder / "index.html").write_text("mine")
    return folder


def contents(folder: Path) -> dict[str, str]:
    return {str(path.relative_to(folder)): path.read_text() for path in folder.rglob("*") if path.is_file()}


def faults(run: Path) -> dict[str, str]:
    return {path: fault for path, fault in verified(run) if fault is not None}


@pytest.mark.parametrize("place", ["report", "report/figures", "report/errors", "report/.parts", "report/index.html"])
def test_a_link_in_the_place_of_the_report_deletes_and_writes_nothing_there(run, victim, place):
    before = contents(victim)
    (run / place).parent.mkdir(exist_ok=True)
    (run / place).symlink_to(victim / "index.html" if place.endswith("html") else victim)
    if place == "report":
        with pytest.raises(InputError, match="report: a link"):
            write_report(run)
    else:
        write_report(run)  # the link itself is replaced
        assert not (run / place).is_symlink()
    assert contents(victim) == before


@pytest.mark.parametrize("name", ["observation.exr", "truth.exr", "config.yaml", "estimates", "item.json"])
@pytest.mark.parametrize("kind", ["link", "pipe", "endless"])
def test_an_item_is_made_of_files_of_its_own(run, tmp_path, name, kind):
    path = run / ITEM / name
    path.rename(tmp_path / "kept")
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to(tmp_path / "kept" if kind == "link" else "/dev/zero")
    before = [(kept.name, kept.stat().st_mtime_ns) for kept in sorted(tmp_path.glob("kept/*"))]
    named = re.escape(name)
    with pytest.raises(InputError, match=named):
        write_report(run)
    if name != "truth.exr":  # which recovery does not read
        with pytest.raises(InputError, match=named):
            recover_run(run)
    assert [(kept.name, kept.stat().st_mtime_ns) for kept in sorted(tmp_path.glob("kept/*"))] == before


@pytest.mark.parametrize("name", ["least-squares.json", "least-squares.exr"])
def test_a_folder_in_the_place_of_an_estimate_is_one_line_and_stays(run, name):
    path = run / ITEM / "estimates" / name
    path.unlink()
    path.mkdir()
    (path / "precious.txt").write_text("precious")
    with pytest.raises(InputError, match=re.escape(name)):
        recover_run(run, overwrite=True)
    assert (path / "precious.txt").read_text() == "precious"


def test_a_link_as_a_config_or_item_folder_is_refused_before_anything_is_written(run, victim):
    before = contents(victim)
    (config,) = load_configs("sphere_quick", overrides=["render.transport=[linear]"])
    for place in ("sphere_quick", "sphere_quick/linear"):
        (run / place).parent.mkdir(exist_ok=True)
        (run / place).symlink_to(victim)
        with pytest.raises(InputError, match="a link, which is not followed"):
            make_plan([config], run, overwrite=True, retry_failed=False, shard=None)
        (run / place).unlink()
    assert contents(victim) == before


def test_tidying_follows_no_link(run, victim):
    (victim / ".linear.host.1.partial").mkdir()
    (run / "other").symlink_to(victim)
    (run / "tiny/.linear.host.1.partial").symlink_to(victim)
    before = contents(victim)
    remove_remains(run)
    put_items(run, read_manifest(run)["items"])
    assert contents(victim) == before
    assert (victim / ".linear.host.1.partial").is_dir()


def test_items_behind_a_link_are_no_items_of_the_run(run, tmp_path):
    shutil.copytree(run / "tiny", tmp_path / "elsewhere")
    (run / "more").symlink_to(tmp_path / "elsewhere")
    assert [item.id for item in open_run(run)] == [ITEM]


# ---- what is gone --------------------------------------------------------------------------------------------------


def test_a_sound_run_has_no_faults(run):
    assert not faults(run)
    assert len(list(verified(run))) == 3


@pytest.mark.parametrize("manifest", [True, False])
def test_a_cut_record_is_damage(run, manifest):
    (run / ITEM / "item.json").write_text('{"id": ')
    if not manifest:
        (run / "manifest.json").unlink()
    assert faults(run) == {f"{ITEM}/item.json": "a damaged record of an item"}


def test_an_item_folder_that_nothing_describes_is_damage_and_is_not_left_out_in_silence(run):
    shutil.copytree(run / ITEM, run / "tiny/full")
    (run / "tiny/full/item.json").unlink()
    assert faults(run) == {"tiny/full/item.json": "missing: an item's folder without a record"}
    recover_run(run)
    with pytest.raises(InputError, match=r"tiny/full/item\.json.*left out"):
        require_all_items(run)
    done = subprocess.run([BIN / "evaluate", run], capture_output=True, text=True, timeout=120)
    assert done.returncode == 2
    assert "linear" in done.stdout
    assert done.stderr.splitlines()[-1].startswith("error: ")
    assert "tiny/full/item.json" in done.stderr


@pytest.mark.parametrize("files", [[], ["truth.exr"]])
def test_a_finished_item_without_its_files_is_damage(run, files):
    manifest = json.loads((run / "manifest.json").read_text())
    (entry,) = manifest["items"]
    entry["files"] = [file for file in entry["files"] if file["path"].rpartition("/")[2] in files]
    (run / "manifest.json").write_text(json.dumps(manifest))
    (run / ITEM / "item.json").unlink()
    assert "a finished item without" in faults(run)[ITEM]


def test_a_folder_that_is_gone_is_damage(run):
    shutil.rmtree(run / ITEM)
    assert set(faults(run).values()) == {"missing"}


def test_a_file_of_another_size_is_not_read(run):
    with (run / ITEM / "truth.exr").open("r+b") as file:
        file.truncate(2**40)
    assert "size differs" in faults(run)[f"{ITEM}/truth.exr"]


# ---- what is printed -----------------------------------------------------------------------------------------------


def test_control_characters_of_a_run_reach_no_terminal(run):
    path = run / ITEM / "estimates/least-squares.json"
    hostile = "\x1b[2J\x1b]0;t\x07 [red]not markup[/x]"
    record = json.loads(path.read_text()) | {"status": "x\x1b[5my", "message": hostile, "doubts": [hostile]}
    path.write_text(json.dumps(record))
    done = subprocess.run([BIN / "evaluate", run], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert "\x1b" not in done.stdout + done.stderr
    assert "x\\x1b[5my" in done.stdout
    assert "\\x1b[2J" in done.stdout
    assert "[red]not markup[/x]" in " ".join(done.stdout.split())


@pytest.mark.parametrize("change", [{"versions": [1]}, {"items": {}}, {"items": [[]]}, {"items": [{"id": 3}]}])
def test_a_manifest_of_other_types_is_one_line(run, change):
    manifest = json.loads((run / "manifest.json").read_text())
    (run / "manifest.json").write_text(json.dumps(manifest | change))
    with pytest.raises(InputError, match=r"manifest\.json"):
        read_items(run)
