"""Several methods on many pictures of a run: estimates are made once, kept on disk and scored, in several processes."""

import hashlib
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.eval import metrics
from huesphere.eval.metrics import Row, angular_error_deg
from huesphere.eval.studies.pictures import Log, Rendered, median, read
from huesphere.recover.io.estimate import Estimate, read_estimate, write_estimate
from huesphere.recover.run import recover_one
from huesphere.render.layers import PARTS

# Name, among the methods of a table, of the normals n = F⁻¹ρ with the true F of direct light, at pixels that see every
# light: the error that remains is that of the linear model.
KNOWN_F = "known lights"


@dataclass(frozen=True)
class Measured:
    """One picture: the shares of its light, how well the linear model fits it, and the scores of the methods."""

    item: str  # id, <config>/<transport>
    shares: tuple[float, float, float]  # shares of the object's light, in the order of PARTS
    residual: float  # as ``linear_residual``
    rows: tuple[Row, ...]  # one for each method, and one for KNOWN_F where F is known
    least_indirect_deg: float  # median error of KNOWN_F in the quarter of pixels with the least indirect light
    most_indirect_deg: float  # the same in the quarter of pixels with the most indirect light
    facts: dict[str, float]  # cond_F, highlight_share, sees_all, indirect; NaN where not known

    def median_deg(self, method: str, *, flip: bool = False) -> float:
        """Median error of a method in degrees, NaN where it declines.

        ``flip``: the smaller of the median errors of its normals and of their convex/concave twin.
        """
        row = next((row for row in self.rows if row.method == method and row.status == "ok"), None)
        if row is None:
            return float("nan")
        return row.median_deg_flip if flip and np.isfinite(row.median_deg_flip) else row.median_deg

    def status(self, method: str) -> str:
        """The status of a method on this picture; "not run" if it was not run."""
        return next((row.status for row in self.rows if row.method == method), "not run")


def measure_all(run: Path, wanted: Sequence[tuple[str, Sequence[str]]], jobs: int, log: Log) -> dict[str, Measured]:
    """Measure pictures of a run folder with several methods; returns what was measured by item id.

    ``wanted``: (item id, names of methods) of each picture. Estimates that are on disk are not made again. ``jobs``:
    number of processes. ``log`` is called after every tenth of the pictures.
    """
    found: dict[str, Measured] = {}
    report = _progress_by_tenths(log, len(wanted))
    measure = partial(_measure, run)
    if jobs < 2 or len(wanted) < 4:
        for item, methods in wanted:
            found[item] = measure((item, tuple(methods)))
            report(len(found))
        return found
    # New processes, not forked ones: threads of numba do not survive a fork.
    with ProcessPoolExecutor(max_workers=jobs, mp_context=get_context("spawn")) as pool:
        for measured in pool.map(measure, [(item, tuple(methods)) for item, methods in wanted], chunksize=2):
            found[measured.item] = measured
            report(len(found))
    return found


def _progress_by_tenths(log: Log, total: int) -> Callable[[int], None]:
    """A function that is called with the number of pictures done, and logs every tenth of ``total``."""

    def report(done: int) -> None:
        if done == total or done % max(1, total // 10) == 0:
            log(f"recovered {done} of {total} pictures")

    return report


def _measure(run: Path, wanted: tuple[str, tuple[str, ...]]) -> Measured:
    """Measure one picture: ``wanted`` is (item id, names of methods)."""
    item, methods = wanted
    config, transport = item.rsplit("/", 1)
    picture = read(run, item)
    rows = []
    for method in methods:
        estimate = estimate_of(picture, method)
        row = Row(config, transport, method, estimate.status, seconds=estimate.seconds, message=estimate.message)
        error = metrics.error_image(estimate.normals, estimate.valid, picture.truth.normals, picture.mask)
        rows.append(
            metrics.measure(
                row,
                error,
                estimate.normals,
                picture.truth.normals,
                picture.mask,
                estimate.inlier,
                estimate.uncertainty_deg,
            )
        )
    least_indirect = most_indirect = float("nan")
    shares, indirect = light_shares(picture)
    if picture.truth.facts.get("F") is not None:
        error = known_lights_error(picture)
        scored = error[np.isfinite(error)]
        row = Row(config, transport, KNOWN_F, "ok" if scored.size else "no pixel sees every light")
        pixels = int(picture.mask.sum())
        columns = metrics.error_columns(scored)
        rows.append(_with(row, columns, pixels, scored.size))
        least_indirect, most_indirect = _by_indirect_light(error, indirect)
    residual = linear_residual(picture)
    return Measured(item, shares, residual, tuple(rows), least_indirect, most_indirect, _facts(picture, shares))


def _with(row: Row, columns: dict[str, Any], pixels: int, scored: int) -> Row:
    """``row`` with its error columns, number of object pixels, number of scored pixels and coverage."""
    return replace(row, pixels=pixels, scored=scored, coverage=scored / max(1, pixels), **columns)


def estimate_of(picture: Rendered, method: str) -> Estimate:
    """The method's estimate of a rendered item: from disk if it was made from this picture, otherwise made and kept."""
    path, folder = picture.folder / "observation.exr", picture.folder / "estimates"
    if (folder / f"{method}.json").is_file():
        try:
            estimate, digest = read_estimate(folder, method)
            if digest == hashlib.sha256(path.read_bytes()).hexdigest():
                return estimate
        except InputError:
            pass  # an estimate that an interrupted run left incomplete is made again
    estimate = recover_one(picture.observation, method)
    write_estimate(folder, estimate, path)
    return estimate


def _facts(picture: Rendered, shares: tuple[float, float, float]) -> dict[str, float]:
    """Numbers of a picture that say how far it violates an assumption: ``Measured.facts``."""
    F = picture.truth.facts.get("F")
    if F is None:
        F = metrics.fit_colour_matrix(picture.observation.rgb[picture.mask], picture.truth.normals[picture.mask])
    highlight = picture.truth.extra.get("highlight_share")
    return {
        "cond_F": metrics.colour_condition(np.asarray(F)),
        "highlight_share": float(np.mean(highlight[picture.mask])) if highlight is not None else 0.0,
        "sees_all": float(picture.sees_all.sum() / picture.mask.sum()),
        "indirect": shares[1] + shares[2],
    }


def light_shares(picture: Rendered) -> tuple[tuple[float, float, float], np.ndarray]:
    """(shares of the object's light in the order of PARTS, share of indirect light at each pixel (H, W)).

    The second is NaN off the object. Light is summed over the channels.
    """
    layers = picture.layers
    parts = [sum(layers.rgb(i, part).sum(axis=-1) for i in range(len(layers.lights))) for part in PARTS]
    total = np.sum(parts, axis=0)
    whole = float(total[picture.mask].sum())
    with np.errstate(divide="ignore", invalid="ignore"):
        indirect = np.where(picture.mask, (parts[1] + parts[2]) / total, np.nan)
    direct, one, rest = (float(np.asarray(part)[picture.mask].sum()) / whole for part in parts)
    return (direct, one, rest), indirect


def known_lights_error(picture: Rendered) -> np.ndarray:
    """Angular error (H, W), degrees, of n = F⁻¹ρ with the true F of direct light; NaN where a light is missed."""
    G = np.linalg.inv(picture.F)
    where = picture.sees_all
    error = np.full(where.shape, np.nan)
    error[where] = angular_error_deg(picture.observation.rgb[where] @ G.T, picture.truth.normals[where])
    return error


def linear_residual(picture: Rendered) -> float:
    """RMS of ρ − F n over RMS of ρ, over the pixels that see every light, with F fitted to them by least squares.

    n are the true normals and ρ the colours of the picture. 0 means that one matrix explains all colours. NaN where
    fewer than ten pixels see every light.
    """
    where = picture.sees_all
    n, rho = picture.truth.normals[where].astype(float), picture.observation.rgb[where].astype(float)
    if len(n) < 10:
        return float("nan")
    Ft = np.linalg.lstsq(n, rho)[0]
    return float(np.sqrt(np.mean((rho - n @ Ft) ** 2) / np.mean(rho**2)))


def _by_indirect_light(error: np.ndarray, indirect: np.ndarray) -> tuple[float, float]:
    """Medians of the ``error`` (H, W) in the quarters of pixels with the least and with the most ``indirect`` light."""
    known = np.isfinite(error) & np.isfinite(indirect)
    if known.sum() < 8:
        return float("nan"), float("nan")
    low, high = np.quantile(indirect[known], [0.25, 0.75])
    return median(error[known & (indirect <= low)]), median(error[known & (indirect >= high)])
