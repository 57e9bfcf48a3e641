"""Real photographs under mixed lights: how far methods err, and how far they say that they err.

Usage: python benchmarks/real_pictures.py FOLDER [--method NAME]… [--mixes 10] [--case TEXT]… [--reduce N] [--record]

FOLDER holds sets with true normals that `render --config photographs --shape` reads, by the names in CASES (a folder or
an npz). Each case is a set and a kind of lights; each mix another seed. Printed is a line for each mix and method, and
for each case and method the medians over its mixes; a set that is missing is skipped in one line. ``--record`` appends
these medians to results.tsv.

Errors are over the object's pixels: "all" counts a pixel without a normal as worst, the others are over pixels with
one. "stated/true": the median error that the method states over its median error; 1 is honest, below 1 too sure.
"""

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from record import record

from huesphere.configs.load import load_config
from huesphere.eval.metrics import angular_error_deg, colour_condition, fit_colour_matrix
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.methods.table import METHODS
from huesphere.render.dataset import Observation, Truth, linear_light
from huesphere.render.photographs.item import mix, observed, truth_of

CASES = (  # set, lights
    ("diligent_ball", "lamps"),
    ("diligent_ball", "gels"),
    ("grey_sphere", "lamps"),
    ("diligent_cat", "lamps"),
    ("diligent_cat", "natural"),
    ("diligent_ball", "natural"),
)


@dataclass(frozen=True)
class Line:
    """One method on one mix."""

    case: str
    seed: int
    method: str
    verdict: str
    status: str
    all_deg: float  # median over the object; inf where it gives fewer than half of the normals
    median_deg: float  # over the normals given
    mean_deg: float
    coverage: float
    stated: float  # over true
    condition: float  # of the best F
    seconds: float  # processor time

    def text(self) -> str:
        errors = f"{self.all_deg:6.1f} {self.median_deg:6.1f} {self.mean_deg:6.1f} {self.coverage:5.0%}"
        what = f"{self.case:24} {self.seed:3d} {self.method:20}"
        cost = f"{self.stated:6.2f} {self.condition:7.1f} {self.seconds:6.1f} s"
        return f"{what} {errors} {cost}  {self.verdict}: {self.status}"


def find_set(folder: Path, name: str) -> Path | None:
    return next((path for path in (folder / name, folder / f"{name}.npz") if path.exists()), None)


def measured(case: str, seed: int, method: str, observation: Observation, truth: Truth) -> Line:
    """Run ``method`` and compare it with the truth."""
    started = time.process_time()
    estimate: Estimate = METHODS[method](observation)
    seconds = time.process_time() - started
    error = angular_error_deg(estimate.normals, truth.normals)[truth.mask]
    given = np.isfinite(error)
    rgb = linear_light(observation).rgb[truth.mask]
    condition = colour_condition(fit_colour_matrix(rgb, truth.normals[truth.mask]))
    if not given.any():
        none = float("nan")
        return Line(
            case, seed, method, estimate.verdict, estimate.status, np.inf, none, none, 0, none, condition, seconds
        )
    median = float(np.median(error[given]))
    stated = float(np.nanmedian(estimate.uncertainty_deg[truth.mask][given])) / median
    everywhere = float(np.median(np.where(given, error, np.inf)))
    return Line(
        case, seed, method, estimate.verdict, estimate.status, everywhere, median, float(error[given].mean()),
        float(given.mean()), stated, condition, seconds,
    )  # fmt: skip


def lines_of(path: Path, lights: str, methods: Sequence[str], mixes: int, reduce: int) -> Iterator[Line]:
    """One line for each mix and method, as they are measured."""
    for seed in range(mixes):
        sets = [f"lights.0.colours={lights}", f"lights.0.seed={seed}", f"shape.reduce={reduce}"]
        if lights == "natural":
            sets.append("lights.0.count=5")
        config = load_config("photographs", overrides=sets, shape=str(path))
        mixed = mix(config)
        observation, truth = observed(mixed, config)[0], truth_of(mixed, config)
        for method in methods:
            line = measured(f"{path.stem} {lights}", seed, method, observation, truth)
            print(line.text(), flush=True)
            yield line


def summarise(lines: list[Line], reduce: int, keep: bool) -> None:
    """Print the medians over the mixes of a case and method, and append them to results.tsv if ``keep``."""
    of = lines[0]
    verdicts = [line.verdict for line in lines]
    counts = ", ".join(f"{verdicts.count(v)} {v}" for v in ("trust", "doubtful", "failed") if v in verdicts)
    with_normals = [line for line in lines if line.coverage > 0]
    everywhere = float(np.median([line.all_deg for line in lines]))
    wrong = sum(line.verdict == "trust" and line.median_deg > 10 for line in lines)
    size = f", means over {reduce} × {reduce} pixels" * (reduce > 1)
    note = f"{len(lines)} mixes{size}; {counts}; trusted over 10°: {wrong}"
    figure: float | str = "no normals"
    if with_normals:
        figure, mean, coverage, stated = (
            float(np.median([getattr(line, key) for line in with_normals]))
            for key in ("median_deg", "mean_deg", "coverage", "stated")
        )
        note += f"; mean {mean:.3g}, coverage {coverage:.0%}, stated/true {stated:.2g}, all pixels {everywhere:.3g}"
    case = f"real photographs, {of.case}, {of.method}: median"
    if keep:
        record(case, figure, "deg", note=note)
    else:
        print(f"{case}: {figure if isinstance(figure, str) else f'{figure:.3g}'} deg; {note}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--method", action="append", choices=tuple(METHODS))
    parser.add_argument("--case", action="append", default=[], help="only cases whose name holds this text")
    parser.add_argument("--mixes", type=int, default=10)
    parser.add_argument("--reduce", type=int, default=1)
    parser.add_argument("--record", action="store_true")
    given = parser.parse_args()
    methods = given.method or ["weak-integrability", "auto"]
    print(f"{'case':24} {'mix':>3} {'method':20} {'all':>6} {'median':>6} {'mean':>6} {'cover':>5} stated  cond F")
    for name, lights in CASES:
        if given.case and not any(text in f"{name} {lights}" for text in given.case):
            continue
        path = find_set(given.folder, name)
        if path is None:
            print(f"{name} {lights}: skipped, not in {given.folder}")
            continue
        lines = list(lines_of(path, lights, methods, given.mixes, given.reduce))
        for method in methods:
            summarise([line for line in lines if line.method == method], given.reduce, given.record)


if __name__ == "__main__":
    main()
