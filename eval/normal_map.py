"""Reads a normal map that another program made as an estimate: its coding, its frame, and where it has no normal.

Vectors of any length in the frame that is given, by default ours: x right, y up, z toward the camera. Pictures, and
arrays that can be nothing else, hold (n + 1) / 2 of full scale instead. There is no normal where the vector is zero or
not finite, where alpha or a mask says so, and where a coded pixel is a background: black, grey or white, or any colour
whose vector has not about unit length.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.eval.frames import OURS, Frame
from huesphere.eval.map_samples import SUFFIXES, Samples, read_samples
from huesphere.recover.io.estimate import Estimate

__all__ = ["SUFFIXES", "NormalMap", "read_map", "read_normal_map"]

CODED_LENGTHS = (0.5, 1.5)  # of vectors that a coded pixel can stand for; rounding to 8 bits changes a length by 1 %
UNIT_WITHIN = 0.05  # how far from 1 the median length of unit vectors may be
CODED_WITHIN = 0.1  # likewise of vectors decoded from (n + 1) / 2, which resampling shortens
NEGATIVE_BELOW = 0.02  # of the greatest value: what resampling leaves below zero in coded maps
NEGATIVE_SHARE = 0.005  # of the components: from here on they are vectors
SCALES = (1.0, 255.0, 65535.0)  # full scale of numbers that are coded, but not stored as unsigned whole numbers


@dataclass(frozen=True)
class NormalMap:
    """A normal map in the frame of its file."""

    vectors: np.ndarray  # (H, W, 3) float64, unit, NaN where there is none
    valid: np.ndarray  # (H, W) bool
    note: str  # how it was coded, if that is not said by the file; "" if there is nothing to say


def read_map(path: Path, shape: tuple[int, int], mask: np.ndarray | None = None) -> NormalMap:
    """Read the map in ``path``, still in its own frame.

    ``shape``: (H, W) of the picture; ``mask``: (H, W), the object, by which the coding is judged. Raises InputError for
    a damaged file, another size, or numbers that may be vectors as well as (n + 1) / 2.
    """
    samples = read_samples(path)
    if samples.values.shape != (*shape, 3):
        got = f"shape {samples.values.shape}"
        raise InputError("a normal map", got=got, expected=f"{(*shape, 3)}", where=path)
    scale, note = _full_scale(samples, mask, path)
    vectors = samples.values if scale is None else 2.0 * samples.values / scale - 1.0
    length = np.linalg.norm(vectors, axis=-1)
    least, most = (0.0, np.inf) if scale is None else CODED_LENGTHS
    with np.errstate(invalid="ignore"):
        valid = samples.counts & (length > least) & (length < most)
    unit = np.full(vectors.shape, np.nan)
    unit[valid] = vectors[valid] / length[valid, None]
    return NormalMap(unit, valid, note)


def read_normal_map(
    path: Path, method: str, shape: tuple[int, int], *, frame: Frame = OURS, mask: np.ndarray | None = None
) -> Estimate:
    """Return the normal map in ``path`` as the estimate of a ``method``; all pixels with a normal are its inliers.

    ``frame``: that of the map; for ``shape`` and ``mask`` see ``read_map``. The estimate's message says how the map was
    coded, and names a left-handed frame. Raises InputError as ``read_map`` does, and for normals that mostly face away
    from the camera.
    """
    found = read_map(path, shape, mask)
    normals = frame.to_camera(found.vectors).astype(np.float32)
    if found.valid.any() and np.median(normals[found.valid][:, 2]) < 0:
        expected = f"{frame.description} (n_z > 0); another frame is given by --frame, such as opencv"
        raise InputError("most normals face away from the camera", expected=expected, where=path)
    notes = [found.note, f"frame {frame.name}: {frame.description}" if frame.axes != OURS.axes else ""]
    unknown = np.full(shape, np.nan, dtype=np.float32)
    message = "; ".join(filter(None, notes))
    return Estimate(method, "ok", message, normals, found.valid, found.valid, unknown, seconds=float("nan"))


def _full_scale(samples: Samples, mask: np.ndarray | None, path: Path) -> tuple[float | None, str]:
    """(full scale of values that are (n + 1) / 2 of it, or None for vectors; a note on what is not self-evident).

    Unsigned whole numbers are coded, by the full scale of their type, or by a smaller one where only that gives unit
    vectors. Other numbers are coded if hardly any is negative and the vectors that they are as they stand have not unit
    length, but those decoded from them do. Raises InputError if neither do.
    """
    inside = samples.counts & np.isfinite(samples.values).all(axis=-1) & (np.ptp(samples.values, axis=-1) > 0)
    if mask is not None and (inside & mask).any():
        inside &= mask
    own = samples.values[inside]  # without black, grey and white, which are backgrounds
    if own.size == 0:
        return samples.full_scale, ""
    greatest = float(own.max())
    if samples.full_scale is None and (
        np.mean(own < -NEGATIVE_BELOW * greatest) > NEGATIVE_SHARE or _is_near_unit(own, UNIT_WITHIN)
    ):
        return None, ""
    for scale in dict.fromkeys((samples.full_scale or SCALES[0], *SCALES)):
        if greatest <= scale * (1 + NEGATIVE_BELOW) and _is_near_unit(2.0 * own / scale - 1.0, CODED_WITHIN):
            if scale == samples.full_scale:
                return scale, ""
            return scale, f"no component is negative: decoded from (n + 1)/2 of {scale:g}"
    raise InputError(
        "no component is negative: coded as (n + 1)/2?",
        got=f"values from {own.min():.3g} to {greatest:.3g}",
        expected="unit vectors, or (n + 1)/2 of 1, 255 or 65535",
        where=path,
    )


def _is_near_unit(vectors: np.ndarray, within: float) -> bool:
    """Whether the median length of (N, 3) ``vectors`` is 1, and most of them are about as long."""
    length = np.linalg.norm(vectors, axis=-1)
    return bool(abs(np.median(length) - 1.0) < within and np.mean(np.abs(length - 1.0) < 2 * within) > 0.5)
