"""Errors by what the light does at a pixel: lit by all lights, in an attached shadow, in a cast shadow; interpolated.

The first three follow from the truth, the last from what the method says of its normal. Each pixel of the object is of
one kind: interpolated where the method says so; else in a cast shadow where any light is hidden by the surface, wholly
or in part; else in an attached shadow where the surface is turned away from any light; else lit.
"""

from dataclasses import dataclass

import numpy as np

from huesphere.eval.metrics import SHARES, median, quantiles
from huesphere.render.dataset import Truth

REGIONS = ("lit", "attached shadow", "cast shadow", "interpolated")
NAN = float("nan")


@dataclass(frozen=True)
class RegionErrors:
    """Errors of one kind of pixel, in degrees; NaN where there is nothing to measure."""

    region: str  # of REGIONS
    pixels: int  # of the object that are of this kind
    share: float  # of the object's pixels
    coverage: float  # share of them that have a normal
    mean_deg: float
    median_deg: float
    p90_deg: float
    stated_median_deg: float  # median error that the method states for them


def region_map(truth: Truth, reason: np.ndarray | None, mask: np.ndarray) -> np.ndarray:
    """The kind of each pixel as an index in REGIONS, (H, W) int; −1 off the object.

    Args:
        truth: shadows of each light. Without lights in it every pixel that is not interpolated counts as lit.
        reason: (H, W) codes of ``recover.reasons``; None: of a method from elsewhere, which says nothing.
        mask: (H, W) bool, the object.
    """
    kind = np.zeros(mask.shape, dtype=np.int8)
    kind[(truth.attached_shadow > 0).any(axis=-1)] = 1
    kind[(truth.cast_shadow > 0).any(axis=-1)] = 2
    if reason is not None:
        kind[np.isin(reason, SHARES["interpolated"])] = 3
    kind[~mask] = -1
    return kind


def errors_by_region(kind: np.ndarray, error_deg: np.ndarray, stated_deg: np.ndarray) -> tuple[RegionErrors, ...]:
    """The errors of each kind of pixel that the picture has, in the order of REGIONS.

    Args:
        kind: (H, W) of ``region_map``.
        error_deg: (H, W), NaN where not scored.
        stated_deg: (H, W), the error that the method expects, NaN where it says none.
    """
    total = int((kind >= 0).sum())
    found = []
    for number, name in enumerate(REGIONS):
        own = kind == number
        pixels = int(own.sum())
        if not pixels:
            continue
        error = error_deg[own]
        error = error[np.isfinite(error)]
        mean, middle, p90 = (error.mean(), *quantiles(error, [0.5, 0.9])) if error.size else (NAN, NAN, NAN)
        stated = median(stated_deg[own & np.isfinite(error_deg)])
        coverage = error.size / pixels
        found.append(
            RegionErrors(name, pixels, pixels / total, coverage, float(mean), float(middle), float(p90), stated)
        )
    return tuple(found)
