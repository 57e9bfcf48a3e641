"""One line in results.tsv for each figure that was measured: what, how much, on which commit and machine."""

import datetime
import os
import platform
import subprocess
from pathlib import Path

RESULTS = Path(__file__).parent / "results.tsv"


def record(case: str, figure: float | str, unit: str, *, kept: str = "kept", note: str = "") -> None:
    """Append a row and print it; ``kept`` is "kept" or "dropped", with the reason in ``note``."""
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, cwd=RESULTS.parent)
    value = f"{figure:.4g}" if isinstance(figure, float) else str(figure)
    machine = f"{os.cpu_count()} cores, {platform.system()} {platform.machine()}"
    row = [commit.stdout.strip(), datetime.date.today().isoformat(), machine, case, value, unit, kept, note]
    with RESULTS.open("a", encoding="utf-8") as file:
        file.write("\t".join(row) + "\n")
    print(f"{case}: {value} {unit} {note}", flush=True)
