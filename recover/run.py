"""Methods over a run folder, or over one picture: what is read, what is written, and where."""

import hashlib
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.load import read_yaml
from huesphere.recover.depth.integration import depth_from_normals
from huesphere.recover.full_size.picture import reduced
from huesphere.recover.geometry.rays import depth_of, of_relief, rays
from huesphere.recover.geometry.reduction import reduction_of
from huesphere.recover.io.estimate import Estimate, read_estimate, write_estimate
from huesphere.recover.io.page import angle_between, two_digits, write_sheet
from huesphere.recover.io.picture import PictureRead, ReadOptions, open_picture
from huesphere.recover.io.picture_folder import claim_folder, in_order, remove_images
from huesphere.recover.methods.table import METHODS
from huesphere.render.dataset import Observation, linear_light, read_observation
from huesphere.render.jobs import Lost, Progress, each
from huesphere.render.manifest import item_folder, read_manifest
from huesphere.render.results import require_writable, results_root

DEFAULT_METHODS = ("auto",)

QUICK = "weak-integrability"  # the method by which two readings of a picture are compared …
QUICK_PIXELS = 10_000  # … on a picture of at most so many object pixels

PICTURE = "observation.exr"
NO_PROOF = (
    "An ellipsoid that fits does not show that the lights were of several colours: many an ordinary photograph fits "
    "one. Hold the surface against a shape that you know."
)
NOTHING = "There are no normals: what failed, and what would help, is in the lines above and on the page."

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
            _require_focal_length(observation, work.folder / PICTURE)
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


# More than seven parameters: they are the options of the command, each on its own.
def recover_picture(
    path: Path,
    methods: Sequence[str] = (),
    *,
    region: tuple[int, int, int, int] | None = None,
    mask: Path | None = None,
    encoding: str = "auto",
    options: ReadOptions = ReadOptions(),  # noqa: B008 (frozen)
    out: Path | None = None,
    depth: bool = False,
    overwrite: bool = False,
    report: Report | None = None,
) -> Path:
    """Run the methods on one picture; returns the folder written.

    In it: observation.exr, estimates/<method>.exr and .json with depth, report.html and its images. There is no depth
    of pictures in perspective of unknown focal length; ``depth`` asks for it all the same, and is refused. The folder
    is ``out``, or <picture's name>-huesphere here. Estimates of the same picture that are there stay, and are on the
    page too; ``overwrite`` makes them again, and removes those of another picture. Raises InputError.
    """
    check_methods(methods)
    folder = out if out is not None else Path(f"{path.stem}-huesphere")
    read = open_picture(path, region=region, mask=mask, encoding=encoding, options=options)
    observation, how = read.observation, read.how
    if depth:
        _require_focal_length(observation, path)
    if report is not None:
        report(how)
    there = claim_folder(folder, observation, overwrite=overwrite)
    kept = set() if overwrite else {estimate.method for estimate in there}
    wanted = [method for method in methods or DEFAULT_METHODS if method not in kept]
    if not wanted:
        raise InputError("there are estimates already (--overwrite makes them again)", where=folder)
    estimates = []
    for method in wanted:
        remove_images(folder, method)
        estimate = recover_one(observation, method)
        estimate = with_depth(estimate, observation) if _has_depth(observation) else estimate
        write_estimate(folder / "estimates", estimate, folder / "observation.exr")
        estimates.append(estimate)
        if report is not None:
            report(describe(path.name, estimate))
    notes = encoding_notes(
        read,
        next((e for e in estimates if e.valid.any()), estimates[0]),
        lambda other: open_picture(path, region=region, mask=mask, encoding=other, options=options).observation,
    )
    given = any(estimate.valid.any() for estimate in estimates)
    if given and not observation.camera.known:
        notes.append(NO_PROOF)
    if report is not None:
        for note in notes if given else [*notes, NOTHING]:
            report(note)
    shown = in_order(estimates, there)
    write_sheet(folder, f"{path.name}: normals from one picture", how, observation, shown, notes)
    return folder


def encoding_notes(read: PictureRead, estimate: Estimate, read_as: Callable[[str], Observation]) -> list[str]:
    """What hangs on how the samples were taken to be encoded, in sentences.

    Both readings are compared on a reduced picture, by QUICK: what the encoding changes, it changes for every method
    and at every size. ``read_as`` reads the picture again as "srgb" or "linear". Nothing for pictures of which no other
    reading is possible: those of run folders, and raw files.
    """
    camera = read.observation.camera
    if camera.known or read.certain:
        return []
    other = "linear" if camera.stored_as == "srgb" else "srgb"
    if other == "srgb" and camera.bits is None and read.observation.rgb.max() > 1:
        return ["Values above 1: taken as linear, which display-encoded samples cannot be."]
    taken, again = (recover_one(_small(one), QUICK) for one in (read.observation, read_as(other)))
    decoded = f"decoded as {read.encoded}", "taken as linear"
    assumed, otherwise = decoded if other == "linear" else ("linear", "sRGB")
    note = f"Encoding: the samples were {'taken to be ' * (other == 'srgb')}{assumed}; had they been {otherwise}, "
    turn = angle_between(taken, again)
    if turn is not None:
        note += f"the normals would differ by {two_digits(turn)}° (median, by {QUICK} on a small picture)"
        note += f" and the status would be {again.status}" if again.status != taken.status else ""
    elif again.status == taken.status:
        note += f"{QUICK} would end with {again.status} as well"
    else:
        note += f"{QUICK} would end with {again.status}, now it ends with {taken.status}"
    note += ". Colour is linear in the normal only in linear samples: where you can, give raw data."
    if read.guessed and again.verdict == "trust" and "trust" not in (taken.verdict, estimate.verdict):
        note += f" THE GUESS IS PROBABLY WRONG: --encoding {other} ends with {again.status}."
    elif read.guessed:
        note += " That they are so is a guess, because the file does not say: give --encoding."
    return [note]


def _small(observation: Observation) -> Observation:
    """The observation in linear light, of at most QUICK_PIXELS object pixels."""
    linear = linear_light(observation)
    by = reduction_of(linear.mask, QUICK_PIXELS)
    return linear if by is None else reduced(linear, by)


def recover_one(observation: Observation, method: str) -> Estimate:
    """One method on one picture, timed."""
    started = time.perf_counter()
    estimate = METHODS[method](observation)
    return replace(estimate, seconds=time.perf_counter() - started)


def with_depth(estimate: Estimate, observation: Observation) -> Estimate:
    """The estimate with the depth of its normals over all of the object, or as it is where it has no normals."""
    if not estimate.valid.any():
        return estimate
    ray = rays(observation.camera, observation.mask.shape)
    relief = depth_from_normals(of_relief(estimate.normals, ray), estimate.valid, observation.mask)
    depth = depth_of(relief, None if ray is None else observation.camera.focal_px)
    return replace(estimate, depth=depth.astype(np.float32))


def check_methods(methods: Sequence[str]) -> None:
    """Raise InputError for a name that is no method, with the nearest that is."""
    for name in methods:
        if name not in METHODS:
            near = get_close_matches(name, METHODS, n=1)
            expected = f"{near[0]!r} (did you mean it?)" if near else f"one of {', '.join(METHODS)}"
            raise InputError("no such method", got=name, expected=expected, where="--method")


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


def _has_depth(observation: Observation) -> bool:
    return observation.camera.projection == "orthographic" or bool(observation.camera.focal_px)


def _require_focal_length(observation: Observation, path: Path) -> None:
    """Raise InputError for a picture in perspective whose header does not tell where its rays go."""
    if not _has_depth(observation):
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
