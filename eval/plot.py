"""One plot with its axes: as pixels for the page, quickly, and as a Matplotlib figure for SVG and PDF.

Matplotlib takes ten times as long for the frame of a plot (axes, ticks, labels) as for its curves, and many plots have
the same frame. So each frame is drawn once and kept as pixels, and curves are drawn on a copy of these.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

PLOT_INCHES, PLOT_DPI = (4.0, 3.1), 140
# Styles of curves: Okabe and Ito's colours that are visible on white, each with other dashes for print in grey. The
# methods of a run take them in order.
LINES: tuple[tuple[str, str | tuple[int, tuple[int, ...]]], ...] = (
    ("#0072B2", "-"),
    ("#D55E00", (0, (5, 2))),
    ("#009E73", (0, (1, 1))),
    ("#CC79A7", (0, (5, 1, 1, 1))),
    ("#000000", (0, (3, 1, 1, 1, 1, 1))),
    ("#56B4E9", "-"),
    ("#E69F00", (0, (5, 2))),
)


@dataclass(frozen=True)
class Ruler:
    """One axis of a plot."""

    label: str
    low: float  # end of the axis
    high: float
    ticks: tuple[float, ...]
    log: bool = False  # logarithmic


ROUND = {1.0: 4, 1.5: 3, 2.0: 4, 3.0: 3, 4.0: 4, 6.0: 3, 8.0: 4}  # leading digits at which an axis may end: its steps


@lru_cache(maxsize=32)
def _frame(x: Ruler, y: Ruler) -> tuple[Axes, FigureCanvasAgg, Any]:
    """Return (axes, their canvas, the canvas's pixels with the empty axes drawn) for a plot with axes ``x`` and ``y``.

    Plots with the same axes share them: each restores these pixels, draws on them, and leaves no artist on the axes.
    """
    figure, axes = _empty(x, y)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return axes, canvas, canvas.copy_from_bbox(figure.bbox)


def _empty(x: Ruler, y: Ruler) -> tuple[Figure, Axes]:
    """A new figure with axes ``x`` and ``y`` and nothing on them."""
    figure = Figure(figsize=PLOT_INCHES, dpi=PLOT_DPI)
    axes = figure.add_axes((0.19, 0.17, 0.77, 0.80))
    for axis, ruler, set_limits, set_scale in (
        (axes.xaxis, x, axes.set_xlim, axes.set_xscale),
        (axes.yaxis, y, axes.set_ylim, axes.set_yscale),
    ):
        set_scale("log" if ruler.log else "linear")
        set_limits(ruler.low, ruler.high)
        axis.set_major_locator(FixedLocator(ruler.ticks))
        axis.set_minor_locator(NullLocator())
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.5g}"))
        axis.set_label_text(ruler.label, fontsize=10)
    axes.yaxis.set_label_coords(-0.16, 0.5)
    plain(axes)
    return figure, axes


def plain(axes: Axes) -> None:
    """Give axes the grid, the ticks and the two sides that all plots of a report have."""
    axes.tick_params(labelsize=9, colors="#333333")
    axes.grid(True, color="#e3e7eb", lw=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


@dataclass(frozen=True)
class Plot:
    """A plot with axes ``x`` and ``y``; each call of ``artists`` makes anew what is drawn, in the units of its data."""

    x: Ruler
    y: Ruler
    artists: Callable[[], Sequence[Artist]]

    def image(self) -> np.ndarray:
        """The plot as pixels, (H, W, 3) uint8."""
        axes, canvas, background = _frame(self.x, self.y)
        canvas.restore_region(background)
        draw_on(axes, *self.artists())
        return pixels_of(canvas)

    def figure(self) -> Figure:
        """The plot as a new Matplotlib figure."""
        figure, axes = _empty(self.x, self.y)
        for artist in self.artists():
            axes.add_artist(artist)
        return figure


def draw_on(axes: Axes, *artists: Artist) -> None:
    """Draw artists on the present pixels of the canvas of ``axes``, without adding them to the axes for good."""
    for artist in artists:
        axes.add_artist(artist)
        axes.draw_artist(artist)
        artist.remove()


def pixels_of(canvas: FigureCanvasAgg) -> np.ndarray:
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def style_of(line: int) -> dict[str, Any]:
    colour, dashes = LINES[line % len(LINES)]
    return {"color": colour, "ls": dashes, "lw": 1.5}


def from_one(label: str, most: float) -> Ruler:
    """Return the axis of a ratio from 1 to ``most``: linear for a small range, otherwise logarithmic."""
    if most < 3.0:
        reach = round_limit(most - 1.0)
        return Ruler(label, 1.0 - 0.04 * reach, 1.0 + 1.04 * reach, (1.0, 1.0 + reach / 2, 1.0 + reach))
    top = 1.1 * round_limit(most)
    return Ruler(label, 0.9, top, log_ticks(top), log=True)


def log_ticks(most: float) -> tuple[float, ...]:
    """Return 1, 2, 5, 10 … up to ``most``, thinned to decades where they are many."""
    decades = int(np.ceil(np.log10(max(most, 1.0)))) + 1
    if decades <= 3:
        return tuple(m * 10.0**k for k in range(decades) for m in (1, 2, 5) if m * 10.0**k <= most)
    return tuple(10.0**k for k in range(0, decades, -(-decades // 6)))


def round_limit(value: float) -> float:
    """Return the least of ROUND × 10^k not below ``value``: a round end for an axis."""
    value = max(value, 1e-3)
    decade = 10.0 ** np.floor(np.log10(value))
    return float(next(decade * m for m in (*ROUND, 10.0) if decade * m >= value * (1 - 1e-9)))


def round_ticks(limit: float) -> tuple[float, ...]:
    """Return round numbers from 0 to a ``limit`` that `round_limit` gave."""
    leading = limit / 10.0 ** np.floor(np.log10(limit) + 1e-9)
    steps = ROUND[min(ROUND, key=lambda m: abs(m - leading))]
    return tuple(limit * k / steps for k in range(steps + 1))
