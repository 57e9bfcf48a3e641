"""Figures of the studies: images with a colour scale, curves, histograms, bars, clouds of colours.

The colours are Okabe and Ito's, which colour-blind readers can distinguish; curves differ in dashes and markers too.
"""

import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure as Canvas
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import ArrayLike

from huesphere.eval.studies.page import Figure

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#000000", "#56B4E9", "#E69F00", "#7F7F7F")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
DASHES = ("-", "--", "-.", ":", "-", "--", "-.", ":")
INCHES, DPI = (4.6, 3.5), 150
TEXT = 10.0


def photo(key: str, title: str, image: np.ndarray, caption: str = "") -> Figure:
    """A figure of an image (H, W, 3) of bytes; small images are enlarged by a whole factor."""
    factor = max(1, round(420 / max(image.shape[:2])))
    return Figure(key, title, np.repeat(np.repeat(image, factor, axis=0), factor, axis=1), caption)


# More than seven parameters, here and below: what a figure shows, and options with defaults.
def field(
    key: str,
    title: str,
    values: np.ndarray,
    label: str,
    *,
    limits: tuple[float, float] | None = None,
    log: bool = False,
    colours: str = "viridis",
    caption: str = "",
) -> Figure:
    """A figure of numbers (H, W) as colours, white where they are not finite, with a colour scale.

    ``limits``: ends of the scale, by default the least and the greatest value; ``log``: a logarithmic scale;
    ``colours``: name of a Matplotlib colour map.
    """
    finite = values[np.isfinite(values)]
    low, high = limits or ((float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0))
    high = high if high > low else low + 1e-9
    canvas, axes = _axes()
    norm = LogNorm(low, high, clip=True) if log else Normalize(low, high, clip=True)
    shown = axes.imshow(np.ma.masked_invalid(values), cmap=colours, norm=norm, interpolation="nearest")
    axes.set_axis_off()
    scale = canvas.colorbar(shown, ax=axes, label=label, shrink=0.9)
    if log:
        scale.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    return Figure(key, title, _pixels(canvas), caption, canvas)


# More than seven parameters: what a figure shows, and options with defaults.
def curves(
    key: str,
    title: str,
    lines: Mapping[str, tuple[ArrayLike, ArrayLike]],
    x: str,
    y: str,
    *,
    log_x: bool = False,
    log_y: bool = False,
    marked: bool = True,
    joined: bool = True,
    at: Mapping[str, float] | None = None,
    level: float | None = None,
    bounds_y: tuple[float, float] | None = None,
    caption: str = "",
) -> Figure:
    """A figure of curves: ``lines`` has for each name the values of x and of y.

    ``x`` and ``y`` are the labels of the axes; ``marked``: with a marker at each point; ``joined``: with lines between
    points; ``at``: positions of vertical lines by name; ``level``: height of a horizontal line.
    """
    canvas, axes = _axes()
    for number, (name, (xs, ys)) in enumerate(lines.items()):
        marker = MARKERS[(number + number // 8) % 8] if marked else ""
        style = _style(number) if joined else {"color": COLOURS[number % 8], "ls": "", "alpha": 0.75}
        axes.plot(xs, ys, label=name, marker=marker, ms=5, **style)
    for number, (name, value) in enumerate((at or {}).items()):
        axes.axvline(value, color="#555555", ls=(":", "-.")[number % 2], lw=1.2, label=name)
    if level is not None:
        axes.axhline(level, color="#999999", lw=1)
    if log_x:
        axes.set_xscale("log")
    if log_y:
        axes.set_yscale("log")
    if bounds_y:
        axes.set_ylim(*bounds_y)
    return _finished(key, title, canvas, axes, x, y, len(lines) + len(at or {}) > 1, caption)


# More than seven parameters: what a figure shows, and options with defaults.
def histogram(
    key: str,
    title: str,
    samples: Mapping[str, np.ndarray],
    bins: np.ndarray,
    x: str,
    *,
    log_x: bool = False,
    at: Mapping[str, float] | None = None,
    caption: str = "",
) -> Figure:
    """A figure with the histogram of each of the named ``samples``, as shares of a sample, in common ``bins``.

    Values outside the bins are counted in the first or last bin. ``at``: positions of vertical lines by name.
    """
    canvas, axes = _axes()
    for number, (name, values) in enumerate(samples.items()):
        inside = np.clip(values[np.isfinite(values)], bins[0], np.nextafter(bins[-1], bins[0]))
        counts = np.histogram(inside, bins)[0] / max(1, len(inside))
        axes.stairs(counts, bins, label=name, fill=len(samples) == 1, **_style(number))
    for number, (name, value) in enumerate((at or {}).items()):
        axes.axvline(value, color="#333333", ls=(":", "-.")[number % 2], lw=1.4, label=name)
    if log_x:
        axes.set_xscale("log")
    return _finished(key, title, canvas, axes, x, "share of the pixels", len(samples) + len(at or {}) > 1, caption)


def bars(
    key: str, title: str, groups: Sequence[str], parts: Mapping[str, Sequence[float]], y: str, *, caption: str = ""
) -> Figure:
    """A figure of stacked bars: one bar for each group, made of the named ``parts``, each with a height per group."""
    canvas, axes = _axes()
    foot = np.zeros(len(groups))
    hatches = ("", "//", "..", "xx")
    for number, (name, values) in enumerate(parts.items()):
        height = np.nan_to_num(np.asarray(values, float))
        colour = COLOURS[number % 8]
        axes.bar(groups, height, bottom=foot, label=name, color=colour, hatch=hatches[number % 4], edgecolor="white")
        foot += height
    axes.set_xticks(range(len(groups)), groups, rotation=40, ha="right", rotation_mode="anchor")
    return _finished(key, title, canvas, axes, "", y, len(parts) > 1, caption)


def cloud(
    key: str, title: str, rgb: np.ndarray, on: np.ndarray, C: np.ndarray, *, most: int = 3000, caption: str = ""
) -> Figure:
    """A figure of colours (N, 3) and the ellipsoid ρᵀCρ = 1, in coordinates in which the ellipsoid is a unit sphere.

    The coordinates are along the ellipsoid's axes, each in units of its half axis. Left: the two axes along which the
    colours vary most; right: the first and the third. ``on`` (N,) bool: colours accepted as lying on the ellipsoid.
    ``most``: number of colours that are drawn, about.
    """
    values, vectors = np.linalg.eigh(C)
    along = rgb @ (vectors * np.sqrt(values))
    along = along * np.sign(along.mean(axis=0))
    spread = np.argsort(along.std(axis=0))[::-1]
    along = along[:: max(1, len(rgb) // most)][:, spread]
    on = on[:: max(1, len(rgb) // most)]
    canvas = Canvas(figsize=(6.2, 3.4), dpi=DPI, layout="constrained")
    circle = np.linspace(0, 2 * np.pi, 200)
    for axes, (i, j) in zip(canvas.subplots(1, 2), ((0, 1), (0, 2))):
        for part, number, name in ((~on, 1, "rejected"), (on, 0, "accepted")):
            axes.plot(*along[part][:, (i, j)].T, MARKERS[number], ms=1.8, color=COLOURS[number], label=name, mew=0)
        axes.plot(np.cos(circle), np.sin(circle), color="black", lw=1, label="ellipsoid's outline")
        axes.set(aspect="equal", xlabel=f"its axis {'abc'[i]}", ylabel=f"its axis {'abc'[j]}")
        axes.grid(alpha=0.3)
    _legend(canvas, axes, markerscale=4)
    return Figure(key, title, _pixels(canvas), caption, canvas)


def _axes() -> tuple[Canvas, Axes]:
    """A new canvas with one plot."""
    canvas = Canvas(figsize=INCHES, dpi=DPI, layout="constrained")
    return canvas, canvas.subplots()


def _style(number: int) -> dict[str, Any]:
    """Colour, dashes and width of curve ``number``; the ninth has the colour of the first with other dashes."""
    return {"color": COLOURS[number % 8], "ls": DASHES[(number + number // 8) % 8], "lw": 1.8}


# More than seven parameters: the last step of each kind of figure, with the labels that it was given.
def _finished(key: str, title: str, canvas: Canvas, axes: Axes, x: str, y: str, legend: bool, caption: str) -> Figure:
    """Label the axes of a plot, set ticks and legend, and turn it into a figure."""
    axes.set_xlabel(x, fontsize=TEXT)
    axes.set_ylabel(y, fontsize=TEXT)
    axes.grid(alpha=0.3, which="major")
    axes.spines[["top", "right"]].set_visible(False)
    for axis in (axes.xaxis, axes.yaxis):
        if axis.get_scale() == "log":
            low, high = axis.get_view_interval()
            narrow = high < 100 * low
            axis.set_major_locator(LogLocator(subs=(1, 2, 5) if narrow else (1,), numticks=8))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axis.set_minor_formatter(NullFormatter())
    if legend:
        _legend(canvas, axes)
    return Figure(key, title, _pixels(canvas), caption, canvas)


def _legend(canvas: Canvas, axes: Axes, **options: Any) -> None:
    """Put the legend under the plot, where it hides nothing, and make the canvas taller by the legend's height."""
    handles, names = axes.get_legend_handles_labels()
    columns = 3 if max(map(len, names)) < 14 else 2 if max(map(len, names)) < 30 else 1
    width, height = canvas.get_size_inches()
    canvas.set_size_inches(width, height + 0.2 * -(-len(names) // columns))
    canvas.legend(
        handles, names, loc="outside lower center", ncols=columns, fontsize=TEXT - 1, frameon=False, **options
    )


def _pixels(canvas: Canvas) -> np.ndarray:
    """The drawn canvas as an image (H, W, 3) of bytes."""
    from PIL import Image

    buffer = io.BytesIO()
    FigureCanvasAgg(canvas).print_png(buffer)
    return np.asarray(Image.open(buffer).convert("RGB"))
