"""The public function that scores one normal map: some columns of metrics.csv for a pair of arrays."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.eval.metrics import Row, error_image, measure


@dataclass(frozen=True)
class Scores:
    """Angular errors in degrees over the pixels that have a normal, and the share of these. NaN if there are none."""

    mean_deg: float
    median_deg: float
    p90_deg: float
    p95_deg: float
    rms_deg: float
    coverage: float  # share of the object that has a normal
    within_1: float  # share of the scored pixels whose error is below 1 degree; likewise the next four
    within_5: float
    within_11_25: float
    within_22_5: float
    within_30: float
    median_deg_flip: float  # the smaller median of the normals and their convex/concave twin
    median_deg_gauge: float  # median after the best orthogonal alignment to the truth
    error_deg: np.ndarray = field(repr=False)  # (H, W), NaN where not scored

    def __repr__(self) -> str:
        degrees = f"median {self.median_deg:.3g}°, mean {self.mean_deg:.3g}°, p90 {self.p90_deg:.3g}°"
        return f"Scores({degrees}, {self.coverage:.0%} covered)"


def score(normals: Any, truth: Any, mask: Any = None) -> Scores:
    """Compare ``normals`` (H, W, 3) with the ``truth`` (H, W, 3), both in the camera frame, of any length.

    ``mask`` (H, W): the object; by default the pixels where the truth is finite. Normals that are NaN or zero are not
    scored and lower the coverage. Raises InputError for wrong shapes.

    >>> import numpy as np
    >>> up = np.broadcast_to([0.0, 0.0, 1.0], (4, 4, 3))
    >>> tilted = np.broadcast_to([0.0, np.sin(np.radians(3)), np.cos(np.radians(3))], (4, 4, 3))
    >>> found = score(tilted, up)
    >>> round(found.median_deg, 6), found.coverage, found.within_5
    (3.0, 1.0, 1.0)
    """
    given, wanted = (_vectors(values, name) for values, name in ((normals, "normals"), (truth, "truth")))
    if given.shape != wanted.shape:
        raise InputError("normals and truth", got=f"shapes {given.shape} and {wanted.shape}", expected="the same")
    known = np.isfinite(wanted).all(axis=-1)
    inside = known if mask is None else np.asarray(mask).astype(bool) & known
    if inside.shape != wanted.shape[:2]:
        raise InputError("mask", got=f"an array of shape {inside.shape}", expected=str(wanted.shape[:2]))
    error = error_image(given, np.isfinite(given).all(axis=-1), wanted, inside)
    unknown = np.full(inside.shape, np.nan)
    row = measure(Row("", "", "", "ok"), error, given, wanted, inside, np.zeros_like(inside), unknown)
    columns = {name: float(getattr(row, name)) for name in Scores.__dataclass_fields__ if name != "error_deg"}
    return Scores(**columns, error_deg=error)


def _vectors(values: Any, name: str) -> np.ndarray:
    """``values`` as an array (H, W, 3) of float64. Raises InputError for another shape or type."""
    array = np.asarray(values)
    if array.ndim != 3 or array.shape[2] != 3 or array.dtype.kind not in "uif":
        raise InputError(name, got=f"an array of shape {array.shape}", expected="(height, width, 3) numbers")
    return array.astype(np.float64)
