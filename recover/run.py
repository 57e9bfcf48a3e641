"""Methods over a run folder: what is read, what is written, and where; and what one picture has in common with it."""

import hashlib
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.load import read_yaml
from huesphere.recover.depth.integration import depth_from_normals
from huesphere.recover.geometry.rays import depth_of, of_relief, rays
from huesphere.recover.io.estimate import Estimate, read_estimate, write_estimate
from huesphere.recover.methods.table import METHODS, check_methods
from huesphere.render.dataset import Observation, read_observation
from huesphere.render.jobs import Lost, Progress, each
from huesphere.render.manifest import item_folder, read_manifest
from huesphere.render.results import require_writable, results_root

DEFAULT_METHODS = ("auto",)

PICTURE = "observation.exr"
Report = Callable[[str], None]


@dataclass(frozen=True)
class Made:
    """An estimate that was made and written, without its images."""

    method: str
    status: str
    line: str  # for the user: see `describe`


@dataclass(frozen=True)
class _Work:
    """Methods that are to run on one item."""

    item: str
    folder: Path  # of the item in the run
    results: Path  # of its estimates; the same folder, or one outside the run
    methods: tuple[str, ...]
    depth: bool
    overwrite: bool


# More than seven parameters: they are the options of the command, each on its own.
def recover_run(
    run_dir: Path,
    methods: Sequence[str] = (),
    *,
    out: Path | None = None,
    depth: bool = False,
    overwrite: bool = False,
    jobs: int = 1,
    scheduler: str | None = None,
    report: Report = lambda line: None,
    progress: Progress = lambda share, what: None,
) -> list[tuple[str, Made]]:
    """Run the methods (none named: those of each item's config) on every finished item of a run folder.

    Reads <run>/<id>/observation.exr and nothing else of the scene; writes <run>/<id>/estimates/<method>.exr and .json,
    or <out>/<id>/estimates if ``out`` is given; those that the run has are then used too.
    An estimate that is there and was made from the same picture stays, unless ``overwrite``; ``depth`` asks for depth
    too, and adds it to those that have none. Items are spread over ``jobs`` processes or the workers of a cluster.
    ``report`` is called with a line for each. Returns (item id, what was made). A picture that cannot be read does not
    stop the others: InputError is raised at the end.
    """
    check_methods(methods)
    root = results_root(run_dir, out)
    work, faults = [], []
    for item in read_manifest(run_dir)["items"]:
        if item["status"] != "done":
            continue
        folder, place = item_folder(run_dir, item["id"]), item_folder(root, item["id"])
        try:
            wanted = tuple(methods) or _configured_methods(folder / "config.yaml")
            missing = [m for m in wanted if overwrite or _lacks(_current(folder, m, place), depth)]
        except InputError as error:
            faults.append(str(error))
            continue
        if missing:
            work.append(_Work(item["id"], folder.resolve(), place.resolve(), tuple(missing), depth, overwrite))
    for one in work:
        require_writable(one.results / "estimates")
    made: list[tuple[str, Made]] = []
    with closing(each(_recover_item, work, jobs=jobs, scheduler=scheduler, progress=progress, log=report)) as results:
        for number, result in results:
            if isinstance(result, Lost | str):
                faults.append(result if isinstance(result, str) else f"{work[number].item}: {result.why}")
            else:
                made += [(work[number].item, one) for one in result]
    if faults:
        more = f" (and {len(faults) - 1} more items)" if len(faults) > 1 else ""
        raise InputError(f"{min(faults)}{more}")
    return made


def _recover_item(work: _Work, progress: Progress, log: Report) -> list[Made] | str:
    """Run and write what is missing of one item; bad input is told as text."""
    try:
        observation = read_observation(work.folder / PICTURE)
        if work.depth:
            require_focal_length(observation, work.folder / PICTURE)
    except InputError as error:
        return str(error)
    made = []
    for number, method in enumerate(work.methods):
        progress(number / len(work.methods), f"{work.item} {method}")
        there = None if work.overwrite else _current(work.folder, method, work.results)
        estimate = there or recover_one(observation, method)
        estimate = with_depth(estimate, observation) if work.depth else estimate
        write_estimate(work.results / "estimates", estimate, work.folder / PICTURE)
        made.append(Made(method, estimate.status, describe(work.item, estimate)))
        log(made[-1].line)
    return made


def recover_one(observation: Observation, method: str, most_pixels: int | None = None) -> Estimate:
    """One method on one picture, timed. ``most_pixels`` as in ``recover.methods.calling.estimate_by``."""
    started = time.perf_counter()
    estimate = METHODS[method](observation, most_pixels)
    return replace(estimate, seconds=time.perf_counter() - started)


def with_depth(estimate: Estimate, observation: Observation) -> Estimate:
    """The estimate with the depth of its normals over all of the object, or as it is where it has no normals."""
    if not estimate.valid.any():
        return estimate
    ray = rays(observation.camera, observation.mask.shape)
    relief = depth_from_normals(of_relief(estimate.normals, ray), estimate.valid, observation.mask)
    depth = depth_of(relief, None if ray is None else observation.camera.focal_px)
    return replace(estimate, depth=depth.astype(np.float32))


def describe(what: str, estimate: Estimate) -> str:
    """How an estimate ended, the verdict, for how much of the object, how sure, how long; then doubts and steps."""
    head = f"{what}  {estimate.method}  {estimate.status}"
    if estimate.verdict == "failed":
        more = "".join(f"\n    doubt: {doubt}" for doubt in estimate.doubts[1:])
        return f"{head}: {estimate.message}  (failed, {estimate.seconds:.2f} s){more}"
    share = estimate.valid.sum() / max(1, estimate.object_pixels)
    sure = float(np.median(estimate.uncertainty_deg[estimate.valid]))
    depth = "" if estimate.depth is None else ", depth"
    doubts = estimate.doubts or ((estimate.message,) if estimate.message else ())
    lines = [f"doubt: {doubt}" for doubt in doubts]
    told = f"normals of {share:.0%} of the object{depth}, ±{sure:.2g}° expected  ({estimate.seconds:.2f} s)"
    return f"{head}  {estimate.verdict}: {told}" + "".join(f"\n    {line}" for line in (*lines, *estimate.steps))


def _current(folder: Path, method: str, results: Path) -> Estimate | None:
    """The method's estimate of the item in ``folder``, where it is on disk, whole, and made from this very picture.

    It is looked for in ``results`` and then beside the picture. Raises InputError if ``results``, outside the run, has
    one of another picture.
    """
    path = folder / PICTURE
    for place in dict.fromkeys((results, folder)):
        try:
            estimate, digest = read_estimate(place / "estimates", method)
        except InputError:
            continue
        if not path.is_file():
            raise InputError("no such picture", where=path)
        if digest == hashlib.sha256(path.read_bytes()).hexdigest():
            return estimate
        if place not in (folder, folder.resolve()):
            raise InputError(
                "an estimate of another picture of this name",
                expected="another --out, or --overwrite",
                where=place / "estimates" / f"{method}.json",
            )
    return None


def _lacks(estimate: Estimate | None, depth: bool) -> bool:
    return estimate is None or (depth and estimate.depth is None and bool(estimate.valid.any()))


def has_depth(observation: Observation) -> bool:
    return observation.camera.projection == "orthographic" or bool(observation.camera.focal_px)


def require_focal_length(observation: Observation, path: Path) -> None:
    """Raise InputError for a picture in perspective whose header does not tell where its rays go."""
    if not has_depth(observation):
        got = "a picture in perspective without one"
        raise InputError("--depth", got=got, expected="camera.focal_px in its header", where=path)


def _configured_methods(path: Path) -> tuple[str, ...]:
    """recover.methods of an item's config: the one key that is read there, for the rest describes the scene."""
    try:
        methods = tuple(str(m) for m in read_yaml(path)[0]["recover"]["methods"])
    except (KeyError, TypeError):
        return DEFAULT_METHODS
    check_methods(methods)
    return methods
