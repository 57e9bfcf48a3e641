"""`recover --calibrate` and `recover --rig`: pictures by path, a rig.json, and the folders of results."""

from collections.abc import Callable, Sequence
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


def read_for_rig(
    path: Path,
    encoding: str = "auto",
    mask: Path | None = None,
    options: ReadOptions = ReadOptions(),  # noqa: B008
) -> PictureRead:
    """A picture in linear light. Raises InputError for one in perspective, for a rig's rays are taken as parallel."""
    read = open_picture(path, mask=mask, encoding=encoding, options=options)
    if read.observation.camera.projection != "orthographic":
        raise InputError("a picture in perspective", expected="parallel rays, for a rig", where=path)
    return read


# More than seven parameters: they are the options of the command, each on its own.
def calibrate_rig(
    paths: Sequence[Path],
    balls: Sequence[Ball] = (),
    *,
    reference: Path | None = None,
    mask: Path | None = None,
    encoding: str = "auto",
    options: ReadOptions = ReadOptions(),  # noqa: B008 (frozen)
    out: Path | None = None,
    overwrite: bool = False,
    report: Report = lambda line: None,
) -> Path:
    """Calibrate a rig from pictures of a ball; returns the path of the rig.json written, in ``out`` or here.

    ``balls``: one a picture, in their order, or several of one picture; none: each picture shows a ball in full view,
    which is found by its silhouette. ``reference``: a picture of the empty rig, which the others are divided by.
    Raises InputError.
    """
    written = (out or Path()) / RIG_FILE
    if written.exists() and not overwrite:
        raise InputError("there is a rig already (--overwrite makes it again)", where=written)
    if balls and len(paths) > 1 and len(balls) != len(paths):
        raise InputError("--ball", got=f"{len(balls)} for {len(paths)} pictures", expected="one for each picture")
    if not balls and reference is not None:
        expected = "--ball X,Y,R for each picture: the circle that a pressed ball shows is not its silhouette"
        raise InputError("--reference without --ball", expected=expected, where=reference)
    reads = [read_for_rig(path, encoding, mask, options) for path in paths]
    for read, path in zip(reads, paths):
        report(read.how)
        _check_size(read.observation, reads[0].observation.mask.shape, path, "the first picture's")
    empty = None if reference is None else read_for_rig(reference, encoding, None, options).observation
    if empty is not None and reference is not None:
        _check_size(empty, reads[0].observation.mask.shape, reference, "the pictures'")
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


# More than seven parameters: they are the options of the command, each on its own.
def recover_by_rig(
    paths: Sequence[Path],
    rig: Path,
    *,
    reference: Path | None = None,
    mask: Path | None = None,
    encoding: str = "auto",
    options: ReadOptions = ReadOptions(),  # noqa: B008 (frozen)
    out: Path | None = None,
    overwrite: bool = False,
    report: Report = lambda line: None,
) -> list[Path]:
    """Normals, depth and a page of each picture by a calibrated rig; returns the folders written. Raises InputError.

    A folder is ``out``, or <picture's name>-huesphere here; of several pictures, each is <name>-huesphere in ``out``.
    """
    model = read_rig(rig)
    size = (model.size[1], model.size[0])
    empty = None
    if reference is not None:
        empty = read_for_rig(reference, encoding, None, options).observation
        _check_size(empty, size, reference, "the rig's")
    try:
        calibrated = Rig(model, None if empty is None else empty.rgb)
    except InputError as error:
        raise InputError(f"--reference: {error}", where=rig) from None
    folders = [_folder(path, out, len(paths) > 1) for path in paths]
    for path, folder in zip(paths, folders):
        read = read_for_rig(path, encoding, mask, options)
        _check_size(read.observation, size, path, "the rig's")
        report(read.how)
        there = claim_folder(folder, read.observation, overwrite=overwrite)
        if not overwrite and any(estimate.method == METHOD for estimate in there):
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
