"""A list of points x y z as a depth map, where the points lie on a regular square grid."""

from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.scenes.depth_maps.stored import StoredDepth

LEAST_POINTS = 16  # a table of three columns with fewer rows is taken as a grid
OFF_GRID = 0.02  # of a step: how far a point may lie from its place on the grid
SPARSEST = 0.05  # share of the cells of the grid that have a point, at least


def grid_of_points(table: np.ndarray, path: Path, said: tuple[str, ...]) -> StoredDepth:
    """The grid (H, W) of points (n, 3) x y z: x to the right, y up, z toward the camera; NaN where no point is.

    The spacing of the grid is that of x and y, in whose unit z is taken to be. Raises InputError for points that do not
    lie on a regular grid.
    """
    if not np.isfinite(table[:, :2]).all():
        raise _no_grid(path, "coordinates that are not finite")
    step = min(_step(table[:, 0]), _step(table[:, 1]))
    if not 0 < step < np.inf:
        raise _no_grid(path, "points on one line")
    cells = (table[:, :2] - table[:, :2].min(axis=0)) / step
    nearest = np.round(cells)
    cols, rows = (int(n) + 1 for n in nearest.max(axis=0))
    if np.abs(cells - nearest).max() > OFF_GRID or len(table) < SPARSEST * rows * cols:
        raise _no_grid(path, "points off any square grid")
    col, row = nearest[:, 0].astype(int), rows - 1 - nearest[:, 1].astype(int)
    if len(np.unique(row * cols + col)) < len(table):
        raise _no_grid(path, "two points at one place")
    samples = np.full((rows, cols), np.nan)
    samples[row, col] = table[:, 2]
    remark = f"a list of {len(table)} points x y z on a grid of {cols} x {rows}, {step:.6g} apart"
    return StoredDepth(samples, spacing=step, said=(*said, remark))


def _step(values: np.ndarray) -> float:
    """The smallest distance of neighbouring values, without those that are equal up to rounding; inf for one value."""
    steps = np.diff(np.unique(values))
    steps = steps[steps > 1e-6 * np.ptp(values)] if len(steps) else steps
    return float(steps.min()) if len(steps) else np.inf


def _no_grid(path: Path, why: str) -> InputError:
    return InputError(
        "three columns are a list of points x y z, not a grid of depths",
        got=why,
        expected="a row of depths a line, or points on a regular square grid",
        where=path,
    )
