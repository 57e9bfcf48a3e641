"""Study `assumptions`: how the error of each method grows as one assumption at a time is violated.

A *curve* of the study's config names one quantity (a key of the scene, or an entry of ``eval.studies.breaking``) and
the values that it takes; all else is as in the config's base scene. There is one picture for each value.
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from huesphere.configs.places import set_key
from huesphere.configs.schema import RunConfig
from huesphere.configs.study import Assumptions, Curve
from huesphere.eval.studies import plots
from huesphere.eval.studies.breaking import PICTURES, SETTINGS, changed_picture
from huesphere.eval.studies.cases import Measured, measure_all
from huesphere.eval.studies.page import Figure, Section, Study, Table
from huesphere.eval.studies.pictures import Log, config_of, percent, render, text


@dataclass(frozen=True)
class _Point:
    """One picture of one curve."""

    curve: str  # name of the curve
    value: Any  # of the varied quantity, as the config has it
    x: float  # position on the horizontal axis of the curve's figure
    measured: Measured


def assumptions(study: Assumptions, folder: Path, log: Log, jobs: int) -> Study:
    """Render a picture for every value of every curve, recover it, and report where each method begins to fail.

    Pictures and estimates are kept in ``folder``/run. ``jobs``: processes. Raises InputError for an invalid config.
    """
    run = folder / "run"
    scenes = [
        (name, value, _config(study, name, value, folder)) for name, c in study.curves.items() for value in c.values
    ]
    distinct = {config.name: config for _, _, config in scenes}
    render(list(distinct.values()), run, log)
    items = []
    for name, value, config in scenes:
        item = f"{config.name}/{config.render.transport[0]}"
        key = study.curves[name].key
        items.append(changed_picture(run, item, key, value) if key in PICTURES else item)
    measured = measure_all(run, [(item, study.methods) for item in dict.fromkeys(items)], jobs, log)
    points = [
        _Point(name, value, _x(study.curves[name], value, measured[item]), measured[item])
        for (name, value, _), item in zip(scenes, items, strict=True)
    ]
    curves = {name: [p for p in points if p.curve == name] for name in study.curves}
    return Study(
        "assumptions",
        "What each assumption is worth",
        _answer(study, curves),
        (
            Section(
                "How far each assumption may be violated",
                (
                    (
                        "For each curve and method, the value nearest to the method's best one at which its median "
                        f"error exceeds {text(study.tolerance_deg)}° or its status is not ok; – where there is none."
                    ),
                ),
                tables=(_limits(study, curves),),
            ),
            Section(
                "Curves",
                (
                    (
                        "Median angular error over the pixels for which a method gives normals. Where its status is "
                        "not ok, the curve has a gap; the status is in the tables below. Everything else is as in "
                        "the base scene: the built-in bust under five gels, direct light with cast shadows, slight "
                        "noise."
                    ),
                ),
                figures=tuple(_figure(study, name, of_curve) for name, of_curve in curves.items()),
            ),
            Section(
                "All numbers", (), tables=tuple(_table(study, name, of_curve) for name, of_curve in curves.items())
            ),
        ),
        tuple(row for point in points for row in _rows(point)),
    )


def _config(study: Assumptions, name: str, value: Any, folder: Path) -> RunConfig:
    """The config of the scene for one ``value`` of the curve ``name``."""
    curve = study.curves[name]
    data = copy.deepcopy(study.base)
    if curve.noise is not None:
        data.setdefault("camera", {})["read_noise"] = curve.noise
    data["name"] = "base"
    if curve.key in SETTINGS:
        SETTINGS[curve.key](data, value, folder)
        data["name"] = f"{name}-{value}"
    elif curve.key not in PICTURES:
        set_key(data, curve.key, value, what=f"curves.{name}")
        data["name"] = f"{name}-{value}"
    return config_of(data, f"curves.{name}")


def _x(curve: Curve, value: Any, measured: Measured) -> float:
    """Position on the axis: the value itself, or the fact of the picture that the curve names, times the scale."""
    return curve.scale * (float(value) if curve.x is None else measured.facts[curve.x])


# ---- sentences and tables --------------------------------------------------------------------------------------------


def _best(points: Sequence[_Point], method: str) -> int | None:
    """Index of the point with the least median error of a method, None where it gives no normals at any."""
    errors = [p.measured.median_deg(method) for p in points]
    return int(np.nanargmin(errors)) if np.isfinite(errors).any() else None


def _limit(study: Assumptions, points: Sequence[_Point], method: str) -> tuple[float, str] | None:
    """(x, status) of the point, nearest to the method's best, where its error exceeds the tolerance or it declines.

    None where there is no such point.
    """
    best = _best(points, method)
    if best is None:
        return points[0].x, points[0].measured.status(method)
    failures = [
        (abs(k - best), p.x, p.measured.status(method))
        for k, p in enumerate(points)
        if not p.measured.median_deg(method) <= study.tolerance_deg
    ]
    return min(failures)[1:] if failures else None


def _limits(study: Assumptions, curves: dict[str, list[_Point]]) -> Table:
    """The ``_limit`` of each method on each curve."""
    rows = []
    for name, points in curves.items():
        cells = [study.curves[name].title, study.curves[name].axis]
        for method in study.methods:
            found = _limit(study, points, method)
            cells.append("–" if found is None else _short(found[0]) + (f" ({found[1]})" if found[1] != "ok" else ""))
        rows.append(tuple(cells))
    return Table(("assumption", "what is varied", *study.methods), tuple(rows))


def _answer(study: Assumptions, curves: dict[str, list[_Point]]) -> tuple[str, ...]:
    """The answer of the study in short: a paragraph in general, and one on each method."""
    points = [p for of_curve in curves.values() for p in of_curve]
    paragraphs = []
    for method in study.methods:
        wrong = [p for p in points if not p.measured.median_deg(method) <= study.tolerance_deg]
        flagged = sum(p.measured.status(method) != "ok" for p in wrong)
        held = [study.curves[name].title.lower() for name, c in curves.items() if _limit(study, c, method) is None]
        paragraphs.append(
            f"{method} stays under {text(study.tolerance_deg)}° on {percent(1 - len(wrong) / len(points))} of "
            f"{len(points)} pictures; of the others "
            f"{percent(flagged / len(wrong)) if wrong else 'none'} have a status other than ok. "
            + (f"It never failed by: {', '.join(held)}." if held else "Every assumption made it fail somewhere.")
        )
    return (f"{len(curves)} assumptions, each violated by itself on one scene.", *paragraphs)


def _figure(study: Assumptions, name: str, points: Sequence[_Point]) -> Figure:
    """The median error of each method over the axis of the curve ``name``, and the tolerance as a horizontal line."""
    curve = study.curves[name]
    ordered = sorted(points, key=lambda p: p.x)
    x = [p.x for p in ordered]
    lines = {method: (x, [p.measured.median_deg(method) for p in ordered]) for method in study.methods}
    return plots.curves(
        name,
        curve.title,
        lines,
        curve.axis,
        "median error, degrees",
        log_x=curve.log,
        log_y=True,
        level=study.tolerance_deg,
    )


def _table(study: Assumptions, name: str, points: Sequence[_Point]) -> Table:
    """Median error and coverage of each method, or its status, at each point of the curve ``name``."""
    rows = []
    for p in points:
        cells = [_short(p.x)]
        for method in study.methods:
            row = next(row for row in p.measured.rows if row.method == method)
            numbers = f"{text(row.median_deg)}° ({percent(row.coverage)})"
            cells.append(numbers if row.status == "ok" else row.status)
        rows.append(tuple(cells))
    return Table(
        (study.curves[name].axis, *study.methods), tuple(rows), f"{study.curves[name].title}: median (coverage)"
    )


def _short(x: float) -> str:
    return f"{x:.3g}" if abs(x) < 1000 else f"{x:.0f}"


def _rows(point: _Point) -> list[dict[str, Any]]:
    """The rows of results.csv for one picture, one for each method."""
    return [
        {
            "curve": point.curve,
            "value": point.value,
            "x": point.x,
            "method": row.method,
            "status": row.status,
            "coverage": row.coverage,
            "median_deg": row.median_deg,
            "mean_deg": row.mean_deg,
            "p95_deg": row.p95_deg,
            "median_deg_gauge": row.median_deg_gauge,
            "stated_median_deg": row.stated_median_deg,
            **point.measured.facts,
        }
        for row in point.measured.rows
    ]
