"""What each tuned number of ``recover`` does to the results at half and at twice its value.

Usage: python benchmarks/recover_sensitivity.py [--jobs N] [--only WORD] [--record]. Small scenes of known truth are
rendered; every method that reads a number is run again with the number changed, and its normals are compared with those
of the default and with the truth. A share over one half is changed by its distance from 1. With --record a row for each
number goes to results.tsv: the largest median turn of the normals, at half and at twice.
"""

import argparse
import dataclasses
import tempfile
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import cache
from multiprocessing import get_context
from typing import Any, NamedTuple

import numpy as np
from record import record

import huesphere as hs
from huesphere.eval.metrics import angular_error_deg
from huesphere.recover.parameters import overridden, records
from huesphere.recover.run import recover_one
from huesphere.render.dataset import Observation

SMALL = "camera.resolution=[72, 72]"
NEAR = (
    "lights=[{kind: point, position: [1.5, 0.6, 3], spectrum: {gaussian: {centre: 610, sigma: 25}}, intensity: 10},"
    "{kind: point, position: [-1.5, 0.6, 3], spectrum: {gaussian: {centre: 540, sigma: 25}}, intensity: 10},"
    "{kind: point, position: [0, -1.6, 3], spectrum: {gaussian: {centre: 460, sigma: 20}}, intensity: 10}]"
)
SCENES: dict[str, tuple[str, list[str]]] = {  # name: config, overrides
    "noisy": ("mozart_5gels", ["render.transport=[linear]", "camera.read_noise=0.003"]),
    "natural": ("mozart_5lights", ["render.transport=[direct]", "camera.read_noise=0.0003"]),
    "clean": ("mozart_wide_gels", ["render.transport=[direct]", "camera.resolution=[96, 96]"]),
    "wide": ("mozart_wide_gels", ["render.transport=[linear]", "camera.read_noise=0.001"]),
    "full": ("mozart_5gels", ["render.transport=[full]", "camera.read_noise=0.001"]),
    "near": ("mozart_5gels", ["render.transport=[direct]", NEAR, "recover.lights=told"]),
}
RUNS = (  # scene, method
    ("noisy", "auto"),
    ("natural", "auto"),
    ("clean", "auto"),
    ("wide", "auto"),
    ("full", "auto"),
    ("near", "auto"),
    ("noisy", "robust"),
    ("wide", "robust"),
    ("natural", "drew-kontsevich-ambient"),
    ("noisy", "alternation"),
    ("noisy", "kontsevich-1994-growing"),
)


class Outcome(NamedTuple):
    status: str
    normals: np.ndarray  # (P, 3) of the object's pixels
    mean_deg: float  # against the truth, over the pixels that have a normal
    coverage: float


class Effect(NamedTuple):
    """What one change of one number did, over all runs that read the number."""

    turn_deg: float  # largest median turn of the normals
    mean_deg: float  # sum over the runs of the change of the mean error
    statuses: tuple[str, ...]  # "scene/method: before → after", where it changed


_given: dict[str, tuple[Observation, np.ndarray]] = {}  # what ``scenes`` gives, in a worker process


@cache
def scenes() -> dict[str, tuple[Observation, np.ndarray]]:
    """Of each scene the picture and the true normals."""
    if _given:
        return _given
    found = {}
    for name, (config, overrides) in SCENES.items():
        with tempfile.TemporaryDirectory() as folder:
            (item,) = hs.render_scene(config, [SMALL, *overrides], folder)
            found[name] = item.observation(), item.truth().normals
    return found


def outcome(scene: str, method: str) -> Outcome:
    observation, truth = scenes()[scene]
    estimate = recover_one(observation, method)
    error = angular_error_deg(estimate.normals[estimate.valid], truth[estimate.valid])
    mean = float(np.nanmean(error)) if estimate.valid.any() else float("nan")
    share = float(estimate.valid.sum() / observation.mask.sum())
    return Outcome(estimate.status, estimate.normals[observation.mask], mean, share)


@contextmanager
def reads(read: set[tuple[str, str]]) -> Iterator[None]:
    """Within the block, (record, field) of each tuned number that is read is added to ``read``."""
    kinds = {type(one): name for name, one in records().items()}

    def spy(kind: type) -> Any:
        fields, name = {f.name for f in dataclasses.fields(kind)}, kinds[kind]

        def get(self: Any, key: str) -> Any:
            if key in fields:
                read.add((name, key))
            return object.__getattribute__(self, key)

        return get

    for kind in kinds:
        kind.__getattribute__ = spy(kind)  # type: ignore[assignment, method-assign]
    try:
        yield
    finally:
        for kind in kinds:
            del kind.__getattribute__


def changed(value: Any, factor: float) -> Any:
    """A number, or every number of a tuple or record, at ``factor`` of its value."""
    if dataclasses.is_dataclass(value):
        parts = {f.name: changed(getattr(value, f.name), factor) for f in dataclasses.fields(value)}
        return dataclasses.replace(value, **{k: v for k, v in parts.items() if not isinstance(v, bool)})  # type: ignore[type-var]
    if isinstance(value, tuple):
        return tuple(changed(v, factor) for v in value)
    if isinstance(value, np.ndarray):
        return value * factor
    if isinstance(value, bool) or not isinstance(value, int | float):
        return value
    if isinstance(value, int):
        return max(1, round(value * factor))
    return 1 - (1 - value) * factor if 0.5 < value < 1 else value * factor


def effect_of(task: tuple[str, str, float, tuple[tuple[str, str], ...], dict[tuple[str, str], Outcome]]) -> Effect:
    """The effect of one change on the runs that read the number."""
    name, field, factor, runs, before = task
    one, turn, worse, statuses = records()[name], 0.0, 0.0, []
    with overridden(one, **{field: changed(getattr(one, field), factor)}):
        for run in runs:
            try:
                now = outcome(*run)
            except Exception as error:  # a number may be impossible at half or twice its value: say so
                statuses.append(f"{'/'.join(run)}: {type(error).__name__}")
                continue
            was = before[run]
            both = np.isfinite(was.normals[:, 0]) & np.isfinite(now.normals[:, 0])
            if both.any():
                moved = angular_error_deg(was.normals[both], now.normals[both])
                turn = max(turn, float(np.nanmedian(moved)))
            worse += now.mean_deg - was.mean_deg if np.isfinite(now.mean_deg + was.mean_deg) else 0.0
            if now.status != was.status:
                statuses.append(f"{'/'.join(run)}: {was.status} → {now.status}")
    return Effect(turn, worse, tuple(statuses))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--only", default="", help="numbers whose record or name holds this word")
    parser.add_argument("--record", action="store_true", help="append to results.tsv")
    asked = parser.parse_args()
    scenes()
    before, read_by = {}, {}
    for run in RUNS:
        read: set[tuple[str, str]] = set()
        with reads(read):
            before[run] = outcome(*run)
        read_by[run] = read
        mean = f"mean error {before[run].mean_deg:.3f}°"
        print(*run, before[run].status, mean, f"{len(read)} numbers read", sep="\t", flush=True)
    wanted = [
        (name, field.name)
        for name, one in records().items()
        for field in dataclasses.fields(one)
        if asked.only.lower() in f"{name}.{field.name}".lower()
    ]
    tasks = [
        (name, field, factor, tuple(run for run in RUNS if (name, field) in read_by[run]), before)
        for name, field in wanted
        for factor in (0.5, 2.0)
    ]
    context = get_context("spawn")  # compiled loops do not survive a fork
    with ProcessPoolExecutor(asked.jobs, context, _given.update, (scenes(),)) as pool:
        effects = iter(pool.map(effect_of, tasks))
        for (name, field), (half, twice) in zip(wanted, zip(effects, effects)):
            runs = sum((name, field) in read for read in read_by.values())
            figure = f"{half.turn_deg:.2g} / {twice.turn_deg:.2g}"
            note = f"mean errors {half.mean_deg:+.3f} / {twice.mean_deg:+.3f} over {runs} runs"
            status = "; ".join((*half.statuses, *twice.statuses))
            note += f"; {status}" if status else ""
            if asked.record:
                record(f"sensitivity, {name}.{field}: normals turn at half / twice", figure, "deg", note=note)
            else:
                print(f"{name}.{field}", figure, note, sep="\t", flush=True)


if __name__ == "__main__":
    main()
