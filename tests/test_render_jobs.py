"""Many items by several processes, in parts, after an end before the end: always the same files, and nothing lost."""

import hashlib
import json
import os
import resource
import signal
import subprocess
import sys
import time
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from sharing import shared

from huesphere.configs.errors import InputError, Unfinished
from huesphere.configs.load import load_configs
from huesphere.render.jobs import Lost, each
from huesphere.render.manifest import read_manifest
from huesphere.render.plan import Shard, parse_shard
from huesphere.render.run import render_configs

BIN = Path(sys.executable).parent
SWEEP = """
shape: {kind: bowl, detail: 12}
surface: {reflectance: 0.7}
lights:
  - {kind: sphere, position: [0.5, 0.2, 3.0], radius: 0.3, spectrum: A}
  - {kind: distant, direction: [-0.4, 0.3, 1.0], spectrum: D65}
camera: {resolution: [24, 24], read_noise: 1e-3}
render: {transport: [direct, full], target_rms: 0.02}
sweep:
  shape.opening: [50, 60, 70]
  surface.reflectance: [0.9, 0.3]
"""


@pytest.fixture
def sweep(tmp_path):
    path = tmp_path / "bowls.yaml"
    path.write_text(SWEEP)
    return str(path)


def made(configs, run, **options) -> dict[str, str]:
    render_configs(configs, run, progress=lambda *_: None, log=lambda _: None, **options)
    return contents(run)


def whole(sweep, folder) -> tuple[dict[str, str], dict[str, int], list[dict]]:
    """Of the sweep rendered at one go: hashes as `contents` gives them, sizes in bytes, what is `told`."""

    def make():
        files = made(load_configs(sweep), folder / "whole")
        return files, {name: (folder / "whole" / name).stat().st_size for name in files}, told(folder / "whole")

    return shared("render-jobs-whole", make)


def contents(run: Path) -> dict[str, str]:
    """sha256 of every file but the records and the manifest, which hold times."""
    return {
        path.relative_to(run).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in run.rglob("*")
        if path.is_file() and path.name not in ("item.json", "manifest.json")
    }


def told(run: Path) -> list[dict]:
    """The manifest's items without times."""
    return [{k: v for k, v in item.items() if k != "seconds"} for item in read_manifest(run)["items"]]


def command(*arguments, cwd, **options):
    return subprocess.run(
        [BIN / "render", *map(str, arguments)], cwd=cwd, capture_output=True, text=True, timeout=170, **options
    )


def test_files_do_not_depend_on_processes_parts_or_order(sweep, tmp_path, mi):
    configs = load_configs(sweep)
    files = made(configs, tmp_path / "one")
    assert len(files) == 3 * 2 * 2 * 5
    assert made(configs, tmp_path / "two", jobs=2) == files
    assert made(configs[::-1], tmp_path / "back") == files
    for number in (2, 1, 3):
        made(configs, tmp_path / "parts", shard=Shard(number, 3))
    assert contents(tmp_path / "parts") == files
    assert told(tmp_path / "one") == told(tmp_path / "two") == told(tmp_path / "back") == told(tmp_path / "parts")
    # One item of many that share its trace, gone and made again, is as it was.
    for path in (tmp_path / "one" / configs[0].name / "full").iterdir():
        path.unlink()
    assert made(configs, tmp_path / "one") == files


def test_a_part_is_a_matter_of_the_geometry_alone():
    geometries = [f"geometry {n}" for n in range(400)]
    parts = [[g for g in geometries if Shard(number, 4).holds(g)] for number in (1, 2, 3, 4)]
    assert sorted(g for part in parts for g in part) == sorted(geometries)
    assert min(map(len, parts)) > 60


@pytest.mark.parametrize("text", ["0/2", "3/2", "1", "a/b", "1/0", "-1/2", "1/2/3"])
def test_what_is_no_part_is_told(text):
    with pytest.raises(InputError, match="I/N"):
        parse_shard(text)
    assert parse_shard("2/8") == Shard(2, 8)


def test_noise_of_each_item_is_its_own_and_follows_from_its_content(sweep):
    configs = load_configs(sweep)
    seeds = {c.name: c.camera.seed for c in configs}
    assert len(set(seeds.values())) == len(configs)
    fewer = load_configs(sweep, overrides=["sweep.shape.opening=[70,50]"])
    assert all(c.camera.seed == seeds[c.name] for c in fewer)
    other = load_configs(sweep, overrides=["camera.seed=1"])
    assert not set(seeds.values()) & {c.camera.seed for c in other}
    assert {c.camera.seed for c in load_configs(sweep, overrides=["sweep.camera.seed=[4,5]"])} == {4, 5}


# ---- ends before the end -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_killed_run_goes_on_where_it_was(sweep, tmp_path, jobs, mi):
    files, _, records = whole(sweep, tmp_path)
    done = "*/[!.]*/item.json"  # of items that are done: what is being written has a dot before its name
    killed_when(lambda: list((tmp_path / "run").glob(done)), sweep, tmp_path, jobs=jobs)
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "run").rglob("*.exr") if ".partial" not in str(path)}
    assert 0 < len(kept) < len([name for name in files if name.endswith(".exr")])
    entries = read_manifest(tmp_path / "run")["items"]  # what the manifest had no time to say, the items say
    assert len(entries) * 3 == len(kept)
    assert made(load_configs(sweep), tmp_path / "run") == files
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    assert told(tmp_path / "run") == records
    assert not list((tmp_path / "run").rglob(".*"))


@pytest.mark.slow
def test_a_run_killed_again_and_again_at_any_moment_ends_with_the_same_files(sweep, tmp_path, mi):
    """Moments are told by how many files there are, half-written ones too: of 84 in the end, with records."""
    files, _, records = whole(sweep, tmp_path)
    for count in (1, 2, 3, 5, 9, 20, 31, 44, 58, 71):
        killed_when(lambda count=count: dotted(tmp_path / "run") >= count, sweep, tmp_path, jobs=1 + count % 2)
    assert len(list((tmp_path / "run").glob("*/*/item.json"))) < 12
    assert made(load_configs(sweep), tmp_path / "run") == files
    assert told(tmp_path / "run") == records
    assert not list((tmp_path / "run").rglob(".*"))


def dotted(folder: Path) -> int:
    """How many names with a dot there are in it, though folders come and go meanwhile."""
    return sum("." in name for _, folders, files in os.walk(folder) for name in folders + files)


def killed_when(ready, sweep: str, folder: Path, *, jobs: int) -> None:
    """Render into ``folder``/run and kill it with all its workers as soon as ``ready``."""
    process = subprocess.Popen(
        [BIN / "render", "--config", sweep, "--out", "run", "--jobs", str(jobs)],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        deadline = time.monotonic() + 600  # of a machine that has much else to do
        while not ready() and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.002)
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def test_a_full_disk_ends_in_one_line_and_what_was_finished_is_kept(sweep, tmp_path, mi):
    # A limit on the size of a file refuses like a full disk. layers.exr of `full` is the largest by far.
    files, sizes, _ = whole(sweep, tmp_path)
    limit = max(size for name, size in sizes.items() if "/direct/" in name) + 1000
    done = command(
        *("--config", sweep, "--out", "run"),
        cwd=tmp_path,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
    )
    assert done.returncode == 1
    assert done.stderr.startswith("error: ")
    assert "File too large" in done.stderr
    assert done.stderr.count("\n") == 1
    assert [item["status"] for item in read_manifest(tmp_path / "run")["items"]] == ["done"]
    again = command("--config", sweep, "--out", "run", cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    assert "direct: already there" in again.stdout
    assert contents(tmp_path / "run") == files


def test_a_lost_manifest_is_made_of_the_items(sweep, tmp_path, mi):
    configs = load_configs(sweep)
    made(configs, tmp_path / "run")
    before = (tmp_path / "run/manifest.json").read_text()
    (tmp_path / "run/manifest.json").unlink()
    assert len(read_manifest(tmp_path / "run")["items"]) == 12
    made(configs, tmp_path / "run")
    assert (tmp_path / "run/manifest.json").read_text() == before


def test_a_cut_file_is_made_again(sweep, tmp_path, mi):
    configs = load_configs(sweep)[:1]
    files = made(configs, tmp_path / "run")
    truth = tmp_path / "run" / configs[0].name / "direct/truth.exr"
    truth.write_bytes(truth.read_bytes()[:-100])
    assert made(configs, tmp_path / "run") == files


# ---- failures ------------------------------------------------------------------------------------------------------


def test_an_item_that_fails_is_recorded_and_does_not_stop_the_others(sweep, tmp_path):
    swept = ["--set", "sweep.lights.1.spectrum=[D65,D66]", "--transport", "direct"]
    arguments = ["--config", sweep, *swept, "--out", "run"]
    done = command(*arguments, cwd=tmp_path)
    assert done.returncode == 1, done.stderr
    assert "6 of 12 items failed" in done.stderr
    assert "D66" in done.stderr
    assert done.stderr.count("\n") == 1
    items = read_manifest(tmp_path / "run")["items"]
    assert sorted(item["status"] for item in items) == ["done"] * 6 + ["failed"] * 6
    assert all("did you mean 'D65'" in item["error"] for item in items if item["status"] == "failed")
    stamps = {path: path.stat().st_mtime_ns for path in (tmp_path / "run").rglob("*.exr")}
    again = command(*arguments, cwd=tmp_path)
    assert again.returncode == 1
    assert "--retry-failed" in again.stderr
    retried = command(*arguments, "--retry-failed", "--jobs", "2", cwd=tmp_path)
    assert retried.returncode == 1
    assert "6 of 12" in retried.stderr
    assert stamps == {path: path.stat().st_mtime_ns for path in (tmp_path / "run").rglob("*.exr")}


def test_what_failed_for_want_of_a_file_is_made_when_it_is_there(tmp_path, mi):
    config = tmp_path / "scan.yaml"
    config.write_text(
        "shape: {kind: depth_map, path: none.npy}\nlights: [{direction: [0, 0, 1]}]\n"
        "camera: {resolution: [16, 16]}\nrender: {transport: [linear]}\n"
        "sweep: {lights.0.intensity: [1, 2], shape.path: [a.npy, b.npy]}\n"
    )
    y, x = np.mgrid[:16, :16] / 8 - 1
    np.save(tmp_path / "a.npy", 4 - x**2 - y**2)
    configs = load_configs(str(config))
    with pytest.raises(Unfinished, match=r"2 of 4 items failed.*b\.npy"):
        made(configs, tmp_path / "run")
    np.save(tmp_path / "b.npy", 4 - x**2 + y**2)
    with pytest.raises(Unfinished, match="2 of them before"):
        made(configs, tmp_path / "run")
    made(configs, tmp_path / "run", retry_failed=True)
    assert {item["status"] for item in read_manifest(tmp_path / "run")["items"]} == {"done"}
    # The same name with other contents is another config.
    np.save(tmp_path / "b.npy", 4 - x**2 + 0.5 * y**2)
    with pytest.raises(InputError, match=r"another config.*the contents of .*b\.npy"):
        made(configs, tmp_path / "run")


def test_a_changed_config_is_refused_with_the_differences_and_nothing_is_written(sweep, tmp_path, mi):
    configs = load_configs(sweep, overrides=["render.transport=[linear]"])
    made(configs, tmp_path / "run")
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "run").rglob("*")}
    changed = load_configs(sweep, overrides=["render.transport=[linear]", "camera.bits=8", "lights.1.intensity=2"])
    with pytest.raises(InputError) as error:
        made(changed, tmp_path / "run")
    assert "lights.1.intensity: 2.0 (was 1.0)" in str(error.value)
    assert "camera.bits: 8 (was None)" in str(error.value)
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "run").rglob("*")} == before
    made(changed, tmp_path / "run", overwrite=True)


# ---- workers -------------------------------------------------------------------------------------------------------


def _square_or_die(task, progress, log, folder):
    """A task that kills its worker: one that does so once, and one that always does."""
    mark = Path(folder) / str(task)
    if task == "always" or (task == "once" and not mark.exists()):
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    log(f"did {task}")
    return task


def test_a_worker_that_dies_costs_only_what_it_had_in_hand(tmp_path):
    tasks = ["a", "once", "b", "always", "c", "d"]
    lines = []
    results = dict(
        each(
            partial(_square_or_die, folder=str(tmp_path)),
            tasks,
            jobs=2,
            scheduler=None,
            progress=lambda *_: None,
            log=lines.append,
        )
    )
    assert results.pop(3) == Lost("the worker died (SIGKILL)")
    assert results == {0: "a", 1: "once", 2: "b", 4: "c", 5: "d"}
    assert sorted(lines) == ["did a", "did b", "did c", "did d", "did once"]


def _end_myself(task, progress, log):
    """A task whose worker is told to end."""
    os.kill(os.getpid(), task)
    time.sleep(30)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_worker_that_is_told_to_end_is_no_failure_of_its_task(number):
    if signal.getsignal(number) == signal.SIG_IGN:
        pytest.skip("the tests run under nohup, whose signal nobody hears")
    quiet = {"scheduler": None, "progress": lambda *_: None, "log": lambda _: None}
    results = dict(each(_end_myself, [number, number], jobs=2, **quiet))
    assert results == {n: Lost(f"the worker died ({number.name})", ended=True) for n in (0, 1)}


def test_items_of_workers_that_were_told_to_end_are_missing_and_not_failed(sweep, tmp_path, monkeypatch):
    from huesphere.render import run as run_module

    lost = Lost("the worker died (SIGTERM)", ended=True)
    monkeypatch.setattr(
        run_module, "each", lambda _, tasks, **__: (pair for pair in [(n, lost) for n in range(len(tasks))])
    )
    with pytest.raises(Unfinished, match=r"12 of 12 items are not made.*the same command goes on"):
        made(load_configs(sweep), tmp_path / "run")
    assert not list(tmp_path.rglob("item.json"))


def _say_and_work(task, progress, log):
    """A task that writes a file when it is in hand and another one at its end, and speaks meanwhile."""
    (Path(task) / f"started-{os.getpid()}").touch()
    for _ in range(100):
        time.sleep(0.1)
        log("still at it")
    (Path(task) / "finished").touch()


PARENT = """
from test_render_jobs import _say_and_work
from huesphere.render.jobs import each
if __name__ == "__main__":
    list(each(_say_and_work, [{folder!r}] * 2, jobs=2, scheduler=None, progress=lambda *_: None, log=lambda _: None))
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_workers_end_with_their_parent(tmp_path, number):
    (tmp_path / "work").mkdir()
    (tmp_path / "parent.py").write_text(PARENT.format(folder=str(tmp_path / "work")))
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parent)}
    parent = subprocess.Popen([sys.executable, tmp_path / "parent.py"], env=environment, start_new_session=True)
    try:
        deadline = time.monotonic() + 120
        while len(list((tmp_path / "work").iterdir())) < 2 and time.monotonic() < deadline:
            time.sleep(0.05)
        workers = [int(path.name.rpartition("-")[2]) for path in (tmp_path / "work").iterdir()]
        assert len(workers) == 2
        parent.send_signal(number)
        parent.wait(30)
        deadline = time.monotonic() + 5
        while any(map(_lives, workers)) and time.monotonic() < deadline:
            time.sleep(0.05)
        assert not any(map(_lives, workers))
        assert not (tmp_path / "work/finished").exists()
    finally:
        with suppress(ProcessLookupError):
            os.killpg(parent.pid, signal.SIGKILL)


def _lives(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.parametrize("place", ["exposure", "writing", "file in the way"])
def test_an_item_that_fails_late_does_not_stop_the_others(sweep, tmp_path, monkeypatch, mi, place):
    from huesphere.render import item as item_module

    configs = load_configs(sweep, overrides=["render.transport=[direct]", "sweep.shape.opening=[50]"])
    bad = configs[0].name
    if place == "file in the way":
        (tmp_path / "run").mkdir()
        (tmp_path / "run" / bad).write_text("mine")
    else:
        name = "read_out" if place == "exposure" else "write_truth"
        whole = getattr(item_module, name)
        calls = iter([True])

        def breaks_once(*arguments):
            if next(calls, False):
                raise ValueError("lam value too large")
            return whole(*arguments)

        monkeypatch.setattr(item_module, name, breaks_once)
    with pytest.raises(Unfinished, match="1 of 2 items failed"):
        made(configs, tmp_path / "run")
    statuses = {item["id"]: item["status"] for item in read_manifest(tmp_path / "run")["items"]}
    assert sorted(statuses.values()) == ["done", "failed"]
    if place == "file in the way":
        assert statuses[f"{bad}/direct"] == "failed"
        assert (tmp_path / "run" / bad).read_text() == "mine"
        (tmp_path / "run" / bad).unlink()
    made(configs, tmp_path / "run", retry_failed=True)
    assert {item["status"] for item in read_manifest(tmp_path / "run")["items"]} == {"done"}


def test_a_closed_output_is_no_failure_of_an_item(sweep, tmp_path, mi):
    def closed(line):
        raise BrokenPipeError(32, "Broken pipe")

    with pytest.raises(BrokenPipeError):
        render_configs(load_configs(sweep), tmp_path / "run", progress=lambda *_: None, log=closed)
    assert not list(tmp_path.rglob("item.json"))


def test_a_reader_that_goes_away_changes_nothing(tmp_path):
    small = ["--config", "sphere_quick", "--set", "camera.resolution=[16,16]", "--transport", "linear", "--out", "run"]
    words = " ".join(
        ["exec 3>&1;", f"'{BIN / 'render'}'", *(f"'{word}'" for word in small), "| true; echo ${PIPESTATUS[0]} >&3"]
    )
    done = subprocess.run(["bash", "-c", words], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert (done.stdout.strip(), done.stderr) == ("0", "")
    assert [item["status"] for item in read_manifest(tmp_path / "run")["items"]] == ["done"]


def test_closed_standard_streams_are_no_error(tmp_path):
    small = ["--config", "sphere_quick", "--set", "camera.resolution=[16,16]", "--transport", "linear", "--out", "run"]
    words = " ".join([f"'{BIN / 'render'}'", *(f"'{word}'" for word in small), "<&- >&-"])
    done = subprocess.run(["bash", "-c", words], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stderr) == (0, "")
    (item,) = read_manifest(tmp_path / "run")["items"]
    assert item["status"] == "done"


def test_what_a_lost_worker_had_finished_is_kept(sweep, tmp_path, monkeypatch, mi):
    from huesphere.render import run as run_module

    configs = load_configs(sweep)
    made(configs[:1], tmp_path / "run")
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "run").rglob("*.exr")}

    # A plan of before anything was there, and workers that die: as if they had finished one item each time.
    plan = run_module.make_plan(configs, tmp_path / "none", overwrite=False, retry_failed=False, shard=None)
    monkeypatch.setattr(
        run_module,
        "each",
        lambda _, tasks, **__: (pair for pair in [(n, Lost("the worker died")) for n in range(len(tasks))]),
    )
    monkeypatch.setattr(run_module, "make_plan", lambda *a, **k: plan)
    with pytest.raises(Unfinished, match=r"10 of 12 items failed.*the worker died"):
        render_configs(configs, tmp_path / "run", progress=lambda *_: None, log=lambda _: None)
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "run").rglob("*.exr")} == kept


def _refuse(task, progress, log):
    raise InputError("no", got=str(task))


def test_what_a_worker_raises_is_raised_here():
    with pytest.raises(InputError, match="no, got 1"):
        list(each(_refuse, [1, 1], jobs=2, scheduler=None, progress=lambda *_: None, log=lambda _: None))


def test_json_records_are_plain(sweep, tmp_path, mi):
    configs = load_configs(sweep)[:1]
    made(configs, tmp_path / "run")
    record = json.loads((tmp_path / "run" / configs[0].name / "full/item.json").read_text())
    assert record["status"] == "done"
    assert {entry["path"].rsplit("/")[-1] for entry in record["files"]} >= {"config.yaml", "observation.exr"}
    assert all(entry["bytes"] > 0 for entry in record["files"])
