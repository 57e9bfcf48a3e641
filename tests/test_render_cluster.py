"""A Dask cluster makes the files that one process makes, and a lost worker costs only what it had in hand."""

import os
import signal
import subprocess
import sys
import threading
import time
from functools import partial
from pathlib import Path

import pytest

from huesphere.configs.errors import InputError, Unfinished
from huesphere.configs.load import load_configs
from huesphere.eval.report import write_report
from huesphere.recover.run import recover_run
from huesphere.render.jobs import Lost, each

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.slow

BIN = Path(sys.executable).parent
SWEEP = """
shape: {kind: bowl, detail: 12}
surface: {reflectance: 0.7}
lights:
  - {kind: distant, direction: [0.5, 0.2, 1.0], spectrum: A}
  - {kind: distant, direction: [-0.4, 0.3, 1.0], spectrum: D65}
  - {kind: distant, direction: [0.1, -0.4, 1.0], spectrum: FL2}
camera: {resolution: [24, 24], read_noise: 1e-3}
render: {transport: [direct, full], target_rms: 0.02}
recover: {methods: [least-squares]}
sweep: {shape.opening: [50, 60, 70], surface.reflectance: [0.9, 0.3]}
"""


QUIET = {"jobs": 1, "progress": lambda *_: None, "log": lambda _: None}


def of_two_workers():
    return distributed.LocalCluster(n_workers=2, threads_per_worker=2, dashboard_address=None)


@pytest.fixture(scope="module")
def cluster():
    with of_two_workers() as cluster:
        yield cluster


def contents(run: Path) -> dict[str, bytes]:
    """Every file but those that hold times."""
    return {
        path.relative_to(run).as_posix(): path.read_bytes()
        for path in run.rglob("*")
        if path.suffix in (".exr", ".png", ".yaml")
    }


def test_a_cluster_makes_the_same_files(cluster, tmp_path, mi):
    from huesphere.render.run import render_configs

    (tmp_path / "bowls.yaml").write_text(SWEEP)
    configs = load_configs(str(tmp_path / "bowls.yaml"))
    quiet = {"progress": lambda *_: None, "log": lambda _: None}
    render_configs(configs, tmp_path / "here", **quiet)
    lines = []
    render_configs(
        configs,
        tmp_path / "there",
        scheduler=cluster.scheduler_address,
        progress=lambda *_: None,
        log=lines.append,
    )
    assert len(contents(tmp_path / "here")) == 3 * 2 * 2 * 5
    assert contents(tmp_path / "here") == contents(tmp_path / "there")
    assert sum(line.startswith("shape: ") for line in lines) == 3
    recover_run(tmp_path / "here")
    recover_run(tmp_path / "there", scheduler=cluster.scheduler_address)
    assert len(contents(tmp_path / "here")) == 3 * 2 * 2 * 6
    assert contents(tmp_path / "here") == contents(tmp_path / "there")
    write_report(tmp_path / "here")
    write_report(tmp_path / "there", scheduler=cluster.scheduler_address)
    assert len(contents(tmp_path / "here")) > 3 * 2 * 2 * 7  # with the error of every pixel, and figures
    assert contents(tmp_path / "here") == contents(tmp_path / "there")


def _name(task, progress, log, folder):
    """A task that kills its worker: once, or always."""
    mark = Path(folder) / str(task)
    if task == "always" or (task == "once" and not mark.exists()):
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return task


def test_a_lost_worker_costs_only_what_it_had_in_hand(tmp_path):
    tasks = ["a", "once", "b", "c"]
    work = partial(_name, folder=str(tmp_path))
    with of_two_workers() as cluster:  # one of its own: workers that died again and again may not come back
        results = dict(each(work, tasks, scheduler=cluster.scheduler_address, **QUIET))
        assert results == dict(enumerate(tasks))
        (lost,) = dict(each(work, ["always"], scheduler=cluster.scheduler_address, **QUIET)).values()
    assert isinstance(lost, Lost)


def test_a_cluster_without_a_worker_is_one_line(monkeypatch):
    monkeypatch.setattr("huesphere.render.cluster.SECONDS_WITHOUT_WORKER", 0.5)
    empty = distributed.LocalCluster(n_workers=0, dashboard_address=None, processes=False, protocol="tcp")
    with empty as cluster, pytest.raises(InputError, match=r"workers, got none within 0\.5 s, expected at least one"):
        list(each(_sleep, [0.0], scheduler=cluster.scheduler_address, **QUIET))


def test_work_ends_when_the_last_worker_is_gone_for_good(monkeypatch):
    monkeypatch.setattr("huesphere.render.cluster.SECONDS_WITHOUT_WORKER", 2.0)
    one = distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None)
    with one as cluster:
        results = each(_sleep, [0.0, 30.0], scheduler=cluster.scheduler_address, **QUIET)
        assert next(results) == (0, None)
        cluster.scale(0)
        with pytest.raises(Unfinished, match="has no worker left: what was finished is kept"):
            next(results)


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "somewhere", "", "tcp://a:99999"])
def test_where_nobody_answers_is_told_in_one_line(tmp_path, address):
    done = subprocess.run(
        [BIN / "render", "--config", "sphere_quick", "--scheduler", address],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 2
    assert done.stderr.startswith("error: --scheduler")
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "run").exists()


def test_a_worker_of_another_version_is_one_line(cluster, monkeypatch):
    from huesphere.render import cluster as module

    found = module._versions()
    for package, version in (("huesphere", "0.0.1"), ("python", "2.7"), ("mitsuba", "3.9.0")):
        monkeypatch.setattr(module, "_versions", lambda other={package: version}: found | other)
        with pytest.raises(InputError, match=f"another version of {package}, got .*, expected {version}"):
            list(each(_sleep, [0.0], scheduler=cluster.scheduler_address, **QUIET))


SCHEDULER = """
import asyncio
import sys

from distributed import Scheduler

async def main():
    async with Scheduler(host="127.0.0.1", port=0, dashboard_address=":0") as scheduler:
        print(scheduler.address, flush=True)
        await scheduler.finished()

asyncio.run(main())
"""


def test_a_scheduler_that_is_killed_is_one_line_and_nothing_is_lost(tmp_path):
    (tmp_path / "bowls.yaml").write_text(SWEEP)
    python = Path(sys.executable)
    scheduler = subprocess.Popen(
        [python, "-c", SCHEDULER], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    address = scheduler.stdout.readline().strip()
    options = ["--nthreads", "1", "--no-nanny", "--no-dashboard"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    worker = subprocess.Popen([python, "-m", "distributed.cli.dask_worker", address, *options], **quiet)
    words = [BIN / "render", "--config", "bowls.yaml", "--out", "run"]
    try:
        command = subprocess.Popen(
            [*words, "--scheduler", address], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        deadline = time.monotonic() + 120
        while not list(tmp_path.glob("run/*/[!.]*/item.json")) and time.monotonic() < deadline:
            time.sleep(0.05)
        scheduler.kill()
        _, err = command.communicate(timeout=120)
    finally:
        for process in (scheduler, worker):
            process.kill()
            process.wait()
    assert command.returncode == 1
    assert "is gone: what was finished is kept" in err
    assert err.count("\n") == 1 + err.count(" s left\n")
    assert '"failed"' not in "".join(path.read_text() for path in tmp_path.glob("run/*/[!.]*/item.json"))
    again = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=170)
    assert again.returncode == 0, again.stderr


def test_an_interrupt_ends_work_on_a_cluster(cluster):
    before, interrupted = set(cluster.scheduler.tasks), []

    def at_work():
        new = [task for key, task in list(cluster.scheduler.tasks.items()) if key not in before]
        return any(task.state == "processing" for task in new)

    def interrupt():  # once the work is there: before, on a busy machine, the client is still being made
        while not at_work():
            time.sleep(0.05)
        time.sleep(0.5)
        interrupted.append(time.monotonic())
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt, daemon=True).start()
    with pytest.raises(KeyboardInterrupt):
        list(each(_sleep, [20.0] * 4, scheduler=cluster.scheduler_address, **QUIET))
    assert time.monotonic() - interrupted[0] < 10


def _sleep(task, progress, log):
    time.sleep(task)
