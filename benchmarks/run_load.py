"""A thousand items from end to end: 20 geometries × 50 lightings at 128². Minutes on two cores, memory flat.

python benchmarks/run_load.py [--share 1] [--jobs 2] [--cluster-share 0.1] [--workers 4] [--record]

Renders, recovers and evaluates the sweep by the commands and takes seconds, processor time and memory of each; then
does a share of it again by one process and on a Dask cluster of `--workers` on this machine, and compares every file.
A share of 0 leaves that part out.
"""

import argparse
import hashlib
import os
import resource
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml
from record import record

BIN = Path(sys.executable).parent
GEOMETRIES, LIGHTINGS = 20, 50
EVERY = 0.5  # seconds between looks at the memory

Say = Callable[..., None]


class Look(NamedTuple):
    """At the processes of a command."""

    processes: int
    used: float  # MiB that they share with nobody


def sweep(share: float) -> dict:
    """The config: geometries are drawn, each under the same list of lightings, whose spectra and strengths differ."""
    rng = np.random.default_rng(0)
    spectra = ["A", "D50", "D65", "FL2", "FL11", "B", "C"]
    directions = [[0.5, 0.2, 1.0], [-0.5, 0.2, 1.0], [0.0, -0.5, 1.0], [0.3, 0.5, 1.0]]
    lightings = [
        [
            {"direction": d, "spectrum": str(rng.choice(spectra)), "intensity": round(float(rng.uniform(0.3, 3)), 3)}
            for d in directions
        ]
        for _ in range(max(1, round(LIGHTINGS * share**0.5)))
    ]
    return {
        "shape": {"kind": "bowl", "detail": 64},
        "surface": {"reflectance": "light skin"},
        "lights": lightings[0],
        "camera": {"resolution": [128, 128], "read_noise": 1e-3},
        "render": {"transport": ["full"], "target_rms": 2e-3},
        "recover": {"methods": ["weak-integrability"]},
        "sweep": {
            "count": max(1, round(GEOMETRIES * share**0.5)),
            "seed": 1,
            "shape.opening": {"uniform": [40, 85]},
            "lights": lightings,
        },
    }


def measured(*command: object) -> tuple[float, float, list[Look]]:
    """(seconds, processor seconds, looks at the memory) of one command that must succeed, its children included."""
    import psutil

    memory: list[Look] = []
    started, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
    process = subprocess.Popen([str(c) for c in command], stdout=subprocess.DEVNULL)
    ended = threading.Event()

    def watch() -> None:
        one = psutil.Process(process.pid)
        while not ended.wait(EVERY):
            try:
                all_of_it = [one, *one.children(recursive=True)]
                used = sum(process.memory_full_info().uss for process in all_of_it)
            except psutil.Error:
                continue
            memory.append(Look(len(all_of_it), used / 2**20))

    watcher = threading.Thread(target=watch)
    watcher.start()
    code = process.wait()
    ended.set()
    watcher.join()
    if code:
        sys.exit(f"{' '.join(map(str, command))}: exit code {code}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    busy = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return time.monotonic() - started, busy, memory


def growth(memory: list[Look]) -> float:
    """Of the median of the last fifth over that of the second, while as many processes work as most of the time.

    The first fifth loads and compiles; before and after that many work the stages are others, not the run.
    """
    usual = Counter(look.processes for look in memory).most_common(1)[0][0]
    used = [look.used for look in memory if look.processes == usual]
    fifth = max(1, len(used) // 5)
    return float(np.median(used[-fifth:]) / np.median(used[fifth : 2 * fifth]) - 1)


def contents(run: Path) -> dict[str, str]:
    """sha256 of each picture, estimate and config; JSON and pages hold times."""
    return {
        path.relative_to(run).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in run.rglob("*")
        if path.suffix in (".exr", ".png", ".yaml")
    }


def prepared(folder: Path, share: float) -> tuple[Path, int]:
    """The sweep's file in ``folder``, and how many items it has."""
    config = sweep(share)
    (folder / "load.yaml").write_text(yaml.safe_dump(config))
    return folder / "load.yaml", config["sweep"]["count"] * len(config["sweep"]["lights"])


def stages(config: Path, run: Path, *how: object) -> list[tuple[object, ...]]:
    """The three commands that take ``config`` from end to end."""
    return [
        ("render", "--config", config, "--out", run, *how),
        ("recover", run, *how),
        ("evaluate", run, *how),
    ]


def busy_machine() -> str:
    return f"load of the machine {os.getloadavg()[0]:.1f}"


def end_to_end(folder: Path, share: float, jobs: int, say: Say) -> None:
    config, items = prepared(folder, share)
    total = total_busy = 0.0
    for what, *command in stages(config, folder / "run", "--jobs", jobs):
        seconds, busy, memory = measured(BIN / str(what), *command)
        total, total_busy = total + seconds, total_busy + busy
        case = f"load: {what}, {items} items of 128², {jobs} jobs"
        say(case, seconds, "s", note=f"{busy:.0f} s of processor time, {busy / items:.2f} s an item; {busy_machine()}")
        say(
            f"{case}: memory at its most",
            max(look.used for look in memory),
            "MiB",
            note=f"grows by {growth(memory):+.1%}",
        )
    note = f"render, recover, evaluate; {total_busy:.0f} s of processor time; {busy_machine()}"
    say(f"load: end to end, {items} items of 128²", total, "s", note=note)
    pages = [path.stat().st_size for path in (folder / "run/report").rglob("*.html")]
    say(f"load: largest page of the report, {items} items", max(pages) / 1e6, "MB", note=f"{len(pages)} pages")


def on_a_cluster(folder: Path, share: float, workers: int, say: Say) -> bool:
    """Whether the files are those that one process makes."""
    from distributed import LocalCluster

    config, items = prepared(folder, share)
    alone = sum(measured(BIN / str(what), *command)[0] for what, *command in stages(config, folder / "alone"))
    say(f"load: end to end, {items} items of 128², one process", alone, "s", note=busy_machine())
    with LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster:
        how = stages(config, folder / "cluster", "--scheduler", cluster.scheduler_address)
        seconds = sum(measured(BIN / str(what), *command)[0] for what, *command in how)
    same = contents(folder / "alone") == contents(folder / "cluster")
    note = (
        f"{len(contents(folder / 'alone'))} files {'identical to' if same else 'DIFFERENT from'} those of one process; "
    )
    note += f"{alone / seconds:.2f} times as fast on {os.cpu_count()} cores; {busy_machine()}"
    say(f"load: end to end, {items} items of 128², {workers} Dask workers", seconds, "s", note=note)
    return same


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--share", type=float, default=1.0, help="of the thousand items, from end to end")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument(
        "--cluster-share", type=float, default=0.1, help="of the thousand items, by one and by a cluster"
    )
    parser.add_argument("--workers", type=int, default=4)
    parser.add_argument("--record", action="store_true", help="lines in results.tsv")
    arguments = parser.parse_args()
    say: Say = record if arguments.record else lambda case, value, unit="", **more: print(case, value, unit, more)
    if arguments.share > 0:
        with tempfile.TemporaryDirectory() as name:
            end_to_end(Path(name), arguments.share, arguments.jobs, say)
    if arguments.cluster_share > 0:
        with tempfile.TemporaryDirectory() as name:
            if not on_a_cluster(Path(name), arguments.cluster_share, arguments.workers, say):
                sys.exit(1)


if __name__ == "__main__":
    main()
