"""Stated against true error: whether the error that a method states for a pixel is the one that it makes there.

Pixels are counted in a table of stated by true error, both on logarithmic scales, which can be added up over pictures.
A curve of the table has a point for each class of stated error: the true error's median and quartiles. Where a method
judges itself well, the median is a fixed share of the stated error, and the curve runs along the diagonal.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

# Edges in degrees: of stated errors five classes a decade, of true errors forty; what lies beyond is in the outermost.
STATED_EDGES_DEG = np.geomspace(0.01, 100.0, 21)
TRUE_EDGES_DEG = np.geomspace(1e-3, 100.0, 201)
LEAST_PIXELS = 20  # of a class, for a point of the curve


@dataclass(frozen=True)
class CalibrationCurve:
    """Quartiles of the true error by stated error, both in degrees, (K,) each."""

    stated_deg: np.ndarray  # geometric middle of each class that has LEAST_PIXELS pixels
    low_deg: np.ndarray  # lower quartile of the true errors
    median_deg: np.ndarray
    high_deg: np.ndarray  # upper quartile
    pixels: np.ndarray  # (K,) int


def count_errors(stated_deg: np.ndarray, error_deg: np.ndarray) -> np.ndarray:
    """Number of pixels of each class of stated error and of true error, (20, 200) int, where both are finite."""
    both = np.isfinite(stated_deg) & np.isfinite(error_deg)
    x, y = (
        np.clip(np.searchsorted(edges, values[both], side="right") - 1, 0, len(edges) - 2)
        for edges, values in ((STATED_EDGES_DEG, stated_deg), (TRUE_EDGES_DEG, error_deg))
    )
    counts = np.zeros((len(STATED_EDGES_DEG) - 1, len(TRUE_EDGES_DEG) - 1), dtype=np.int64)
    np.add.at(counts, (x, y), 1)
    return counts


def calibration_curve(tables: Sequence[np.ndarray]) -> CalibrationCurve:
    """The curve of one or several pictures, whose tables of ``count_errors`` are added: each pixel counts the same."""
    counts = np.sum(tables, axis=0)
    rows = np.flatnonzero(counts.sum(axis=1) >= LEAST_PIXELS)
    middle = np.sqrt(STATED_EDGES_DEG[:-1] * STATED_EDGES_DEG[1:])
    low, median, high = np.array([_quartiles(counts[row]) for row in rows]).reshape(-1, 3).T
    return CalibrationCurve(middle[rows], low, median, high, counts[rows].sum(axis=1))


def _quartiles(counts: np.ndarray) -> np.ndarray:
    """The three quartiles in degrees of errors counted by TRUE_EDGES_DEG, log-linear within a class."""
    below = np.concatenate([[0.0], np.cumsum(counts)]) / counts.sum()
    return np.exp(np.interp([0.25, 0.5, 0.75], below, np.log(TRUE_EDGES_DEG)))
