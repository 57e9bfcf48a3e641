"""Methods over a run folder, or over one picture: what is read, what is written, and where."""

import hashlib
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path

import numpy as np
import yaml

from configs.errors import InputError
from recover.depth import depth_from_normals
from recover.estimate import Estimate, read_estimate, write_estimate
from recover.methods import METHODS
from recover.picture import read_picture
from recover.sheet import angle_between, write_sheet
from render.dataset import Observation, read_observation, write_observation
from render.manifest import item_folder, read_manifest

DEFAULT_METHODS = ("auto",)

Report = Callable[[str], None]


def recover_run(
    run_dir: Path,
    methods: Sequence[str] = (),
    *,
    depth: bool = False,
    overwrite: bool = False,
    report: Report | None = None,
) -> list[tuple[str, Estimate]]:
    """Run the methods (none named: those of each item's config) on every finished item of a run folder.

    Reads <run>/<id>/observation.exr and nothing else of the scene; writes <run>/<id>/estimates/<method>.exr and .json.
    An estimate that is there and was made from the same picture stays, unless ``overwrite``; ``depth`` asks for depth
    too, and adds it to those that have none. ``report`` is called with a line for each. Returns (item id, estimate) of
    those written now. Raises InputError.
    """
    check_methods(methods)
    made = []
    for item in read_manifest(run_dir)["items"]:
        if item["status"] != "done":
            continue
        folder = item_folder(run_dir, item["id"])
        path = folder / "observation.exr"
        wanted = methods or _configured_methods(folder / "config.yaml")
        there = {} if overwrite else {m: _current(folder / "estimates", m, path) for m in wanted}
        missing = [m for m in wanted if (e := there.get(m)) is None or (depth and _lacks_depth(e))]
        if not missing:
            continue
        observation = read_observation(path)
        if depth:
            _require_orthographic(observation, path)
        for method in missing:
            estimate = there.get(method) or recover_one(observation, method)
            estimate = with_depth(estimate, observation) if depth else estimate
            write_estimate(folder / "estimates", estimate, path)
            made.append((str(item["id"]), estimate))
            if report is not None:
                report(describe(str(item["id"]), estimate))
    return made


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
    of pictures in perspective; ``depth`` asks for it all the same, and is refused. The folder is ``out``, or
    <picture's name>-huesphere here. Raises InputError.
    """
    check_methods(methods)
    folder = out if out is not None else Path(f"{path.stem}-huesphere")
    if (folder / "estimates").exists() and not overwrite:
        raise InputError("there are estimates already (--overwrite makes them again)", where=folder)
    observation, how = read_picture(path, region=region, mask=mask, encoding=encoding)
    if depth:
        _require_orthographic(observation, path)
    if report is not None:
        report(how)
    folder.mkdir(parents=True, exist_ok=True)
    write_observation(folder / "observation.exr", observation)
    estimates = []
    for method in methods or DEFAULT_METHODS:
        estimate = recover_one(observation, method)
        estimate = with_depth(estimate, observation) if observation.camera.projection == "orthographic" else estimate
        write_estimate(folder / "estimates", estimate, folder / "observation.exr")
        estimates.append(estimate)
        if report is not None:
            report(describe(path.name, estimate))
    notes = encoding_notes(observation, next((e for e in estimates if e.valid.any()), estimates[0]))
    if report is not None:
        for note in notes:
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
    other = "linear" if camera.encoding == "srgb" else "srgb"
    if other == "srgb" and camera.bits is None and observation.rgb.max() > 1:
        return ["Values above 1: taken as linear, which display-encoded samples cannot be."]
    again = recover_one(replace(observation, camera=replace(camera, encoding=other)), estimate.method)
    assumed, otherwise = ("decoded as sRGB", "taken as linear") if other == "linear" else ("linear", "sRGB")
    note = f"Encoding: the samples were {'taken to be ' * (other == 'srgb')}{assumed}; had they been {otherwise}, "
    turn = angle_between(estimate, again)
    if turn is not None:
        note += f"the normals of {estimate.method} would differ by {turn:.2g}° (median)"
        note += "" if again.status == "ok" else f" and its status would be {again.status}"
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
    depth = depth_from_normals(estimate.normals, estimate.valid, observation.mask)
    return replace(estimate, depth=depth.astype(np.float32))


def check_methods(methods: Sequence[str]) -> None:
    """Raise InputError for a name that is no method, with the nearest that is."""
    for name in methods:
        if name not in METHODS:
            near = get_close_matches(name, METHODS, n=1)
            expected = f"{near[0]!r} (did you mean it?)" if near else f"one of {', '.join(METHODS)}"
            raise InputError("no such method", got=name, expected=expected, where="--method")


def describe(what: str, estimate: Estimate) -> str:
    """How an estimate ended, for how much of the object, how sure, how long it took; then `auto`'s steps."""
    head = f"{what}  {estimate.method}  {estimate.status}"
    if estimate.status != "ok":
        return f"{head}: {estimate.message}  ({estimate.seconds:.2f} s)"
    share = estimate.valid.sum() / max(1, estimate.diagnostics["pixels"]["object"])
    sure = float(np.median(estimate.uncertainty_deg[estimate.valid]))
    depth = "" if estimate.depth is None else ", depth"
    return f"{head}  normals of {share:.0%} of the object{depth}, ±{sure:.2g}° expected  ({estimate.seconds:.2f} s)"


def _current(folder: Path, method: str, observation_path: Path) -> Estimate | None:
    """The method's estimate, where it is on disk, whole, and made from this very picture."""
    try:
        estimate, digest = read_estimate(folder, method)
    except InputError:
        return None
    return estimate if digest == hashlib.sha256(observation_path.read_bytes()).hexdigest() else None


def _lacks_depth(estimate: Estimate) -> bool:
    return estimate.depth is None and bool(estimate.valid.any())


def _require_orthographic(observation: Observation, path: Path) -> None:
    """Raise InputError for a camera whose pixels are not equally far apart on the object: slopes are not per pixel."""
    projection = observation.camera.projection
    if projection != "orthographic":
        raise InputError("--depth", got=f"a picture in {projection}", expected="an orthographic one", where=path)


def _configured_methods(path: Path) -> tuple[str, ...]:
    """recover.methods of an item's config: the one key that is read there, for the rest describes the scene."""
    try:
        methods = tuple(str(m) for m in yaml.safe_load(path.read_text(encoding="utf-8"))["recover"]["methods"])
    except (OSError, yaml.YAMLError, KeyError, TypeError):
        return DEFAULT_METHODS
    check_methods(methods)
    return methods
