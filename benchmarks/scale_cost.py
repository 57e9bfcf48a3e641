"""What an item of a sweep costs: processor seconds, bytes and memory, over picture sizes and transports.

python benchmarks/scale_cost.py [--out FOLDER] [--sizes 64,128] [--record]

Each case is rendered twice by the command, as one process with one thread of the numerical libraries: a sweep of one
shape, and one of three. The difference is the cost of a shape, the rest that of starting. Processor time is used, which
other work on the machine changes little. Then the costs that grow with the run are measured: the manifest, written anew
at most once a second, and Dask's scheduler, by tasks that do nothing.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from record import record

from huesphere.render.manifest import empty_manifest, put_items

BIN = Path(sys.executable).parent
CONFIG = """
shape: {kind: bowl, detail: 64}
surface: {reflectance: 0.8}
lights:
  - {direction: [0.5, 0.2, 1.0], spectrum: {gaussian: {centre: 610, sigma: 25}}}
  - {direction: [-0.5, 0.2, 1.0], spectrum: {gaussian: {centre: 540, sigma: 25}}}
  - {direction: [0.0, -0.5, 1.0], spectrum: {gaussian: {centre: 460, sigma: 20}}}
"""
THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")


def processor_seconds(folder: Path, size: int, transport: str, shapes: int) -> tuple[float, float, Path]:
    """(processor seconds, largest resident MiB, run folder) of rendering a sweep of bowls of other openings."""
    config = folder / "bowls.yaml"
    config.write_text(CONFIG)
    run = folder / f"run_{size}_{transport}_{shapes}"
    sweep = f"sweep={{count: {shapes}, seed: 1, shape.opening: {{uniform: [50, 80]}}}}"
    command = [BIN / "render", "--config", config, "--out", run, "--set", sweep]
    command += ["--set", f"camera.resolution=[{size},{size}]", "--transport", transport]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, check=True, capture_output=True, env=os.environ | THREADS)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return used, after.ru_maxrss / 1024, run


def bytes_by_file(run: Path) -> dict[str, float]:
    """Mean bytes of an item, by the name of its file."""
    items = json.loads((run / "manifest.json").read_text())["items"]
    sizes: dict[str, list[int]] = {}
    for item in items:
        for file in item["files"]:
            sizes.setdefault(Path(file["path"]).name, []).append(file["bytes"])
    return {name: sum(values) / len(values) for name, values in sizes.items()}


def manifest_seconds(folder: Path, items: int) -> float:
    """Processor seconds to put one item into a manifest that has this many."""
    run = folder / f"manifest_{items}"
    run.mkdir()
    files = [{"path": f"name/full/{n}.exr", "sha256": "0" * 64, "bytes": 1} for n in range(5)]
    entries = [
        {"id": f"name-{n:07}/full", "status": "done", "seed": 0, "engine": "transport", "seconds": 1.0, "files": files}
        for n in range(items)
    ]
    (run / "manifest.json").write_text(json.dumps(empty_manifest() | {"items": entries}, indent=1, sort_keys=True))
    began = time.process_time()
    put_items(run, entries[:1])
    return time.process_time() - began


def dask_milliseconds(tasks: int) -> float:
    """Processor milliseconds of scheduler and client in one process, for a task that does nothing."""
    from distributed import Client, LocalCluster

    options = {"n_workers": 1, "threads_per_worker": 1, "processes": True, "dashboard_address": None}
    with LocalCluster(**options) as cluster, Client(cluster) as client:
        client.gather(client.map(int, range(100), pure=False))
        began = time.process_time()
        client.gather(client.map(int, range(tasks), pure=False))
        return 1000 * (time.process_time() - began) / tasks


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", default="64,128")
    parser.add_argument("--record", action="store_true", help="append the figures to results.tsv")
    arguments = parser.parse_args()

    def put(figure: str, value: float, unit: str) -> None:
        print(f"{figure}\t{value:.4g}\t{unit}", flush=True)
        if arguments.record:
            record(f"scale: {figure}", f"{value:.4g}", unit, note="loaded machine, processor time")

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for items in (1000, 10_000):
            put(f"manifest of {items}", manifest_seconds(folder, items), "s")
        put("a task of Dask", dask_milliseconds(3000), "ms")
        for size in (int(text) for text in arguments.sizes.split(",")):
            for transport in ("direct", "full"):
                one, _, _ = processor_seconds(folder, size, transport, 1)
                three, memory, run = processor_seconds(folder, size, transport, 3)
                each = (three - one) / 2
                put(f"{size}² {transport}", each, "s a shape")
                put(f"{size}² {transport}, start", one - each, "s a process")
                put(f"{size}² {transport}, memory", memory, "MiB")
                for file, count in bytes_by_file(run).items():
                    put(f"{size}² {transport}, {file}", count, "bytes")


if __name__ == "__main__":
    main()
