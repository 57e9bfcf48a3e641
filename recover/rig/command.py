"""`recover --calibrate` and `recover --rig`: pictures by path, a rig.json, and the folders of results."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.threads import one_blas_thread
from huesphere.recover.io.estimate import write_estimate
from huesphere.recover.io.page import write_sheet
from huesphere.recover.io.picture import PictureRead, ReadOptions, open_picture
from huesphere.recover.io.picture_folder import claim_folder, folder_name, in_order, remove_images
from huesphere.recover.rig.ball import Ball, check_ball, find_ball
from huesphere.recover.rig.calibrate import Calibration, CalibrationPicture, calibrate
from huesphere.recover.rig.estimate import METHOD, estimate_of
from huesphere.recover.rig.live import DARKEST, Rig
from huesphere.recover.rig.markers import dark_spots, has_markers
from huesphere.recover.rig.model import read_rig, write_rig
from huesphere.recover.run import describe
from huesphere.render.dataset import Observation

RIG_FILE = "rig.json"
ORDERS = {0: "constant", 1: "linear", 2: "quadratic"}
Report = Callable[[str], None]


@dataclass(frozen=True)
class RigOptions:
    """What a user says of the pictures of a rig beyond their paths, and of what is written."""

    reference: Path | None = None  # a picture of the empty rig, which the others are divided by
    mask: Path | None = None  # the object, in all pictures but the reference
    encoding: str = "auto"  # of the samples, as of `recover.io.picture.open_picture`
    reading: ReadOptions = field(default_factory=ReadOptions)
    out: Path | None = None  # folder to write in; None: here
    overwrite: bool = False  # what is there already is made again


def read_for_rig(path: Path, options: RigOptions = RigOptions()) -> PictureRead:
    """A picture in linear light. Raises InputError for one in perspective, for a rig's rays are taken as parallel."""
    read = open_picture(path, mask=options.mask, encoding=options.encoding, options=options.reading)
    if read.observation.camera.projection != "orthographic":
        raise InputError("a picture in perspective", expected="parallel rays, for a rig", where=path)
    return read


def calibrate_rig(
    paths: Sequence[Path],
    balls: Sequence[Ball] = (),
    options: RigOptions = RigOptions(),
    *,
    report: Report = lambda line: None,
) -> Path:
    """Calibrate a rig from pictures of a ball; returns the path of the rig.json written.

    ``balls``: one a picture, in their order, or several of one picture; none: each picture shows a ball in full view,
    which is found by its silhouette. Raises InputError.
    """
    written = (options.out or Path()) / RIG_FILE
    if written.exists() and not options.overwrite:
        raise InputError("there is a rig already (--overwrite makes it again)", where=written)
    if balls and len(paths) > 1 and len(balls) != len(paths):
        raise InputError("--ball", got=f"{len(balls)} for {len(paths)} pictures", expected="one for each picture")
    if not balls and options.reference is not None:
        expected = "--ball X,Y,R for each picture: the circle that a pressed ball shows is not its silhouette"
        raise InputError("--reference without --ball", expected=expected, where=options.reference)
    reads = [read_for_rig(path, options) for path in paths]
    size = reads[0].observation.mask.shape
    for read, path in zip(reads, paths):
        report(read.how)
        _check_size(read.observation, size, path, "the first picture's")
    empty = _empty_rig(options, size, "the pictures'")
    found = [_ball(read.observation, path, report) for read, path in zip(reads, paths)] if not balls else list(balls)
    shown = list(zip(reads * len(found) if len(reads) == 1 else reads, found))
    for number, (read, ball) in enumerate(shown):
        check_ball(ball, read.observation.mask.shape, paths[min(number, len(paths) - 1)])
    markers = empty is not None and has_markers(empty.rgb)
    pictures = [_calibration_picture(read.observation, empty, ball, markers) for read, ball in shown]
    with one_blas_thread():
        done = calibrate(
            pictures, divided=empty is not None, markers=markers, encoding=reads[0].observation.camera.stored_as
        )
    written.parent.mkdir(parents=True, exist_ok=True)
    write_rig(written, done.rig)
    for line in described(done):
        report(line)
    return written


def recover_by_rig(
    paths: Sequence[Path],
    rig: Path,
    options: RigOptions = RigOptions(),
    *,
    report: Report = lambda line: None,
) -> list[Path]:
    """Normals, depth and a page of each picture by a calibrated rig; returns the folders written. Raises InputError.

    A folder is that of the ``options``, or <picture's name>-huesphere here; of several pictures, each is
    <name>-huesphere in it.
    """
    model = read_rig(rig)
    size = (model.size[1], model.size[0])
    empty = _empty_rig(options, size, "the rig's")
    try:
        calibrated = Rig(model, None if empty is None else empty.rgb)
    except InputError as error:
        raise InputError(f"--reference: {error}", where=rig) from None
    folders = [_folder(path, options.out, len(paths) > 1) for path in paths]
    for path, folder in zip(paths, folders):
        read = read_for_rig(path, options)
        _check_size(read.observation, size, path, "the rig's")
        report(read.how)
        there = claim_folder(folder, read.observation, overwrite=options.overwrite)
        if not options.overwrite and any(estimate.method == METHOD for estimate in there):
            raise InputError("there is an estimate already (--overwrite makes it again)", where=folder)
        with one_blas_thread():
            estimate = estimate_of(calibrated, read.observation)
        remove_images(folder, METHOD)
        write_estimate(folder / "estimates", estimate, folder / "observation.exr")
        report(describe(path.name, estimate))
        notes = [_note(calibrated, rig)]
        title = f"{path.name}: normals by a calibrated rig"
        write_sheet(folder, title, read.how, read.observation, in_order([estimate], there), notes)
    return folders


def _empty_rig(options: RigOptions, shape: tuple[int, ...], whose: str) -> Observation | None:
    """The reference picture, if there is one. Raises InputError for one of another size (H, W)."""
    if options.reference is None:
        return None
    empty = read_for_rig(options.reference, replace(options, mask=None)).observation
    _check_size(empty, shape, options.reference, whose)
    return empty


def described(done: Calibration) -> list[str]:
    """What a calibration found, in lines for the user."""
    rig = done.rig
    tried = ", ".join(f"{ORDERS[order]} {error:.2g}°" for order, error in done.by_order.items())
    left_out = "balls" if rig.balls > 1 else "sectors of the ball"
    lines = [
        f"F is {ORDERS[rig.order]} in position: median errors of {left_out} left out: {tried}",
        f"the sphere is seen up to {', '.join(f'{circle:.2f}' for circle in done.circles)} of its radius",
    ]
    if rig.markers:
        lines.append("the reference carries dark markers, which are interpolated")
    if rig.mm_per_px is not None:
        lines.append(f"{rig.mm_per_px:.4g} mm a pixel")
    return lines


def _note(rig: Rig, path: Path) -> str:
    model = rig.model
    balls = "1 ball" if model.balls == 1 else f"{model.balls} balls"
    note = f"By {path.name} of {model.date}: F(x) {ORDERS[model.order]} in position, from {balls}, "
    note += f"{model.leave_one_out_deg:.2g}° off (median) on what was left out of the fit."
    return note if model.mm_per_px is None else f"{note} A pixel is {model.mm_per_px:.4g} mm."


def _folder(path: Path, out: Path | None, several: bool) -> Path:
    name = folder_name(path, None)
    if several:
        return (out or Path()) / name
    return Path(name) if out is None else out


def _check_size(observation: Observation, shape: tuple[int, ...], path: Path, whose: str) -> None:
    """Raise InputError for a picture of another size (H, W)."""
    if observation.mask.shape != shape:
        got, expected = (f"{width}×{height} pixels" for height, width in (observation.mask.shape, shape))
        raise InputError(f"a picture of another size than {whose}", got=got, expected=expected, where=path)


def _ball(observation: Observation, path: Path, report: Report) -> Ball:
    ball = find_ball(observation.rgb, observation.mask, path)
    report(f"{path.name}: found a ball at {ball.x:.1f},{ball.y:.1f}, radius {ball.radius:.1f} pixels")
    return ball


def _calibration_picture(
    observation: Observation, empty: Observation | None, ball: Ball, markers: bool
) -> CalibrationPicture:
    """ρ of a picture, and where it can be used: light in each channel (no lamp hidden), not clipped, no marker."""
    rgb = observation.rgb.astype(np.float64)
    usable = np.isfinite(rgb).all(axis=-1) & observation.mask & (np.nan_to_num(rgb).min(axis=-1) > DARKEST)
    pairs = [observation] if empty is None else [observation, empty]
    for one in pairs:
        if one.camera.saturation is not None:
            with np.errstate(invalid="ignore"):
                usable &= ~(one.rgb >= one.camera.saturation).any(axis=-1)
        if markers:
            usable &= ~dark_spots(np.nan_to_num(one.rgb))
    if empty is not None:
        usable &= (np.nan_to_num(empty.rgb) > DARKEST).all(axis=-1)
        rgb = rgb / np.maximum(np.nan_to_num(empty.rgb), DARKEST)
    return CalibrationPicture(np.nan_to_num(rgb), usable, ball)
