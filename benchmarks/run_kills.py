"""Ends commands at random moments, and checks what is left: python benchmarks/run_kills.py [--kills 100] [--first SEED]

Each case runs `render`, `recover` or `evaluate` over a small sweep by one process or two, and sends a signal to it, or
to it and its workers, at a random moment. Then no item may be marked as failed, the exit code may be 0 only if all was
made, the same command must end with exit code 0, and every file must be that of a run that was never ended.
"""

import argparse
import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from record import record

BIN = Path(sys.executable).parent
SIGNALS = ("SIGKILL", "SIGTERM", "SIGHUP", "SIGINT", "SIGPIPE")
COMMANDS = ("render", "recover", "evaluate")
SWEEP = """
shape: {kind: bowl, detail: 12}
surface: {reflectance: 0.7}
lights:
  - {direction: [0.5, 0.2, 1.0], spectrum: A}
  - {direction: [-0.4, 0.3, 1.0], spectrum: D65}
  - {direction: [0.1, -0.4, 1.0], spectrum: FL2}
camera: {resolution: [24, 24], read_noise: 1e-3}
render: {transport: [direct, full], target_rms: 0.02}
recover: {methods: [least-squares]}
sweep: {shape.opening: [50, 60, 70], surface.reflectance: [0.9, 0.3]}
"""


def command(name: str, jobs: int) -> list[str]:
    what = ["--config", "bowls.yaml", "--out", "run"] if name == "render" else ["run"]
    return [str(BIN / name), *what, "--jobs", str(jobs)]


def contents(run: Path) -> dict[str, str]:
    """sha256 of every file but those that hold times."""
    kinds = (".exr", ".png", ".yaml")
    files = [path for path in run.rglob("*") if path.suffix in kinds and path.is_file()]
    return {path.relative_to(run).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def prepared(folder: Path) -> tuple[dict[str, dict[str, str]], dict[str, float]]:
    """Run all commands to their ends; (contents after each, seconds of each). Keeps a copy of the run before each."""
    (folder / "bowls.yaml").write_text(SWEEP)
    subprocess.run([BIN / "render", "--config", "bowls.yaml", "--out", "warm"], cwd=folder, capture_output=True)
    after, seconds = {}, {}
    for name in COMMANDS:
        (folder / "run").mkdir(exist_ok=True)
        shutil.copytree(folder / "run", folder / f"before-{name}")
        started = time.monotonic()
        done = subprocess.run(command(name, 1), cwd=folder, capture_output=True, text=True)
        if done.returncode:
            sys.exit(f"{name}: {done.stderr}")
        after[name], seconds[name] = contents(folder / "run"), time.monotonic() - started
    return after, seconds


def ended(folder: Path, name: str, jobs: int, number: int, after: float, everybody: bool) -> tuple[int, str]:
    """(exit code, stderr) of a command that gets a signal ``after`` seconds, once all its processes are gone."""
    process = subprocess.Popen(
        command(name, jobs),
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    with process:
        try:
            process.wait(after)
        except subprocess.TimeoutExpired:
            if everybody:
                os.killpg(process.pid, number)
            else:
                process.send_signal(number)
        _, stderr = process.communicate(timeout=240)
    deadline = time.monotonic() + 60
    while _group_lives(process.pid) and time.monotonic() < deadline:
        time.sleep(0.1)
    if _group_lives(process.pid):
        os.killpg(process.pid, signal.SIGKILL)
        stderr += "\nworkers that outlive their command"
    return process.returncode, stderr


def _group_lives(group: int) -> bool:
    """Whether there is a process of that group that is no zombie."""
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, its_group = stat.read_text().rpartition(")")[2].split()[:3]
        except (OSError, ValueError):
            continue
        if int(its_group) == group and state != "Z":
            return True
    return False


def case(folder: Path, rng: random.Random, after: dict[str, dict[str, str]], seconds: dict[str, float]) -> list[str]:
    """What went wrong with one command that was ended; prints what was done."""
    name, jobs, kind = rng.choice(COMMANDS), rng.choice((1, 2)), rng.choice(SIGNALS)
    everybody, moment = rng.random() < 0.3, rng.uniform(0.0, seconds[name])
    shutil.rmtree(folder / "run")
    shutil.copytree(folder / f"before-{name}", folder / "run")
    code, stderr = ended(folder, name, jobs, getattr(signal, kind), moment, everybody)
    wrong = []
    records = [json.loads(path.read_text()) for path in (folder / "run").glob("*/[!.]*/item.json")]
    wrong += [f"marked as {r['status']}: {r.get('error')}" for r in records if r["status"] != "done"]
    same = contents(folder / "run") == after[name]
    if code == 0 and not same:
        wrong.append("exit code 0, and not all is made")
    if "outlive" in stderr:
        wrong.append(stderr.splitlines()[-1])
    if "Traceback" in stderr and kind != "SIGINT":  # Python itself answers to Ctrl-C while it starts
        wrong.append(f"a traceback: {stderr.splitlines()[-1]}")
    again = subprocess.run(command(name, jobs), cwd=folder, capture_output=True, text=True)
    if again.returncode:
        wrong.append(f"the same command again: exit code {again.returncode}, {again.stderr[-200:]}")
    elif contents(folder / "run") != after[name]:
        wrong.append("files that are not those of a run that was never ended")
    left = [path.name for path in (folder / "run").rglob(".*")]
    wrong += [f"left behind: {left[0]}"] if left else []
    who = "all its processes" if everybody else "it"
    print(
        f"{name}, {jobs} jobs, {kind} to {who} after {moment:.1f} s: exit code {code}; {wrong or 'right'}", flush=True
    )
    return wrong


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--record", action="store_true", help="a line in results.tsv")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        after, seconds = prepared(folder)
        wrong = [
            case(folder, random.Random(seed), after, seconds)
            for seed in range(arguments.first, arguments.first + arguments.kills)
        ]
    total = sum(map(bool, wrong))
    print(f"{arguments.kills} commands ended, {total} with something wrong")
    if arguments.record:
        record("kills: commands ended at a random moment with something wrong", total, "", note=f"{arguments.kills}")
    sys.exit(1 if total else 0)


if __name__ == "__main__":
    main()
