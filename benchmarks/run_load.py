"""A thousand items from end to end: 20 geometries × 50 lightings at 128². Minutes on two cores, memory flat.

python benchmarks/run_load.py [--share 0.1] [--jobs 2] [--workers 4] [--record]

Renders, recovers and evaluates the sweep by the commands and takes seconds, processor time and memory of each; then
renders it once more by one process and on a Dask cluster of `--workers` on this machine, and compares every file.
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
from pathlib import Path

import numpy as np
import yaml
from record import record

BIN = Path(sys.executable).parent
GEOMETRIES, LIGHTINGS = 20, 50
EVERY = 0.25  # seconds between looks at the memory


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


def measured(*command: object) -> tuple[float, float, list[float]]:
    """(seconds, processor seconds, MiB at each look) of one command that must succeed, its children included."""
    import psutil

    memory: list[float] = []
    started, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
    process = subprocess.Popen([str(c) for c in command], stdout=subprocess.DEVNULL)
    ended = threading.Event()

    def watch() -> None:
        one = psutil.Process(process.pid)
        while not ended.wait(EVERY):
            total = 0
            try:
                for each in [one, *one.children(recursive=True)]:
                    total += each.memory_full_info().uss
            except psutil.Error:
                continue
            memory.append(total / 2**20)

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


def growth(memory: list[float]) -> float:
    """Of the median of the last fifth over that of the second fifth, when all is loaded and compiled."""
    fifth = max(1, len(memory) // 5)
    return float(np.median(memory[-fifth - 1 : -1]) / np.median(memory[fifth : 2 * fifth]) - 1)


def contents(run: Path) -> dict[str, str]:
    """sha256 of each file of the data; records and manifest hold times."""
    return {
        path.relative_to(run).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in run.glob("*/*/*")
        if path.is_file() and path.name != "item.json"
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--share", type=float, default=1.0, help="of the thousand items")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--workers", type=int, default=4)
    parser.add_argument("--record", action="store_true", help="lines in results.tsv")
    arguments = parser.parse_args()
    say = record if arguments.record else lambda case, value, unit="", **more: print(case, value, unit, more)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        config = sweep(arguments.share)
        (folder / "load.yaml").write_text(yaml.safe_dump(config))
        items = config["sweep"]["count"] * len(config["sweep"]["lights"])
        total = 0.0
        for what, *command in (
            ("render", "--config", folder / "load.yaml", "--out", folder / "run", "--jobs", arguments.jobs),
            ("recover", folder / "run", "--jobs", arguments.jobs),
            ("evaluate", folder / "run", "--jobs", arguments.jobs),
        ):
            seconds, busy, memory = measured(BIN / what, *command)
            total += seconds
            case = f"load: {what}, {items} items of 128², {arguments.jobs} jobs"
            say(case, seconds, "s", note=f"{1000 * seconds / items:.0f} ms an item; {busy:.0f} s of processor time")
            say(f"{case}: memory at its most", max(memory), "MiB", note=f"grows by {growth(memory):+.1%}")
        say(f"load: end to end, {items} items of 128²", total, "s", note="render, recover, evaluate")

        alone, _, _ = measured(BIN / "render", "--config", folder / "load.yaml", "--out", folder / "alone")
        say(f"load: render, {items} items of 128², one process", alone, "s")
        from distributed import LocalCluster

        with LocalCluster(n_workers=arguments.workers, threads_per_worker=1, dashboard_address=None) as cluster:
            options = ["--out", folder / "cluster", "--scheduler", cluster.scheduler_address]
            seconds, _, _ = measured(BIN / "render", "--config", folder / "load.yaml", *options)
        same = contents(folder / "run") == contents(folder / "alone") == contents(folder / "cluster")
        note = (
            f"files {'identical to' if same else 'DIFFERENT from'} those of one process; {alone / seconds:.2f} as fast"
        )
        say(f"load: render, {items} items of 128², {arguments.workers} Dask workers", seconds, "s", note=note)
        if not same:
            sys.exit(1)


if __name__ == "__main__":
    main()
