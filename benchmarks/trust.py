"""Whether the verdict of an estimate agrees with its true error: over random scenes, broken assumptions, photographs.

python benchmarks/trust.py make FOLDER --family scenes|breakers|real [--count N] [--first SEED] [--size 96] [--jobs 2]
python benchmarks/trust.py run FOLDER --out RESULTS.jsonl [--method auto] [--jobs 2] [--limit-s 120] [--retry]
python benchmarks/trust.py report RESULTS.jsonl [--record]

``make`` writes a file for each picture and skips those that are there; ``run`` recovers each and appends a line of
JSON for each, and skips those that have one; ``report`` prints tables (benchmarks/trust_report.py). ``--count`` is the
number of scenes, of pictures of each kind of breaker, or of mixes of each kind of each photographed object.
"""

import argparse
import contextlib
import json
import multiprocessing
import os
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

import numpy as np
from trust_breakers import KINDS, broken
from trust_report import BINS_DEG, report
from trust_scenes import (
    MIXES,
    PHOTOGRAPHED,
    REAL,
    Sample,
    photograph,
    random_scene,
    read_sample,
    sample_path,
    shapes_here,
    write_sample,
)

from huesphere.configs.threads import one_blas_thread
from huesphere.eval.align import TWIN, best_orthogonal
from huesphere.eval.metrics import angular_error_deg
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.methods.table import METHODS
from huesphere.recover.reasons import REASONS
from huesphere.recover.trust.evidence import Evidence, evidence_of
from huesphere.recover.trust.stated_error import pixel_figures
from huesphere.recover.trust.verdict import judged
from huesphere.render.dataset import Observation, linear_light

Row = dict[str, Any]
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "HUESPHERE_THREADS")
SAMPLED_PIXELS = 100  # of a picture, for the stated errors
LONGEST_LIST = 20  # of numbers in the diagnostics, kept in a line of results
MAKE_LIMIT_S = 600.0
FEWEST_TURNED = 20  # pixels whose normals tell a rotation

# ---- work in processes of one thread, each stopped at a limit -------------------------------------------------------


@dataclass
class _Worker:
    """A process and what it is doing."""

    process: multiprocessing.process.BaseProcess
    pipe: Connection
    task: Any = None  # None: starting, or idle
    ready: bool = False
    since: float = 0.0  # time.monotonic() at which it got the task


def _serve(pipe: Connection, function: Callable[[Any], Any]) -> None:
    """Answer tasks until there are none: ("ok", result) or ("crash", text of the exception)."""
    pipe.send("ready")
    while (task := pipe.recv()) is not None:
        try:
            pipe.send(("ok", function(task)))
        except Exception as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            at = f"{Path(where.filename).name}:{where.lineno}"
            pipe.send(("crash", f"{type(error).__name__}: {error} ({at})"))


def _start(function: Callable[[Any], Any]) -> _Worker:
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(theirs, function), daemon=True)
    process.start()
    theirs.close()
    return _Worker(process, ours)


def worked(
    function: Callable[[Any], Any], tasks: Sequence[Any], jobs: int, limit_s: float
) -> Iterator[tuple[Any, str, Any]]:
    """(task, "ok", "crash" or "timeout", result or text) of each task as it ends; a task over the limit is killed."""
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    left = list(reversed(tasks))
    workers = [_start(function) for _ in range(min(jobs, len(tasks)))]
    while workers:
        for worker in workers:
            if worker.ready and worker.task is None:
                worker.task, worker.since = (left.pop() if left else None), time.monotonic()
                worker.pipe.send(worker.task)
        idle = [w for w in workers if w.ready and w.task is None]
        workers = [w for w in workers if w not in idle]
        for worker in idle:
            worker.process.join(5)
        wait([w.pipe for w in workers], timeout=0.5)
        for i, worker in enumerate(workers):
            ended = _looked_at(worker, limit_s)
            if ended is None:
                continue
            yield worker.task, *ended
            worker.task = None
            if not worker.process.is_alive() or ended[0] in ("timeout", "died"):
                worker.process.kill()
                worker.process.join()
                workers[i] = _start(function)


def _looked_at(worker: _Worker, limit_s: float) -> tuple[str, Any] | None:
    """What a worker has to tell of its task, if anything."""
    try:
        if worker.pipe.poll():
            told: Any = worker.pipe.recv()
            if told == "ready":
                worker.ready = True
                return None
            return told[0], told[1]
    except (EOFError, ConnectionError):
        if worker.task is None:
            raise RuntimeError("a worker ended before its first task") from None
        return "died", f"process ended with code {worker.process.exitcode}"
    if worker.task is not None and time.monotonic() - worker.since > limit_s:
        return "timeout", f"over {limit_s:g} s"
    return None


# ---- make -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Order:
    """A picture to be made."""

    folder: Path
    family: str
    kind: str
    seed: int
    size: int  # pixels along an edge; photographs keep their own

    @property
    def name(self) -> str:
        """Of its file, without the ending."""
        return f"{self.kind}_{self.seed:05d}"


def make_one(order: Order) -> str:
    """Make and write a picture; returns a line about it."""
    started = time.perf_counter()
    sample = _sample(order)
    write_sample(order.folder, order.name, sample)
    return f"{order.family}/{order.name}  {time.perf_counter() - started:.1f} s"


def _sample(order: Order) -> Sample:
    if order.family == "scenes":
        return random_scene(order.seed, order.size)
    if order.family == "breakers":
        return broken(order.kind, order.seed, order.size)
    name, mix = order.kind.rsplit("_", 1)
    return photograph(name, mix, order.seed)


def orders(folder: Path, family: str, seeds: range, size: int) -> list[Order]:
    """All pictures of a family with these seeds."""
    if family == "scenes":
        shapes = shapes_here()
        return [Order(folder, family, shapes[seed % len(shapes)], seed, size) for seed in seeds]
    if family == "breakers":
        return [Order(folder, family, kind, seed, size) for seed in seeds for kind in KINDS]
    if not (REAL / "mix.py").is_file():
        print(f"real: skipped, there is no {REAL}")
        return []
    objects = [name for name in PHOTOGRAPHED if (REAL / f"{name}.npz").is_file()]
    return [Order(folder, family, f"{name}_{mix}", seed, size) for seed in seeds for name in objects for mix in MIXES]


def make(asked: argparse.Namespace) -> None:
    """The sub-command ``make``."""
    seeds = range(asked.first, asked.first + asked.count)
    wanted = orders(asked.folder, asked.family, seeds, asked.size)
    todo = [one for one in wanted if not sample_path(one.folder, one.family, one.name).is_file()]
    print(f"{len(wanted)} pictures, {len(wanted) - len(todo)} of them there already", flush=True)
    for order, outcome, told in worked(make_one, todo, asked.jobs, MAKE_LIMIT_S):
        print(told if outcome == "ok" else f"{order.family}/{order.name}: {outcome}: {told}", flush=True)


# ---- run ------------------------------------------------------------------------------------------------------------


def run_one(task: tuple[Path, str]) -> Row:
    """Recover one picture; returns what ``report`` needs of it."""
    path, method = task
    sample = read_sample(path)
    observation, started = linear_light(Observation(sample.rgb, sample.mask, sample.camera)), time.perf_counter()
    with one_blas_thread():
        unjudged = METHODS[method].load()(observation)
        evidence = evidence_of(unjudged, observation)
        estimate = replace(judged(unjudged, observation, evidence), seconds=time.perf_counter() - started)
    row = identity(path, sample, method) | {
        "status": estimate.status,
        "message": estimate.message,
        "verdict": estimate.verdict,
        "doubts": list(estimate.doubts),
        "seconds": estimate.seconds,
        "rotation_stated_deg": estimate.rotation_stderr_deg,
        "diagnostics": _kept(estimate.diagnostics),
    }
    if evidence is not None:
        row["pixels"] = sampled(sample, unjudged, evidence)
        row["figures"] = list(pixel_figures(unjudged, evidence, sample.mask))
        row["status_unjudged"] = unjudged.status
    return row | errors(sample, estimate)


def identity(path: Path, sample: Sample, method: str) -> Row:
    """What a line says of its picture."""
    keys = ("shape", "closed", "noise", "cond_F", "sees_all", "indirect", "broken")
    drawn = {key: sample.drawn[key] for key in keys if key in sample.drawn}
    if "lights" in sample.drawn:
        drawn["lights"] = len(sample.drawn["lights"])
    head = {"file": f"{path.parent.name}/{path.stem}", "family": sample.family, "kind": sample.kind}
    return head | {"seed": sample.seed, "method": method} | drawn


def without_estimate(path: Path, method: str, status: str, message: str) -> Row:
    """The line of a picture that took too long or crashed the method, or could not be read."""
    kind, _, seed = path.stem.rpartition("_")
    row: Row = {"file": f"{path.parent.name}/{path.stem}", "family": path.parent.name, "kind": kind}
    row |= {"seed": int(seed) if seed.isdigit() else -1, "method": method}
    with contextlib.suppress(OSError, ValueError, KeyError):
        row = identity(path, read_sample(path), method)
    return row | {"verdict": "failed", "status": status, "message": message}


def errors(sample: Sample, estimate: Estimate) -> Row:
    """Angular errors over the pixels given, degrees, and how the stated ones compare."""
    given = estimate.valid & sample.mask & np.isfinite(sample.normals).all(axis=-1)
    given &= np.isfinite(estimate.normals).all(axis=-1)
    if not given.any():
        return {"coverage": 0.0}
    n, truth = estimate.normals[given].astype(float), sample.normals[given].astype(float)
    error, stated = angular_error_deg(n, truth), estimate.uncertainty_deg[given].astype(float)
    aligned = angular_error_deg(n @ best_orthogonal(n, truth).T, truth)
    return {
        "coverage": float(given.sum() / sample.mask.sum()),
        "median_deg": float(np.median(error)),
        "mean_deg": float(np.mean(error)),
        "p90_deg": float(np.percentile(error, 90)),
        "flipped_median_deg": float(np.median(angular_error_deg(n @ TWIN, truth))),
        "aligned_median_deg": float(np.median(aligned)),
        "rotation_deg": rotation_error_deg(sample, estimate, given & estimate.inlier),
        "stated_median_deg": float(np.nanmedian(stated)) if np.isfinite(stated).any() else None,
        "calibration": calibration(error, stated),
        "reasons": {} if estimate.reason is None else by_reason(error, stated, estimate.reason[given]),
    }


def rotation_error_deg(sample: Sample, estimate: Estimate, some: np.ndarray) -> float | None:
    """Angle of the rotation that turns the normals of ``some`` (H, W), or their twins, best into the true ones."""
    if some.sum() < FEWEST_TURNED:
        return None
    n, truth = estimate.normals[some].astype(float), sample.normals[some].astype(float)
    turns = (best_orthogonal(one, truth, proper=True) for one in (n, n @ TWIN))
    return min(float(np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))) for turn in turns)


def sampled(sample: Sample, estimate: Estimate, evidence: Evidence) -> list[list[float]]:
    """Of some pixels: the error and the figures that a stated error is computed from, for benchmarks/trust_fit.py."""
    given = estimate.valid & sample.mask
    error = angular_error_deg(estimate.normals[given].astype(float), sample.normals[given].astype(float))
    columns = np.stack([error, *pixel_figures(estimate, evidence, sample.mask).values()], axis=1)
    columns = columns[np.isfinite(columns).all(axis=1)]
    count = min(SAMPLED_PIXELS, len(columns))
    chosen = np.random.default_rng(sample.seed).choice(len(columns), count, replace=False)
    return [[round(float(value), 4) for value in row] for row in columns[chosen]]


def calibration(error: np.ndarray, stated: np.ndarray) -> list[list[int]]:
    """For each bin of the stated error: pixels, and those within it, within twice, and beyond ten times of it."""
    number = np.digitize(stated, BINS_DEG)
    return [
        [int(own.sum())]
        + [int((own & test).sum()) for test in (error <= stated, error <= 2 * stated, error > 10 * stated)]
        for own in (number == i for i in range(len(BINS_DEG) + 1))
    ]


def by_reason(error: np.ndarray, stated: np.ndarray, reason: np.ndarray) -> Row:
    """(pixels, mean error, mean stated error in degrees) by the name of the reason."""
    found = {}
    for code, (name, _) in REASONS.items():
        own = reason == code
        if own.any():
            finite = stated[own][np.isfinite(stated[own])]
            found[name] = [int(own.sum()), float(error[own].mean()), float(finite.mean()) if len(finite) else None]
    return found


def _kept(value: Any) -> Any:
    """``value`` for JSON, without lists of more than LONGEST_LIST numbers."""
    if isinstance(value, dict):
        return {
            str(key): _kept(one) for key, one in value.items() if isinstance(one, dict) or _count(one) <= LONGEST_LIST
        }
    if isinstance(value, list | tuple | np.ndarray):
        return [_kept(one) for one in value]
    return value


def _count(value: Any) -> int:
    """How many numbers there are in lists, arrays and dictionaries; texts count none."""
    if isinstance(value, dict):
        return sum(_count(one) for one in value.values())
    if isinstance(value, list | tuple | np.ndarray):
        return sum(_count(one) for one in value)
    return 0 if isinstance(value, str) else 1


def _plain(value: Any) -> Any:
    """What JSON has no word for: NumPy's numbers as numbers, all else as text."""
    return value.item() if isinstance(value, np.generic) else str(value)


def run(asked: argparse.Namespace) -> None:
    """The sub-command ``run``."""
    there = set()
    if asked.out.is_file():
        lines = asked.out.read_text(encoding="utf-8").splitlines()
        again = ("timeout", "crash") if asked.retry else ()
        there = {(row["file"], row["method"]) for row in map(json.loads, lines) if row["status"] not in again}
    files = sorted(asked.folder.rglob("*.npz"))
    todo = [(path, asked.method) for path in files if (f"{path.parent.name}/{path.stem}", asked.method) not in there]
    print(f"{len(files)} pictures, {len(todo)} to recover", flush=True)
    with asked.out.open("a", encoding="utf-8") as out:
        for (path, method), outcome, told in worked(run_one, todo, asked.jobs, asked.limit_s):
            row = told
            if outcome != "ok":
                row = without_estimate(path, method, "timeout" if outcome == "timeout" else "crash", told)
            out.write(json.dumps(row, default=_plain) + "\n")
            out.flush()
            median = row.get("median_deg", float("nan"))
            print(
                f"{row['file']}  {row['verdict']}  {row['status']}  {median:.2f}°  {row.get('seconds', 0):.1f} s",
                flush=True,
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    one = commands.add_parser("make", help="make pictures")
    one.add_argument("folder", type=Path)
    one.add_argument("--family", choices=("scenes", "breakers", "real"), required=True)
    one.add_argument("--count", type=int, default=10)
    one.add_argument("--first", type=int, default=0, help="seed of the first")
    one.add_argument("--size", type=int, default=96, help="pixels along an edge; photographs keep their own")
    one.set_defaults(do=make)
    two = commands.add_parser("run", help="recover every picture under a folder")
    two.add_argument("folder", type=Path)
    two.add_argument("--out", type=Path, required=True)
    two.add_argument("--method", default="auto")
    two.add_argument("--limit-s", type=float, default=120.0, help="seconds for a picture")
    two.add_argument("--retry", action="store_true", help="those too that took too long or crashed before")
    two.set_defaults(do=run)
    for command in (one, two):
        command.add_argument("--jobs", type=int, default=2, help="processes")
    three = commands.add_parser("report", help="print tables and figures")
    three.add_argument("results", type=Path)
    three.add_argument("--record", action="store_true", help="append the figures to results.tsv")
    three.set_defaults(do=lambda asked: report(asked.results, recorded=asked.record))
    asked = parser.parse_args()
    asked.do(asked)


if __name__ == "__main__":
    main()
