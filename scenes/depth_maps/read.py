"""Reads a depth map file of any format into a grid of depths toward the camera."""

from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np
from scipy import ndimage

from huesphere.configs.errors import InputError
from huesphere.configs.picture_size import require_size
from huesphere.scenes.depth_maps.exr import read_exr
from huesphere.scenes.depth_maps.no_data import Choice, surface_of
from huesphere.scenes.depth_maps.points import LEAST_POINTS, grid_of_points
from huesphere.scenes.depth_maps.raster import read_png, read_tiff
from huesphere.scenes.depth_maps.stored import StoredDepth
from huesphere.scenes.depth_maps.text import read_text
from huesphere.scenes.surfaces import DepthGrid

LEAST_SAMPLES = 16
DEEPEST = 1e6  # times the sides of the grid


def _nothing(_: str) -> None:
    return


def read_depth_map(
    path: Path,
    *,
    depth_scale: float | Literal["auto"] = "auto",
    toward_camera: bool | None = None,
    no_data: Choice = "auto",
    channel: str | None = None,
    log: Callable[[str], None] = _nothing,
) -> DepthGrid:
    """Read a depth map (H, W) from a file: depth toward the camera, in grid steps, row 0 at the top.

    Formats: npz (array ``depth``, optional array ``mask``), npy, EXR, PNG or TIFF of one channel (16-bit values are not
    reduced to 8 bits), or text: a row of numbers a line, an ESRI ASCII grid, or a list of x y z on a regular grid.
    ``depth_scale``: grid steps per stored unit; "auto": 1, or what follows from the spacing that the file states.
    ``toward_camera``: whether the stored depth grows toward the camera; if not, its sign is changed; None: it does,
    unless the name of an EXR channel says that it is a distance. ``no_data``: stored values that are no surface (see
    ``scenes.depth_maps.no_data``). ``channel``: of an EXR file. ``log`` is called with lines for the user on what was
    taken how. Raises InputError for a file that cannot be read, or that holds no depth map of plausible shape and size.
    """
    if not path.is_file():
        raise InputError("no such depth map", where=path)
    if channel is not None and path.suffix.lower() != ".exr":
        raise InputError("shape.channel is for EXR files", got=channel, where=path)
    require_size(path)
    stored = _read_samples(path, channel)
    _require_numbers(stored, path)
    if stored.samples.ndim == 2 and stored.samples.shape[1] == 3 and len(stored.samples) >= LEAST_POINTS:
        stored = grid_of_points(stored.samples.astype(float), path, stored.said)
    if stored.samples.ndim != 2 or min(stored.samples.shape) < 2:
        shape = stored.samples.shape
        raise InputError(
            "a depth map", got=f"an array of shape {shape}", expected="two dimensions of 2 or more", where=path
        )
    if stored.mask is not None and stored.mask.shape != stored.samples.shape:
        got = f"{stored.mask.shape} and {stored.samples.shape}"
        raise InputError("mask and depth differ in shape", got=got, where=path)
    surface = surface_of(stored, no_data)
    if surface.mask.sum() < LEAST_SAMPLES:
        raise InputError(
            "a depth map with too few valid samples",
            got=f"{int(surface.mask.sum())}{'; ' if surface.said else ''}{'; '.join(surface.said)}",
            expected=f"{LEAST_SAMPLES} or more",
            where=path,
        )
    scale = depth_scale if depth_scale != "auto" else 1.0 if stored.spacing is None else 1.0 / stored.spacing
    toward = not stored.is_distance if toward_camera is None else toward_camera
    depth = np.where(surface.mask, stored.samples.astype(float), 0.0) * (scale if toward else -scale)
    inside = depth[surface.mask]
    if np.abs(inside).max() > DEEPEST * max(depth.shape):
        raise InputError(
            "depth in grid steps",
            got=f"{np.abs(inside).max():.3g}",
            expected="a sane size (shape.no_data?)",
            where=path,
        )
    for line in (*stored.said, *surface.said):
        log(f"depth map: {line}")
    log(_sign_and_range(stored, surface.mask, scale, toward, toward_camera is None))
    return DepthGrid(_fill(depth, surface.mask), surface.mask)


def _sign_and_range(stored: StoredDepth, mask: np.ndarray, scale: float, toward: bool, guessed: bool) -> str:
    """A line for the log: the stored range, the direction in which it was taken to grow, and the unit."""
    inside = stored.samples[mask].astype(float)
    way = "toward the camera" if toward else "away from the camera"
    why = ""
    if guessed:
        why = ", as distances of a renderer do" if stored.is_distance else ""
        why += f" (shape.toward_camera: {str(not toward).lower()} if not)"
    unit = "" if scale == 1.0 else f"; a unit is {scale:.4g} grid steps"
    return f"depth map: {inside.min():.6g} to {inside.max():.6g} as stored, growing {way}{why}{unit}"


def _read_samples(path: Path, channel: str | None) -> StoredDepth:
    suffix = path.suffix.lower()
    try:
        if suffix == ".npz":
            with np.load(path, allow_pickle=False) as file:
                if "depth" not in file:
                    raise InputError("no array 'depth'", got=f"arrays {', '.join(file.files)}", where=path)
                return StoredDepth(file["depth"], file["mask"].astype(bool) if "mask" in file else None)
        if suffix == ".npy":
            return StoredDepth(np.load(path, allow_pickle=False))
        if suffix == ".exr":
            return read_exr(path, channel)
        if suffix == ".png":
            return read_png(path)
        return read_tiff(path) if suffix in (".tif", ".tiff") else read_text(path)
    except InputError:
        raise
    except (OSError, ValueError, EOFError, KeyError, SyntaxError) as error:
        raise InputError("not a readable depth map", got=f"{type(error).__name__}: {error}", where=path) from None
    except Exception as error:  # image and zip readers raise types of their own
        raise InputError("not a readable depth map", got=type(error).__name__, where=path) from None


def _require_numbers(stored: StoredDepth, path: Path) -> None:
    """Raise InputError unless the samples are an array of real numbers."""
    samples = stored.samples
    if not isinstance(samples, np.ndarray) or samples.dtype.kind not in "fiub":
        got = samples.dtype if isinstance(samples, np.ndarray) else type(samples).__name__
        raise InputError("samples of a kind that is no depth", got=str(got), expected="real numbers", where=path)


def _fill(depth: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """``depth`` (H, W) with each sample off the mask replaced by the nearest on it, so that resampling has no jump."""
    nearest = ndimage.distance_transform_edt(~mask, return_distances=False, return_indices=True)
    return depth[tuple(nearest)]
