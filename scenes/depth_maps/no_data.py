"""Which samples of a depth map are surface, and which only mark that there is none.

What a file or a config declares decides. Where nothing is declared, samples that are not finite are gaps, and so is a
value far outside all others that is known as such a mark (the extreme of the sample type, -9999, 65504, 1e10 …) or that
fills much of the map. For samples of exactly 0 see ``_zero_gaps``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from huesphere.scenes.depth_maps.stored import StoredDepth

MARKS = (-9999.0, 9999.0, -99999.0, -32768.0, -32767.0, 32767.0, 65535.0, 65504.0)  # that programs write for no data
HUGE = 1e9  # a value of this size or more, far from all others, is such a mark too: 1e10, 1e20, 3.4e38 …
GAP = 0.1  # of the range of the others: how far a known mark lies outside them, at least
UNKNOWN_GAP, UNKNOWN_SHARE = 0.25, 0.25  # the same for any value, which then fills this share of the map
FAR_GAP, FAR_COUNT = 5.0, 16  # … or lies this far outside, in this many samples
STEPS = 2.0  # times the largest step between neighbouring values of the others: a mark lies further outside
FEW_ZEROS = 0.01  # share of the map: fewer zeros among depths of both signs are depths
MOST_MARKS = 4  # different marks in one map

Choice = Literal["auto", "none"] | float | tuple[float, ...]


@dataclass(frozen=True)
class Surface:
    """The samples that are surface, and remarks for the log about the others."""

    mask: np.ndarray  # (H, W) bool
    said: tuple[str, ...]


def surface_of(stored: StoredDepth, choice: Choice) -> Surface:
    """Which samples of ``stored`` are surface; ``choice`` is the key no_data of the config."""
    with np.errstate(all="ignore"):  # differences of huge values
        return _surface_of(stored, choice)


def _surface_of(stored: StoredDepth, choice: Choice) -> Surface:
    values = stored.samples.astype(float)
    mask = np.isfinite(values)
    said: list[str] = []
    if not isinstance(choice, str):
        wanted = choice if isinstance(choice, tuple) else (choice,)
        mask &= ~_drop(values, wanted, stored.samples.dtype, mask, "as shape.no_data says", said)
        return Surface(mask if stored.mask is None else mask & stored.mask, tuple(said))
    if stored.mask is not None:
        return Surface(mask & stored.mask, ())
    if choice == "none":
        return Surface(mask, ())
    if stored.no_data:
        mask &= ~_drop(values, stored.no_data, stored.samples.dtype, mask, "as the file says", said)
    declared = bool(stored.no_data) or not mask.all()
    found = _find_marks(values, mask, stored.samples.dtype, said) if not stored.no_data else False
    mask &= ~_zero_gaps(values, mask, declared, found, said)
    said += _plateaus(values[mask], values.size)
    return Surface(mask, tuple(said))


def _drop(
    values: np.ndarray, marks: Sequence[float], dtype: np.dtype, mask: np.ndarray, why: str, said: list[str]
) -> np.ndarray:
    """Where ``values`` are one of ``marks`` (in the precision of ``dtype``); their number goes into ``said``."""
    gone = np.zeros(values.shape, dtype=bool)
    for mark in marks:
        if np.isfinite(mark):
            gone |= mask & (np.abs(values - mark) <= _rounding(dtype) * abs(mark))
            said.append(f"no data: {mark:.10g}, {why}: {int(gone.sum())} samples")
    return gone


def _rounding(dtype: np.dtype) -> float:
    """Relative difference up to which a stored value equals a number that was written in decimals."""
    return 1e-3 if dtype == np.float16 else 1e-6 if dtype.kind == "f" else 0.0


def _find_marks(values: np.ndarray, mask: np.ndarray, dtype: np.dtype, said: list[str]) -> bool:
    """Take the values out of ``mask`` (in place) that mark no data without saying so; whether there were any."""
    found = False
    for _ in range(MOST_MARKS):
        inside = values[mask]
        if len(inside) == 0:
            break
        ends = [end for end in (_end(inside, inside.min()), _end(inside, inside.max())) if end is not None]
        marks = [end for end in ends if end.value != 0 and _is_mark(end, dtype, values.size)]
        if not marks:
            break
        mark = max(marks, key=lambda end: end.gap)
        mask &= values != mark.value
        found = True
        said.append(
            f"no data: {mark.value:.10g} is taken for background, {mark.count} samples; the others are {mark.low:.6g} "
            f"to {mark.high:.6g} (shape.no_data says otherwise)"
        )
    return found


@dataclass(frozen=True)
class _End:
    """The smallest or the largest value of a map, and how it lies to the others."""

    value: float
    count: int  # samples that have it
    gap: float  # to the nearest of the others
    low: float  # of the others
    high: float
    step: float  # the largest between neighbouring values of the others


def _end(values: np.ndarray, value: float) -> _End | None:
    others = values[values != value]
    if len(others) == 0:
        return None
    low, high = float(others.min()), float(others.max())
    gap = low - float(value) if value < low else float(value) - high
    # Values that are neither apart from the others nor frequent need no steps, whose sorting takes time.
    asked = gap > GAP * (high - low) or len(others) < (1 - UNKNOWN_SHARE) * len(values)
    steps = np.diff(np.unique(others)) if asked else np.zeros(0)
    return _End(float(value), len(values) - len(others), gap, low, high, float(steps.max()) if len(steps) else 0.0)


def _is_mark(end: _End, dtype: np.dtype, size: int) -> bool:
    """Whether an end of the values is no depth."""
    spread = end.high - end.low
    if end.gap <= STEPS * end.step or end.gap <= GAP * spread:
        return False
    if end.value in MARKS or abs(end.value) >= HUGE or end.value in _extremes(dtype):
        return True
    if spread == 0:
        return False
    fills = end.count >= UNKNOWN_SHARE * size and end.gap > UNKNOWN_GAP * spread
    return fills or (end.count >= FAR_COUNT and end.gap > FAR_GAP * spread)


def _plateaus(inside: np.ndarray, size: int) -> list[str]:
    """A line for the smallest and the largest value if it fills much of the map, apart from the others, and is kept."""
    if len(inside) == 0:
        return []
    ends = (_end(inside, inside.min()), _end(inside, inside.max()))
    return [
        f"{end.value:.10g} is kept as a depth although it fills {end.count / size:.0%} of the map and lies apart from "
        f"the others (shape.no_data: {end.value:.10g} if it is none)"
        for end in ends
        if end is not None and end.count >= UNKNOWN_SHARE * size and end.gap > end.step > 0
    ]


def _extremes(dtype: np.dtype) -> tuple[float, ...]:
    """The smallest and the largest value of a sample type."""
    if dtype.kind in "iu":
        return float(np.iinfo(dtype).min), float(np.iinfo(dtype).max)
    return (float(np.finfo(dtype).min), float(np.finfo(dtype).max)) if dtype.kind == "f" else ()


def _zero_gaps(values: np.ndarray, mask: np.ndarray, declared: bool, found: bool, said: list[str]) -> np.ndarray:
    """Where a 0 means no surface, (H, W) bool.

    ``declared``: the file declares a mark, or some samples are not finite; then 0 is a depth. ``found``: another mark
    was found; then 0 is a gap only if all other depths have one sign, and it lies far outside them like a known mark.
    Else 0 is a gap if all other depths have one sign, or if it is at least the share FEW_ZEROS of the map.
    """
    zeros = mask & (values == 0)
    count, others = int(zeros.sum()), values[mask & ~zeros]
    nowhere = np.zeros_like(zeros)
    if count == 0 or len(others) == 0:
        return zeros
    if declared:
        said.append(f"0 is kept as a depth ({count} samples), because others mark the gaps (shape.no_data: 0 if not)")
        return nowhere
    outside = (others > 0).all() or (others < 0).all()
    if found:
        end = _end(values[mask], 0.0) if outside else None
        outside = end is not None and end.gap > max(GAP * (end.high - end.low), STEPS * end.step)
    elif not outside:
        outside = count >= FEW_ZEROS * values.size
    if not outside:
        said.append(f"0 is kept as a depth ({count} samples; shape.no_data: 0 if it is none)")
        return nowhere
    said.append(f"no data: 0 is taken for background, {count} samples (shape.no_data: none keeps it)")
    return zeros
