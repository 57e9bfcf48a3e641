"""The whole chain on the report's picture: time to render, error of each method, against the report's 15.6°.

python benchmarks/first_chain.py [mozart_depth.npz]
"""

import csv
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from record import record

BIN = Path(sys.executable).parent


def chain(label: str, *options: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        started = time.monotonic()
        subprocess.run(
            [BIN / "render", "--config", "mozart_5lights", "--out", folder, *options], check=True, capture_output=True
        )
        record(f"render, four transports, 256², {label}", time.monotonic() - started, "s", note="start-up included")
        started = time.monotonic()
        subprocess.run([BIN / "evaluate", folder], check=True, capture_output=True)
        record(f"evaluate, three methods, {label}", time.monotonic() - started, "s", note="recovery included")
        for row in csv.DictReader((Path(folder) / "report/metrics.csv").open()):
            case = f"{label}, {row['transport']}, {row['method']}"
            note = f"coverage {row['coverage']}, oracle {row['oracle_linear_median_deg']}, status {row['status']}"
            record(f"{case}: median error", float(row["median_deg"] or "nan"), "degrees", note=note)


if __name__ == "__main__":
    chain("built-in bust")
    if len(sys.argv) > 1:
        chain("real Mozart", "--shape", sys.argv[1])
