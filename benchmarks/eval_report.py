"""Seconds and memory of scoring and report, beyond the recoveries: many pictures made by hand, five methods.

python benchmarks/eval_report.py [pictures, 100] [side in pixels, 256]
"""

import json
import os
import resource
import sys
import tempfile
import time
from pathlib import Path

from record import record

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]


def fabricate(run: Path, pictures: int, size: int) -> None:
    """Write one item with the tests' own writer and copies of it under other names."""
    from test_eval_fabricated_run import fabricate_run, rotation

    methods = {
        "least-squares": rotation("x", 15),
        "drew-kontsevich": rotation("z", 10),
        "weak-integrability": rotation("y", 0.05),
        "robust": rotation("z", 1),
        "unbounce": rotation("y", 0.5),
    }
    fabricate_run(run, {"bump000/linear": methods}, size=size, noise=1e-3)
    manifest = json.loads((run / "manifest.json").read_text())
    (first,) = manifest["items"]
    for number in range(1, pictures):
        name = f"bump{number:03}"
        (run / name).symlink_to(run / "bump000")
        manifest["items"].append(json.loads(json.dumps(first).replace("bump000", name)))
    (run / "manifest.json").write_text(json.dumps(manifest))


def main(pictures: int, size: int) -> None:
    from huesphere.eval.report import write_report

    with tempfile.TemporaryDirectory() as folder:
        run, jobs = Path(folder), os.cpu_count() or 1
        fabricate(run, pictures, size)
        started, cpu = time.monotonic(), sum(os.times()[:4])
        report = write_report(run, jobs=jobs)
        seconds, cpu = time.monotonic() - started, sum(os.times()[:4]) - cpu
        whose = resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN
        own, worker = (resource.getrusage(who).ru_maxrss / 2**20 for who in whose)
        files = [path for path in (run / "report").rglob("*") if path.is_file()]
        largest = max(path.stat().st_size for path in files if path.suffix == ".html") / 1e6
        figures = sum(path.stat().st_size for path in files if path.suffix == ".png") / 1e6
        case = f"score and report, {pictures} pictures of {size}², {len(report.scores)} results"
        load = f"CPU {cpu:.0f} s, load of the machine {os.getloadavg()[0]:.1f}"
        record(case, seconds, "s", note=load)
        record(f"{case}: peak memory", own + jobs * worker, "GiB", note="bound: own and each worker's peak summed")
        record(f"{case}: largest page", largest, "MB", note=f"figures {figures:.0f} MB")


if __name__ == "__main__":
    main(*(int(text) for text in (sys.argv[1:] + ["100", "256"][len(sys.argv) - 1 :])))
