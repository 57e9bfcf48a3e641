"""Paired comparison of methods: ratio of their errors on the same pixels of the same scenes, with an interval.

The overall median errors of two methods depend on the pictures that each was run on and on the pixels for which each
gives normals. So errors are compared picture by picture, only on pixels for which both give normals, as ratios, and for
each level of transport by itself. The interval comes from resampling whole scenes, because the pixels of a picture are
not independent. Percentile bootstrap: B. Efron and R. Tibshirani, "An Introduction to the Bootstrap", 1993, section
13.3.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from huesphere.eval.metrics import compared, median
from huesphere.eval.score import Case

LEAST_SCENES = 5  # no interval is given for fewer scenes
RESAMPLES = 4000
# A smaller error counts as this, so that ratios are finite. It is far below what matters in practice, and hundreds of
# times the error that storing normals in single precision causes, a few millionths of a degree.
LEAST_ERROR_DEG = 1e-3


@dataclass(frozen=True)
class Pair:
    """Two methods on one picture."""

    scene: str  # name of the config; scenes are what is resampled
    transport: str
    first: str  # name of a method
    second: str
    first_deg: float  # median error of the first over the pixels for which both give normals
    second_deg: float
    pixels: int  # number of these pixels


@dataclass(frozen=True)
class Comparison:
    """Two methods over all scenes where both give normals; with a ratio below 1 the first has the smaller errors."""

    transport: str  # of the pictures: levels of transport are never mixed
    first: str
    second: str
    scenes: int
    ratio: float  # geometric mean over scenes of first / second
    low: float  # 95 % interval of the ratio; NaN where the scenes are too few
    high: float
    first_better: float  # share of the scenes

    @property
    def decided(self) -> bool:
        """Whether 1 is outside the interval, so that one method is better."""
        return bool(self.high < 1.0 or self.low > 1.0)


def pairs(scene: str, transport: str, cases: Sequence[Case]) -> list[Pair]:
    """Return every pair of methods that are ok or doubtful on one picture and have normals at common pixels."""
    found = []
    good = [case for case in cases if compared(case.score.row)]
    for first, second in combinations(good, 2):
        common = np.isfinite(first.error_deg) & np.isfinite(second.error_deg)
        if common.any():
            of_first, of_second = (median(case.error_deg[common]) for case in (first, second))
            names = first.score.row.method, second.score.row.method
            found.append(Pair(scene, transport, *names, of_first, of_second, int(common.sum())))
    return found


def compare(of_pictures: Sequence[Pair], *, seed: int = 0) -> list[Comparison]:
    """Return one comparison for every pair of methods and transport; the most unequal errors come first.

    The interval contains the middle 95 % of the ratios of
    ``RESAMPLES`` samples of as many scenes, drawn with replacement.
    """
    grouped: dict[tuple[str, str, str], dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for pair in of_pictures:
        log_ratio = np.log(max(pair.first_deg, LEAST_ERROR_DEG) / max(pair.second_deg, LEAST_ERROR_DEG))
        grouped[pair.transport, pair.first, pair.second][pair.scene].append(float(log_ratio))
    comparisons = []
    for (transport, first, second), scenes in grouped.items():
        logs = np.array([np.mean(of_scene) for of_scene in scenes.values()])
        low = high = np.nan
        if len(logs) >= LEAST_SCENES:
            drawn = np.random.default_rng(seed).integers(0, len(logs), (RESAMPLES, len(logs)))
            low, high = np.exp(np.quantile(logs[drawn].mean(axis=1), [0.025, 0.975]))
        ratio, better = float(np.exp(logs.mean())), float(np.mean(logs < 0))
        comparisons.append(Comparison(transport, first, second, len(logs), ratio, float(low), float(high), better))
    return sorted(comparisons, key=lambda c: -abs(np.log(c.ratio)))
