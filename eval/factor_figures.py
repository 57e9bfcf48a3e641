"""Figures over all configs of a run: box plots by a key's values, error against a numeric key, and pairs of methods.

In the first two kinds a result is the median error, in degrees, of one method on one picture. A factor is a key of the
config that differs between the items, or the transport level; the levels of a factor are its values.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter

from huesphere.eval.compare import Comparison
from huesphere.eval.factors import Factor, Value
from huesphere.eval.figures import Panel
from huesphere.eval.metrics import Row
from huesphere.eval.plot import LINES, PLOT_DPI, PLOT_INCHES, pixels_of, plain
from huesphere.eval.score import in_order

MOST_BOXES = 10  # levels of a factor that are drawn as boxes
LEAST_BOXED = 3  # results for a box; fewer are drawn as points
MOST_PAIRS = 15  # of methods in one figure
BINS = 8  # into which the values of a factor with many levels are divided for the line through the points
LEAST_SHOWN_DEG = 1e-3  # smaller errors are drawn at this value


def factor_panels(rows: Sequence[Row], factors: Sequence[Factor], lines: Mapping[str, int]) -> list[Panel]:
    """Return for each factor with few levels a box plot, and for each numeric factor with three or more a line plot.

    No figure mixes transport levels, except that of the factor ``transport``: every other factor has one figure for
    each transport level of the run.
    ``lines``: index in LINES of the style of each method.
    """
    transports = in_order(row.transport for row in rows)
    panels = []
    for factor in factors:
        parts = [transports] if factor.key == "transport" else [[one] for one in transports]
        for part in parts:
            found = _of_factor([row for row in rows if row.transport in part], factor, lines)
            if len(parts) > 1:
                found = [replace(p, key=f"{p.key}_{_file(part[0])}", title=f"{p.title}, {part[0]}") for p in found]
            panels += found
    return panels


def _of_factor(rows: Sequence[Row], factor: Factor, lines: Mapping[str, int]) -> list[Panel]:
    """The figures of one factor over the results ``rows``."""
    given = [r for r in rows if r.scored > 0 and f"{r.config}/{r.transport}" in factor.values]
    methods = [m for m in lines if any(r.method == m for r in given)]
    panels = []
    levels = len({factor.values[f"{r.config}/{r.transport}"] for r in given})
    if levels >= 2 and len(factor.levels) <= MOST_BOXES:
        panels.append(_boxes(given, factor, methods, lines))
    if levels >= 3 and factor.numeric and len(factor.levels) >= 3:
        panels.append(_against(given, factor, methods, lines))
    return panels


def comparison_panel(comparisons: Sequence[Comparison], best: str, key: str = "paired", what: str = "") -> Panel:
    """Return a forest plot: the ratio of errors of each pair of methods, with its interval.

    Left of 1 the first method has the smaller errors. If there are more than ``MOST_PAIRS``, only pairs with the method
    ``best`` are drawn; paired.csv has all. ``key`` is the file's name, ``what`` is added to the title.
    """
    if len(comparisons) > MOST_PAIRS:
        comparisons = [c for c in comparisons if best in (c.first, c.second)]
    height = 0.7 + 0.42 * len(comparisons)
    figure = Figure(figsize=(PLOT_INCHES[0], height), dpi=PLOT_DPI)
    axes = figure.add_axes((0.04, 0.55 / height, 0.92, 1 - 0.6 / height))
    for place, c in enumerate(reversed(comparisons)):
        colour = LINES[0][0] if c.decided else "#777777"
        if np.isfinite(c.low):
            axes.plot([c.low, c.high], [place, place], color=colour, lw=2.0)
        axes.plot([c.ratio], [place], marker="o", ms=5, color=colour)
        words = _plain(f"{c.first} ÷ {c.second} ({c.scenes})")
        size = min(9.0, 9.0 * 48 / len(words))
        across = axes.get_yaxis_transform()
        box = {"fc": "white", "ec": "none", "pad": 1.0}  # hides the line at 1 behind the text
        axes.text(0.01, place + 0.22, words, fontsize=size, transform=across, va="bottom", bbox=box)
    axes.axvline(1.0, color="black", lw=0.8, ls=(0, (4, 2)))
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ends = [v for c in comparisons for v in (c.low, c.high, c.ratio) if np.isfinite(v)]
    widest = max(max(ends), 1 / min(ends), 1.2) ** 1.15
    if widest < 8:
        axes.set_xticks([v for v in (0.125, 0.25, 0.5, 0.8, 1.0, 1.25, 2.0, 4.0, 8.0) if 1 / widest <= v <= widest])
        axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlim(1 / widest, widest)
    axes.set_ylim(-0.5, len(comparisons) - 0.2)
    axes.set_yticks([])
    axes.set_xlabel("ratio of errors, first ÷ second", fontsize=10)
    plain(axes)
    caption = (
        "Ratio of the median errors on pixels for which both methods give normals: geometric mean over scenes (their "
        "number in brackets), with its 95 % interval from resampled scenes. Left of 1 the first has the smaller "
        "errors; grey: the interval contains 1."
    )
    return _panel(key, f"Methods in pairs{what}", caption, figure)


def _boxes(rows: Sequence[Row], factor: Factor, methods: Sequence[str], lines: Mapping[str, int]) -> Panel:
    """A box plot: for each level of the factor one box for each method."""
    figure, axes = _frame()
    step = 0.8 / len(methods)
    for n, method in enumerate(methods):
        colour = LINES[lines[method] % len(LINES)][0]
        edge: dict[str, Any] = {"color": colour, "lw": 1.1}
        groups = [(k, _errors(rows, factor, method, level)) for k, level in enumerate(factor.levels)]
        placed = [(k + (n - (len(methods) - 1) / 2) * step, errors) for k, errors in groups if errors.size]
        for place, errors in placed:
            if errors.size < LEAST_BOXED:
                axes.plot(np.full(errors.size, place), errors, ls="none", marker="D", ms=5, color=colour)
        boxed = {place: errors for place, errors in placed if errors.size >= LEAST_BOXED}
        if not boxed:
            continue
        axes.boxplot(
            list(boxed.values()),
            positions=list(boxed),
            widths=0.8 * step,
            manage_ticks=False,
            patch_artist=True,
            boxprops={"facecolor": colour + "44", "edgecolor": colour},
            medianprops={"color": "black", "lw": 1.2},
            whiskerprops=edge,
            capprops=edge,
            flierprops={"marker": ".", "ms": 3, "mfc": colour, "mec": colour},
        )
    labels = [_plain(_level(level)) for level in factor.levels]
    long = max(map(len, labels)) * len(labels) > 40
    axes.set_xticks(range(len(labels)), labels, rotation=30 if long else 0, ha="right" if long else "center")
    axes.set_xlim(-0.6, len(labels) - 0.4)
    axes.set_xlabel(_plain(factor.key), fontsize=10)
    _degrees(axes)
    caption = (
        "Median errors of all results with each value of the key, whatever values the other keys have"
        f"{'' if factor.key == 'transport' else '; one figure for each transport level'}. Box: quartiles; bar: median; "
        "whiskers: results within 1.5 times the height of the box. Diamonds: single results where there are fewer "
        f"than {LEAST_BOXED}."
    )
    legend = tuple((method, lines[method]) for method in methods)
    return _panel(f"by_{_file(factor.key)}", f"Error by {factor.key}", caption, figure, legend)


def _against(rows: Sequence[Row], factor: Factor, methods: Sequence[str], lines: Mapping[str, int]) -> Panel:
    """Error over the values of a numeric factor: a point for each result, a line for each method."""
    figure, axes = _frame()
    values = np.array(factor.levels, dtype=np.float64)
    positive = values[values > 0]
    wide = positive.size > 0 and positive.max() / positive.min() >= 10 and values.min() >= 0
    if wide:
        axes.set_xscale("symlog", linthresh=positive.min(), linscale=0.5)
    for method in methods:
        colour, dashes = LINES[lines[method] % len(LINES)]
        own = [r for r in rows if r.method == method]
        x = np.array([float(factor.values[f"{r.config}/{r.transport}"]) for r in own])
        y = np.maximum([r.median_deg for r in own], LEAST_SHOWN_DEG)
        axes.plot(x, y, ls="none", marker=".", ms=4, color=colour, alpha=0.5, mew=0)
        middle = [(np.median(x[inside]), np.median(y[inside])) for inside in _bins(x)]
        axes.plot(*np.array(middle).T, color=colour, ls=dashes, lw=1.5)
    axes.set_xlabel(_plain(factor.key), fontsize=10)
    if len(values) <= 6:
        axes.set_xticks(values)
    elif wide:
        axes.set_xticks([0.0, *np.unique(10.0 ** np.round(np.log10(positive)))])
    else:
        axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    _degrees(axes)
    caption = (
        "Points: the median error of each result. Line: the median of the points at each value, or where there are "
        f"many values in each of {BINS} groups of equal size."
    )
    key = f"against_{_file(factor.key)}"
    legend = tuple((method, lines[method]) for method in methods)
    return _panel(key, f"Error against {factor.key}", caption, figure, legend)


def _bins(x: np.ndarray) -> list[np.ndarray]:
    """Return for each value of ``x`` (N,) which points have it, (N,) bool; with many values, ``BINS`` equal groups."""
    values = np.unique(x)
    if len(values) <= MOST_BOXES:
        return [x == value for value in values]
    return [np.isin(np.arange(len(x)), part) for part in np.array_split(np.argsort(x, kind="stable"), BINS)]


def _errors(rows: Sequence[Row], factor: Factor, method: str, level: Value) -> np.ndarray:
    """Median errors in degrees of a method's results at one level of the factor."""
    found = [r.median_deg for r in rows if r.method == method and factor.values[f"{r.config}/{r.transport}"] == level]
    return np.maximum(np.array(found), LEAST_SHOWN_DEG)


def _frame() -> tuple[Figure, Axes]:
    figure = Figure(figsize=PLOT_INCHES, dpi=PLOT_DPI, layout="constrained")
    return figure, figure.add_subplot()


def _degrees(axes: Axes) -> None:
    """Make the vertical axis one of degrees, logarithmic."""
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
    low, high = axes.get_ylim()
    if high / low < 30:
        axes.set_yticks([m * 10.0**k for k in range(-3, 3) for m in (1, 2, 5) if low <= m * 10.0**k <= high])
    axes.set_ylabel("median error, degrees", fontsize=10)
    plain(axes)


def _panel(key: str, title: str, caption: str, figure: Figure, legend: tuple[tuple[str, int], ...] = ()) -> Panel:
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return Panel(key, title, caption, pixels_of(canvas), legend=legend, plot=True, vector=lambda: figure)


def _level(value: Value) -> str:
    text = f"{value:g}" if isinstance(value, float) else value
    return text if len(text) <= 24 else text[:23] + "…"


def _plain(text: str) -> str:
    """``text`` such that Matplotlib does not take a part of it for a formula."""
    return text.replace("$", r"\$")


def _file(key: str) -> str:
    """``key`` as part of a file name."""
    return re.sub(r"[^A-Za-z0-9.]+", "-", key).strip("-")
