"""Methods over a run folder, or over one picture: what is read, what is written, and where."""

import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError, Unfinished
from huesphere.configs.load import read_yaml
from huesphere.configs.own_folder import inside, made_folder
from huesphere.configs.regular_file import check_regular
from huesphere.configs.threads import one_blas_thread
from huesphere.recover.depth.integration import depth_from_normals
from huesphere.recover.geometry.rays import depth_of, of_relief, rays
from huesphere.recover.io.estimate import Estimate, read_estimate, write_estimate
from huesphere.recover.io.page import angle_between, two_digits, write_sheet
from huesphere.recover.io.picture import read_picture
from huesphere.recover.methods.table import METHODS
from huesphere.render.dataset import Observation, read_observation, write_observation
from huesphere.render.encoding import decode_srgb, encode_srgb
from huesphere.render.jobs import Lost, Progress, each
from huesphere.render.manifest import item_folder, read_manifest, remove_remains, sha256_of

DEFAULT_METHODS = ("auto",)

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
    folder: Path
    methods: tuple[str, ...]
    depth: bool
    overwrite: bool


# More than seven parameters: they are the options of the command, each on its own.
def recover_run(
    run_dir: Path,
    methods: Sequence[str] = (),
    *,
    depth: bool = False,
    overwrite: bool = False,
    jobs: int = 1,
    scheduler: str | None = None,
    report: Report = lambda line: None,
    progress: Progress = lambda share, what: None,
) -> list[tuple[str, Made]]:
    """Run the methods (none named: those of each item's config) on every finished item of a run folder.

    Reads <run>/<id>/observation.exr and nothing else of the scene; writes <run>/<id>/estimates/<method>.exr and .json.
    An estimate that is there and was made from the same picture stays, unless ``overwrite``; ``depth`` asks for depth
    too, and adds it to those that have none. Items are spread over ``jobs`` processes or the workers of a cluster.
    ``report`` is called with a line for each. Returns (item id, what was made). An item that cannot be read, or at
    which a method breaks off, does not stop the others: InputError or Unfinished is raised at the end.
    """
    check_methods(methods)
    remove_remains(run_dir)
    work: list[_Work] = []
    faults: list[str] = []
    broken: list[str] = []
    for item in read_manifest(run_dir)["items"]:
        if item["status"] != "done":
            continue
        folder = item_folder(run_dir, item["id"])
        try:
            wanted = tuple(methods) or _configured_methods(inside(folder, "config.yaml"))
            missing = [m for m in wanted if overwrite or _lacks(_current(folder, m), depth)]
        except InputError as error:
            faults.append(str(error))
            continue
        if missing:
            work.append(_Work(item["id"], folder.resolve(), tuple(missing), depth, overwrite))
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
    """What became of the methods that were to run on one item."""

    made: list[Made]
    fault: str = ""  # why the item cannot be read; "": it can
    broken: tuple[str, ...] = ()  # of each method that broke off, what with


def _recover_item(work: _Work, progress: Progress, log: Report) -> _Done:
    """Run and write what is missing of one item. A method that breaks off does not stop the others."""
    try:
        observation = read_observation(inside(work.folder, PICTURE))
        if work.depth:
            _require_focal_length(observation, work.folder / PICTURE)
    except InputError as error:
        return _Done([], str(error))
    made: list[Made] = []
    broken: list[str] = []
    for number, method in enumerate(work.methods):
        progress(number / len(work.methods), f"{work.item} {method}")
        try:
            there = None if work.overwrite else _current(work.folder, method)
            estimate = there or recover_one(observation, method)
            estimate = with_depth(estimate, observation) if work.depth else estimate
            write_estimate(work.folder / "estimates", estimate, work.folder / PICTURE)
        except InputError as error:
            return _Done(made, str(error), tuple(broken))
        except (ArithmeticError, ValueError, IndexError, MemoryError) as error:  # also LinAlgError
            broken.append(f"{work.item}: {method} broke off: {' '.join(f'{type(error).__name__}: {error}'.split())}")
            log(broken[-1])
            continue
        made.append(Made(method, estimate.status, describe(work.item, estimate)))
        log(made[-1].line)
    return _Done(made, broken=tuple(broken))


# More than seven parameters: they are the options of the command, each on its own.
def recover_picture(
    path: Path,
    methods: Sequence[str] = (),
    *,
    region: tuple[int, int, int, int] | None = None,
    mask: Path | None = None,
    encoding: str = "auto",
    out: Path | None = None,
    depth: bool = False,
    overwrite: bool = False,
    report: Report | None = None,
) -> Path:
    """Run the methods on one picture; returns the folder written.

    In it: observation.exr, estimates/<method>.exr and .json with depth, report.html and its images. There is no depth
    of pictures in perspective of unknown focal length; ``depth`` asks for it all the same, and is refused. The folder
    is ``out``, or <picture's name>-huesphere here. Raises InputError.
    """
    check_methods(methods)
    folder = out if out is not None else Path(f"{path.stem}-huesphere")
    if (folder / "estimates").exists() and not overwrite:
        raise InputError("there are estimates already (--overwrite makes them again)", where=folder)
    observation, how = read_picture(path, region=region, mask=mask, encoding=encoding)
    if depth:
        _require_focal_length(observation, path)
    if report is not None:
        report(how)
    made_folder(folder)
    write_observation(folder / "observation.exr", observation)
    estimates = []
    for method in methods or DEFAULT_METHODS:
        estimate = recover_one(observation, method)
        with one_blas_thread():  # as over run folders, so that the bytes do not depend on the number of threads
            estimate = with_depth(estimate, observation) if _has_depth(observation) else estimate
        write_estimate(folder / "estimates", estimate, folder / "observation.exr")
        estimates.append(estimate)
        if report is not None:
            report(describe(path.name, estimate))
    notes = encoding_notes(observation, next((e for e in estimates if e.valid.any()), estimates[0]))
    given = any(estimate.valid.any() for estimate in estimates)
    if given and not observation.camera.known:
        notes.append(NO_PROOF)
    if report is not None:
        for note in notes if given else [*notes, NOTHING]:
            report(note)
    write_sheet(folder, f"{path.name}: normals from one picture", how, observation, estimates, notes)
    return folder


def encoding_notes(observation: Observation, estimate: Estimate) -> list[str]:
    """What hangs on the encoding that was assumed, in sentences: the method is run again under the other assumption.

    Nothing for pictures of whose camera everything is known.
    """
    camera = observation.camera
    if camera.known:
        return []
    other = "linear" if camera.stored_as == "srgb" else "srgb"
    if other == "srgb" and camera.bits is None and observation.rgb.max() > 1:
        return ["Values above 1: taken as linear, which display-encoded samples cannot be."]
    samples = (encode_srgb if other == "linear" else decode_srgb)(observation.rgb.astype(np.float64))
    taken_otherwise = replace(observation, rgb=samples.astype(np.float32), camera=replace(camera, stored_as=other))
    again = recover_one(taken_otherwise, estimate.method)
    assumed, otherwise = ("decoded as sRGB", "taken as linear") if other == "linear" else ("linear", "sRGB")
    note = f"Encoding: the samples were {'taken to be ' * (other == 'srgb')}{assumed}; had they been {otherwise}, "
    turn = angle_between(estimate, again)
    if turn is not None:
        note += f"the normals of {estimate.method} would differ by {two_digits(turn)}° (median)"
        note += "" if again.status == "ok" else f" and its status would be {again.status}"
    elif again.status == estimate.status:
        note += f"{estimate.method} would end with {again.status} as well"
    else:
        note += f"{estimate.method} would end with {again.status}, now it ends with {estimate.status}"
    note += ". Colour is linear in the normal only in linear samples: where you can, give raw data."
    return [note]


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


def _current(folder: Path, method: str) -> Estimate | None:
    """The method's estimate of the item in ``folder``, where it is on disk, whole, and made from this very picture.

    Raises InputError if it or the picture is a link, pipe or device, or there is no picture.
    """
    for path in (inside(folder, "estimates", f"{method}{ending}") for ending in (".json", ".exr")):
        if path.exists():
            check_regular(path, follow=False)
    try:
        estimate, digest = read_estimate(folder / "estimates", method)
    except InputError:
        return None
    path = inside(folder, PICTURE)
    try:
        return estimate if digest == sha256_of(path) else None
    except FileNotFoundError:
        raise InputError("no such picture", where=path) from None


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
