"""What is known of a set of photographs before any of them is read, and how each of them is read.

Camera frame: x right, y up, z toward the camera, row 0 at the top. The photographs are cut to the object's surroundings
and, if asked for, reduced to means over squares of pixels; all arrays of a `PhotographSet` are of that size.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import ndimage

from huesphere.configs.errors import InputError

MARGIN = 4  # pixels that are kept around the object
LEAST_PIXELS = 64  # of an object
# Files round the normals of the outline to n3 = 0: they are taken as visible, and turned by 0.006° to the camera.
LEAST_Z = 1e-4
UNIT_WITHIN = 0.05  # a stored normal may differ from length 1 by so much: files round them to 8 or 16 bits


@dataclass(frozen=True)
class StoredSet:
    """A set as it lies on disk, at its full size. A reader for each layout gives one."""

    layout: str  # "diligent", "luces", "psm" or "npz"
    directions: np.ndarray  # (L, 3) unit, toward the light, NaN where it is not known
    mask: np.ndarray  # (H, W) bool, True on the object
    normals: np.ndarray | None  # (H, W, 3); None: the files have none
    inputs: tuple[Path, ...]  # every file that belongs to the set
    read: Callable[[int], tuple[np.ndarray, np.ndarray]]  # number → linear RGB per light's intensity; clipped (H, W)
    focal_px: float | None = None  # focal length in pixels; None: orthographic
    principal: tuple[float, float] | None = None  # column, row of the optical axis, in perspective


@dataclass(frozen=True)
class PhotographSet:
    """The set as a scene needs it: with true normals, cut and reduced. L lights, H rows, W columns."""

    layout: str
    directions: np.ndarray  # (L, 3) as in StoredSet
    mask: np.ndarray  # (H, W) bool
    normals: np.ndarray  # (H, W, 3) float32, unit, NaN off the mask
    inputs: tuple[Path, ...]
    focal_px: float | None
    picture: Callable[[int], tuple[np.ndarray, np.ndarray]]  # number → RGB (H, W, 3) float32, clipped (H, W) bool

    @property
    def count(self) -> int:
        """Number of photographs."""
        return len(self.directions)


def prepared(stored: StoredSet, *, reduce: int, sphere: bool, where: Path) -> PhotographSet:
    """The ``stored`` set with true normals, cut to its object and reduced to means over ``reduce`` × ``reduce`` pixels.

    ``sphere``: the normals are those of a ball whose outline is the mask. A reduced pixel is the object's where all of
    its pixels are, and its normal has the direction of the sum of theirs. Raises InputError for a set without normals,
    one with normals that are no unit vectors, and an object of too few pixels.
    """
    mask = stored.mask
    if sphere:
        normals = normals_of_ball(mask, where)
        mask = np.isfinite(normals).all(axis=-1)
    elif stored.normals is None:
        raise InputError(
            "no true normals in this set, so nothing can be scored",
            expected="a set with normals, or shape.normals=sphere for a ball; `recover` takes pictures without truth",
            where=where,
        )
    else:
        normals = stored.normals.astype(np.float64)
        mask = mask & _unit(normals, mask, where)
        normals[..., 2] = np.maximum(normals[..., 2], LEAST_Z)
    if not mask.any():
        raise InputError("an empty mask", where=where)
    rows, columns = _window(mask, stored.principal, reduce)
    mask, normals = mask[rows, columns], normals[rows, columns]
    normals = _block_means(np.where(mask[..., None], normals, 0.0), reduce)
    mask = _block_means(mask.astype(float), reduce) > 1 - 1e-9
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    normals = np.where(mask[..., None] & (length > 0), normals / np.where(length > 0, length, 1.0), np.nan)
    if mask.sum() < LEAST_PIXELS:
        raise InputError(
            "an object of few pixels", got=str(int(mask.sum())), expected=f"at least {LEAST_PIXELS}", where=where
        )

    def picture(number: int) -> tuple[np.ndarray, np.ndarray]:
        rgb, clipped = stored.read(number)
        if rgb.shape != (*stored.mask.shape, 3):
            raise InputError(
                f"photograph {number} is not of the mask's size", got=str(rgb.shape[:2]),
                expected=str(stored.mask.shape), where=where,
            )  # fmt: skip
        small = _block_means(rgb[rows, columns].astype(np.float64), reduce)
        if not np.isfinite(small[mask]).all():
            raise InputError(f"photograph {number} has values that are not finite", where=where)
        return small.astype(np.float32), _block_means(clipped[rows, columns].astype(float), reduce) > 0

    return PhotographSet(
        stored.layout,
        stored.directions,
        mask,
        normals.astype(np.float32),
        stored.inputs,
        None if stored.focal_px is None else stored.focal_px / reduce,
        picture,
    )


def normals_of_ball(mask: np.ndarray, where: Path) -> np.ndarray:
    """Normals (H, W, 3) of a ball whose outline is that of ``mask``, seen from far away; NaN outside of it.

    Its centre is the mean of the mask's pixels and its area theirs. Raises InputError for a mask that is no disc.
    """
    rows, columns = np.nonzero(mask)
    if not rows.size:
        raise InputError("an empty mask", where=where)
    radius = np.sqrt(rows.size / np.pi)
    y, x = (a - a_mean for a, a_mean in zip(np.indices(mask.shape), (rows.mean(), columns.mean()), strict=True))
    squared = (x**2 + y**2) / radius**2
    if np.mean((squared < 1) & mask) < 0.97 * np.mean(mask):
        raise InputError("shape.normals=sphere: the mask is no disc", where=where)
    inside = mask & (squared < 1)
    z = np.sqrt(np.where(inside, 1 - squared, np.nan))
    return np.where(inside[..., None], np.dstack([x / radius, -y / radius, z]), np.nan)


def _unit(normals: np.ndarray, mask: np.ndarray, where: Path) -> np.ndarray:
    """Where ``normals`` are finite and face the camera. Raises InputError if they are no unit vectors on the object."""
    length = np.linalg.norm(normals, axis=-1)
    given = np.isfinite(length) & (length > 0.5) & mask
    if not given.any():
        raise InputError("no normals on the object", where=where)
    if np.quantile(np.abs(length[given] - 1), 0.99) > UNIT_WITHIN:
        raise InputError("normals that are not unit vectors", got=f"lengths to {length[given].max():.3g}", where=where)
    if np.mean(normals[given][:, 2] > 0) < 0.5:
        raise InputError("normals that face away from the camera", expected="z toward the camera", where=where)
    return given & (normals[..., 2] >= -LEAST_Z)


def _window(mask: np.ndarray, principal: tuple[float, float] | None, reduce: int) -> tuple[slice, slice]:
    """Rows and columns around the object, whole multiples of ``reduce``; about the optical axis if there is one.

    In perspective the middle of the picture must stay on the axis: the window is symmetric about it as far as the
    picture allows.
    """
    (found,) = ndimage.find_objects(mask.astype(int))
    slices = []
    for axis, (one, size) in enumerate(zip(found, mask.shape, strict=True)):
        first, last = max(0, one.start - MARGIN), min(size, one.stop + MARGIN)
        if principal is not None:
            middle = principal[1 - axis]
            half = min(max(last - middle, middle - first), middle, size - middle)
            first, last = round(middle - half), round(middle + half)
        first, last = max(0, first), min(size, last)
        last = min(size, first + -(-(last - first) // reduce) * reduce)
        slices.append(slice(first, first + (last - first) // reduce * reduce))
    return slices[0], slices[1]


def _block_means(values: np.ndarray, side: int) -> np.ndarray:
    """Means over squares of ``side`` pixels of an array (H, W, …) whose sides are multiples of it."""
    if side == 1:
        return values
    height, width = values.shape[0] // side, values.shape[1] // side
    means: np.ndarray = values.reshape(height, side, width, side, *values.shape[2:]).mean(axis=(1, 3))
    return means
