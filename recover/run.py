"""Runs methods on the items of a run folder; and the steps that this shares with the recovery of one picture."""

import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError, Unfinished
from huesphere.configs.load import read_yaml
from huesphere.configs.own_folder import inside
from huesphere.configs.regular_file import check_regular
from huesphere.recover.depth.integration import depth_from_normals
from huesphere.recover.geometry.rays import depth_of, of_relief, rays
from huesphere.recover.io.estimate import Estimate, read_estimate, write_estimate
from huesphere.recover.methods.table import METHODS, check_methods
from huesphere.render.dataset import Observation, read_observation
from huesphere.render.jobs import Lost, Progress, each
from huesphere.render.manifest import item_folder, read_manifest, remove_remains, sha256_of
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
    """Run ``methods`` on every finished item of a run folder; returns (item id, what was made) for each new estimate.

    If ``methods`` is empty, an item's methods are those of its config, else DEFAULT_METHODS. Of an item the function
    reads observation.exr; without ``methods`` also the key recover.methods of the item's config.yaml, and no other key
    there. It never reads the truth. It writes <run>/<id>/estimates/<method>.exr and .json. If ``out`` is given,
    estimates are written to <out>/<id>/estimates, and an estimate that is up to date in the run folder counts as
    present. An estimate that is present and was made from the same picture stays, unless ``overwrite``. With ``depth``,
    estimates get depth too; it is added to those that are present without depth.

    Items are spread over ``jobs`` processes or the workers of a cluster. ``report`` is called with a line for each
    estimate. An item that cannot be read, or at which a method raises an error, does not stop the others. At the end
    InputError is raised if there were bad inputs, else Unfinished if a method raised an error; the text is the first of
    the sorted messages and the number of the others.
    """
    check_methods(methods)
    root = results_root(run_dir, out)
    if root == run_dir:
        remove_remains(run_dir)
    work, faults = _missing_work(run_dir, root, methods, depth, overwrite)
    broken: list[str] = []
    for one in work:
        require_writable(one.results / "estimates")
    made: list[tuple[str, Made]] = []
    with closing(each(_recover_item, work, jobs=jobs, scheduler=scheduler, progress=progress, log=report)) as results:
        for number, result in results:
            if isinstance(result, Lost):
                broken.append(f"{work[number].item}: {result.why}")
                continue
            made += [(work[number].item, one) for one in result.made]
            faults += [result.fault] if result.fault else []
            broken += result.broken
    more = len(faults) + len(broken) - 1
    text = f"{min(faults or broken, default='')}{f' (and {more} more)' if more > 0 else ''}"
    if faults:
        raise InputError(text)
    if broken:
        raise Unfinished(text)
    return made


@dataclass(frozen=True)
class _Done:
    """The estimates that were made of one item, and the errors."""

    made: list[Made]
    fault: str = ""  # why the item cannot be read; "": it can
    broken: tuple[str, ...] = ()  # a message for each method that raised an error


def _missing_work(
    run_dir: Path, root: Path, methods: Sequence[str], depth: bool, overwrite: bool
) -> tuple[list[_Work], list[str]]:
    """(work for each finished item that lacks estimates, a line for each item that cannot be read).

    ``root``: folder in which the items' estimates lie or are to be written; the others as for ``recover_run``.
    """
    work: list[_Work] = []
    faults: list[str] = []
    for item in read_manifest(run_dir)["items"]:
        if item["status"] != "done":
            continue
        folder, place = item_folder(run_dir, item["id"]), item_folder(root, item["id"])
        try:
            wanted = tuple(methods) or _configured_methods(inside(folder, "config.yaml"))
            missing = [m for m in wanted if overwrite or _lacks(_current(folder, m, place), depth)]
        except InputError as error:
            faults.append(str(error))
            continue
        if missing:
            work.append(_Work(item["id"], folder.resolve(), place.resolve(), tuple(missing), depth, overwrite))
    return work, faults


def _recover_item(work: _Work, progress: Progress, log: Report) -> _Done:
    """Make and write the missing estimates of one item. A method that raises an error does not stop the others."""
    try:
        observation = read_observation(inside(work.folder, PICTURE))
        if work.depth:
            require_focal_length(observation, work.folder / PICTURE)
    except InputError as error:
        return _Done([], str(error))
    made: list[Made] = []
    broken: list[str] = []
    for number, method in enumerate(work.methods):
        progress(number / len(work.methods), f"{work.item} {method}")
        try:
            there = None if work.overwrite else _current(work.folder, method, work.results)
            estimate = there or recover_one(observation, method)
            estimate = with_depth(estimate, observation) if work.depth else estimate
            write_estimate(work.results / "estimates", estimate, work.folder / PICTURE)
        except InputError as error:
            return _Done(made, str(error), tuple(broken))
        except (ArithmeticError, ValueError, IndexError, MemoryError) as error:  # also LinAlgError
            broken.append(f"{work.item}: {method} broke off: {' '.join(f'{type(error).__name__}: {error}'.split())}")
            log(broken[-1])
            continue
        made.append(Made(method, estimate.status, describe(work.item, estimate)))
        log(made[-1].line)
    return _Done(made, broken=tuple(broken))


def recover_one(observation: Observation, method: str, most_pixels: int | None = None) -> Estimate:
    """The timed estimate of one picture by one method; ``most_pixels`` as in `recover.methods.calling.estimate_by`."""
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
    """A line on ``what``, an estimate: method, status, verdict, share of the object, expected error, seconds.

    Further lines give the doubts and the steps.
    """
    head = f"{what}  {estimate.method}  {estimate.status}"
    if estimate.verdict == "failed":
        more = "".join(f"\n    doubt: {doubt}" for doubt in estimate.doubts[1:])
        return f"{head}: {estimate.message}  (failed, {estimate.seconds:.2f} s){more}"
    share = estimate.valid.sum() / max(1, estimate.object_pixels)
    sure = float(np.median(estimate.uncertainty_deg[estimate.valid]))
    depth = "" if estimate.depth is None else ", depth"
    doubts = estimate.doubts or ((estimate.message,) if estimate.message else ())
    lines = [f"doubt: {doubt}" for doubt in doubts]
    normals = f"normals of {share:.0%} of the object{depth}, ±{sure:.2g}° expected  ({estimate.seconds:.2f} s)"
    return f"{head}  {estimate.verdict}: {normals}" + "".join(f"\n    {line}" for line in (*lines, *estimate.steps))


def _current(folder: Path, method: str, results: Path) -> Estimate | None:
    """The method's estimate of the item in ``folder`` if it is complete on disk and made from this picture; else None.

    It is looked for in ``results`` and then beside the picture. Raises InputError if it or the picture is a link, pipe
    or device, if there is no picture, or if ``results``, outside the run, has an estimate of another picture.
    """
    picture = inside(folder, PICTURE)
    for place in dict.fromkeys((results, folder)):
        for path in (inside(place, "estimates", f"{method}{ending}") for ending in (".json", ".exr")):
            if path.exists():
                check_regular(path, follow=False)
        try:
            estimate, digest = read_estimate(place / "estimates", method)
        except InputError:
            continue
        try:
            if digest == sha256_of(picture):
                return estimate
        except FileNotFoundError:
            raise InputError("no such picture", where=picture) from None
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
    """Raise InputError for a picture in perspective whose header has no focal length."""
    if not has_depth(observation):
        got = "a picture in perspective without one"
        raise InputError("--depth", got=got, expected="camera.focal_px in its header", where=path)


def _configured_methods(path: Path) -> tuple[str, ...]:
    """recover.methods of an item's config, the only key that is read there, because the others describe the scene."""
    try:
        methods = tuple(str(m) for m in read_yaml(path)[0]["recover"]["methods"])
    except (KeyError, TypeError):
        return DEFAULT_METHODS
    check_methods(methods)
    return methods
