"""Figures of the evaluation report: Figs. 1(a)–(g) and 2(a)–(c) of the 1994 report, and curves that compare methods.

Every figure is a ``Panel``: an image with its title and caption. Maps have one colour for each pixel of the picture
(``eval.maps``); plots are drawn by Matplotlib's object interface, without global state.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import StepPatch
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from huesphere.eval import maps, slopes
from huesphere.eval.cloud import ellipsoid_matrix, fitted_ellipsoid, sample_colours
from huesphere.eval.maps import Scale
from huesphere.eval.score import HISTOGRAM_EDGES_DEG, QUANTILES, Case, Scene, Score
from huesphere.eval.table import degrees_text
from huesphere.recover.io.estimate import Estimate
from huesphere.render.dataset import lights_seen

MAP_PIXELS = 512  # no side of a map is longer
PLOT_INCHES, PLOT_DPI, CLOUD_DPI = (4.0, 3.1), 140, 110
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
# The colour cloud is seen from azimuth −60° and elevation 25°: (3, 2), to the right and up on the page.
VIEW = np.array([[0.866, -0.211], [0.5, 0.366], [0.0, 0.906]])
# For each axis the two corners of the unit box that its outermost edge, in this view, connects: it has the label.
OUTER_EDGES = (((0, 0, 0), (1, 0, 0)), ((1, 0, 0), (1, 1, 0)), ((1, 1, 0), (1, 1, 1)))


@dataclass(frozen=True)
class Panel:
    """One figure: an image with its title and caption."""

    key: str  # file name without ending
    title: str
    caption: str
    image: np.ndarray  # (H, W, 3) uint8
    scale: Scale | None = None  # of a map: its colour bar is put below it
    legend: tuple[tuple[str, int], ...] = ()  # of a plot: (label, index in LINES) of each curve, put below it
    plot: bool = False  # drawn by Matplotlib, rather than a map of the picture's pixels

    @property
    def alt(self) -> str:
        """Alternative text of the image."""
        return f"{self.title}: {self.caption}"


# --- figures of an item: picture and truth ----------------------------------------------------------------------------


def scene_panels(scene: Scene) -> list[Panel]:
    """Return the picture and the truth of an item: Fig. 1 (a), (b) and Fig. 2 (a) of the report, and more."""
    truth, mask = scene.truth, scene.mask
    panels = [
        Panel("picture", "Picture", "The input of recovery, display-encoded. (Fig. 1b)", picture(scene)),
        Panel(
            "truth_normals",
            "True normals",
            "Red grows to the right, green upward, blue toward the camera.",
            maps.normal_map(truth.normals, mask),
        ),
    ]
    depth = np.where(mask, truth.depth, np.nan)
    if np.isfinite(depth).any():
        scale = maps.depth_scale(depth)
        panels.append(
            Panel("truth_depth", "True depth", "Bright is near. (Fig. 1a)", maps.scalar_map(depth, mask, scale), scale)
        )
    lights = truth.attached_shadow.shape[-1]
    if lights:
        scale = maps.count_scale(lights)
        image = maps.scalar_map(np.where(mask, lights_seen(truth), np.nan), mask, scale)
        panels.append(
            Panel("lights_seen", "Lights seen", "Pixels that miss a light leave the ellipsoid.", image, scale)
        )
    shading = np.where(mask, slopes.shade(truth.normals), np.nan)
    panels.append(
        Panel("truth_shaded", "Truth, one light", "Shaded from the right. (Fig. 2a)", maps.shading_map(shading, mask))
    )
    return [_shrunk(panel) for panel in panels]


def picture(scene: Scene) -> np.ndarray:
    """Return the item's preview.png; where it has none, the observation with its 99.9th percentile at 0.9."""
    path = scene.item.folder / "preview.png"
    shape = scene.mask.shape
    if path.is_file():
        image = _read_png(path)
        if image.shape[:2] == shape:
            return image
    rgb = scene.observation.rgb
    return maps.display(0.9 * rgb / max(float(np.nanpercentile(rgb[scene.mask], 99.9)), 1e-12))


# --- figures of a case: one method on one picture ---------------------------------------------------------------------


def case_panels(scene: Scene, case: Case, line: int) -> list[Panel]:
    """Return the figures of one method on one picture, as far as the estimate has data for them.

    ``line``: index in LINES of the method's style.
    """
    estimate = case.estimate
    if estimate is None:
        return []
    mask = scene.mask
    normals = np.where((estimate.valid & mask)[..., None], estimate.normals, np.nan)
    panels = [
        *core_panels(scene, case),
        Panel(
            "inliers",
            "Accepted pixels",
            "Blue: on the fitted ellipsoid. Orange: rejected. (Fig. 1d)",
            maps.acceptance_map(estimate.inlier & mask, mask),
        ),
    ]
    if case.score.row.scored > 0:
        panels.append(error_plot(case.score, line))
    panels += ellipsoid_panels(scene, estimate)
    panels.append(
        Panel(
            "integrability",
            "|p_y − q_x|, recovered",
            "Zero for the normals of a surface.",
            maps.scalar_map(
                slopes.integrability_error(normals, np.isfinite(normals[..., 2])), mask, maps.INTEGRABILITY_SCALE
            ),
            maps.INTEGRABILITY_SCALE,
        )
    )
    panels += alpha_plots(estimate)
    panels += shaded_panels(scene, estimate, normals)
    return [_shrunk(panel) for panel in panels]


def core_panels(scene: Scene, case: Case, step: int = 1) -> list[Panel]:
    """Return the two figures that every estimate has, normals and their error, with every ``step``-th pixel only."""
    estimate = case.estimate
    if estimate is None:
        return []
    thin = (slice(None, None, step),) * 2
    mask = scene.mask[thin]
    normals = np.where((estimate.valid[thin] & mask)[..., None], estimate.normals[thin], np.nan)
    return [
        Panel(
            "normals",
            "Recovered normals",
            "Colours as in the true normals; grey: the method gives none.",
            maps.normal_map(normals, mask),
        ),
        Panel(
            "error",
            "Angular error",
            "Logarithmic, the same scale in every map. Grey: not scored.",
            maps.scalar_map(case.error_deg[thin], mask, maps.ERROR_SCALE),
            maps.ERROR_SCALE,
        ),
    ]


def ellipsoid_panels(scene: Scene, estimate: Estimate) -> list[Panel]:
    """Return Fig. 1 (c) and (e): the colours on their ellipsoid, and |p_y − q_x| of the unrotated normals."""
    C = ellipsoid_matrix(estimate.solution)
    if C is None:
        return []
    mask, rgb = scene.mask, scene.observation.rgb
    accepted = estimate.inlier & mask
    N = slopes.unrotated_normals(rgb, C)
    residual = slopes.integrability_error(N, accepted)
    return [
        colour_cloud(rgb, mask, accepted, C),
        Panel(
            "integrability_unrotated",
            "|p_y − q_x|, unrotated",
            "N = C^(1/2) ρ on accepted pixels, before the rotation is found. (Fig. 1e)",
            maps.scalar_map(residual, mask, maps.INTEGRABILITY_SCALE),
            maps.INTEGRABILITY_SCALE,
        ),
    ]


def shaded_panels(scene: Scene, estimate: Estimate, normals: np.ndarray) -> list[Panel]:
    """Return Fig. 2 (b) and (c): truth and recovered p, q on the accepted pixels, shaded from one light."""
    accepted = (estimate.inlier & scene.mask)[..., None]
    truth = slopes.shade(np.where(accepted, scene.truth.normals, np.nan))
    recovered = slopes.shade(np.where(accepted, normals, np.nan))
    return [
        Panel(
            "truth_shaded_accepted",
            "Truth on accepted pixels, one light",
            "The best possible result on these pixels. (Fig. 2b)",
            maps.shading_map(truth, scene.mask),
        ),
        Panel(
            "recovered_shaded",
            "Recovered p and q, same light",
            "The more alike this and the truth are, the smaller is the method's error. (Fig. 2c)",
            maps.shading_map(recovered, scene.mask),
        ),
    ]


def error_plot(score: Score, line: int) -> Panel:
    """Return Fig. 1(g): the histogram of angular errors as bars, and the cumulative share as a line."""
    errors = score.quantiles_deg
    limit = _round_limit(float(np.interp(0.99, QUANTILES, errors)))
    x = np.linspace(0.0, limit, 33)
    # Computed from 401 quantiles of the errors: accurate to a fraction of a per cent for 32 bins.
    below = 100.0 * np.interp(x, errors, QUANTILES, left=0.0, right=1.0)
    bars, median = np.diff(below), score.row.median_deg
    colour = LINES[line % len(LINES)][0]
    horizontal = Ruler("angular error, degrees", 0.0, limit, _round_ticks(limit))
    image = _drawn(
        horizontal,
        Ruler("scored pixels below, %", 0.0, 102.0, PER_CENT),
        StepPatch(100.0 * bars / max(bars.max(), 1e-12), x, fill=True, color=colour, alpha=0.45, lw=0),
        Line2D(x, below, color="black", lw=1.4),
        Line2D([median, median], [0.0, 102.0], color=colour, lw=1.3, ls=(0, (4, 2))),
    )
    caption = (
        "Line: share of the scored pixels whose error is below x. Bars: their density, the tallest bin drawn at 100. "
        f"Dashed: the median, {degrees_text(median)}°. (Fig. 1g)"
    )
    return Panel("histogram", "Histogram of angular error", caption, image, plot=True)


def alpha_plots(estimate: Estimate) -> list[Panel]:
    """Return Fig. 1(f), the left side of Eq. (19) over α, and a plot of the integral (18), least where (19) is zero.

    There is one curve for each of the two candidates for u1. The left side is relative to its largest value, the
    integral relative to its least.
    """
    curves = estimate.curves
    if curves is None:
        return []
    integral, condition, chosen = curves.value, curves.condition, curves.chosen
    words = f"Blue: first candidate for u1, dashed orange: second. Dotted: the angle taken, {chosen:.1f}°."
    panels = []
    if np.isfinite(condition).any():
        condition = condition / max(float(np.nanmax(np.abs(condition))), 1e-300)
        vertical = Ruler("left side of Eq. (19), relative", -1.05, 1.05, (-1.0, -0.5, 0.0, 0.5, 1.0))
        image = _over_alpha(curves.alpha_deg, condition, vertical, chosen)
        panels.append(
            Panel("alpha", "Angle α, Eq. (19)", f"Zero where (18) has an extremum. {words} (Fig. 1f)", image, plot=True)
        )
    if np.nanmax(integral) > 0:
        integral = np.where(integral > 0, integral, np.nan)
        integral = integral / np.nanmin(integral)
        vertical = _from_one("integral of (p_y − q_x)², least = 1", float(np.nanmax(integral)))
        image = _over_alpha(curves.alpha_deg, integral, vertical, chosen)
        caption = f"The integral that the angle about r3 minimises. {words}"
        panels.append(Panel("alpha_integral", "Angle α, integral (18)", caption, image, plot=True))
    return panels


def _over_alpha(angles: np.ndarray, curves: np.ndarray, vertical: "Ruler", chosen: float) -> np.ndarray:
    """Return the plot of curves (K, A) over α (A,) in degrees, with the chosen angle marked."""
    low, high = float(angles.min()), float(angles.max())
    artists = [Line2D(angles, v, **_style(line)) for line, v in enumerate(curves)]
    artists.append(Line2D([chosen, chosen], [vertical.low, vertical.high], color="black", lw=1.0, ls=(0, (1, 1))))
    return _drawn(Ruler("α, degrees", low, high, tuple(np.linspace(low, high, 7).tolist())), vertical, *artists)


def colour_cloud(rgb: np.ndarray, mask: np.ndarray, accepted: np.ndarray, C: np.ndarray) -> Panel:
    """Return Fig. 1(c): colours of the object (H, W, 3) and the ellipsoid ρᵀCρ = 1 that the method fitted.

    Left, camera RGB. Right, coordinates along the ellipsoid's axes in units of its half axes, in which it is a unit
    sphere, and pixels that miss a light lie inside; under natural light the ellipsoid is too thin to be seen in RGB.
    Both are orthographic views of the bounding box, scaled to a cube.
    """
    index = sample_colours(rgb, mask)
    rho, on = rgb.reshape(-1, 3)[index].astype(np.float64), accepted.ravel()[index]
    fitted = fitted_ellipsoid(rho, on, C)
    unit, wire = rho @ fitted.to_sphere, fitted.wire
    left, right, canvas, background = _boxes()
    canvas.restore_region(background)
    _draw_cloud(left, rho, on, wire @ np.linalg.inv(fitted.to_sphere))
    _draw_cloud(right, unit, on, wire)
    reach = ", ".join(f"{name} {v.min():.2g} to {v.max():.2g}" for name, v in zip("RGB", rho.T, strict=True))
    caption = (
        f"Blue: accepted, orange: rejected, lines: the fitted ellipsoid. Left in camera RGB ({reach}); right along the "
        "ellipsoid's own axes, the longest first, each in units of its semi-axis: there it is a sphere. (Fig. 1c)"
    )
    return Panel("colour_cloud", "Colours and their ellipsoid", caption, _pixels(canvas), plot=True)


# --- pictures and methods side by side --------------------------------------------------------------------------------


def cumulative_plot(curves: Mapping[str, Score], lines: Sequence[int], key: str, what: str) -> Panel:
    """Return cumulative curves: share of all *object* pixels whose error is below x, which ends at the coverage.

    Args:
        curves: score of each curve by label.
        lines: style of each curve, an index in LINES.
        key: file name of the panel.
        what: the compared things, for the title.
    """
    artists = [
        Line2D(np.maximum(s.quantiles_deg, 1e-9), 100.0 * QUANTILES * s.row.coverage, **_style(line))
        for s, line in zip(curves.values(), lines, strict=True)
    ]
    image = _drawn(DEGREES, Ruler("object pixels below, %", 0.0, 102.0, PER_CENT), *artists)
    caption = (
        "Share of all object pixels whose error is below x. A curve ends at its coverage. Left and higher is better."
    )
    return Panel(key, f"Cumulative error, {what}", caption, image, legend=tuple(zip(curves, lines)), plot=True)


def histogram_plot(curves: Mapping[str, Score], lines: Sequence[int], key: str, what: str) -> Panel:
    """Return histograms of errors on a logarithmic axis, in per cent of object pixels; arguments of cumulative_plot."""
    # The first and last bin are drawn to beyond the ends of the axis.
    edges = np.concatenate([[HISTOGRAM_EDGES_DEG[1] / 1.26], HISTOGRAM_EDGES_DEG[1:-1], [1000.0]])
    shares = [100.0 * s.counts / s.row.pixels for s in curves.values()]
    artists = [
        StepPatch(
            share, edges, fill=False, edgecolor=LINES[line % len(LINES)][0], ls=LINES[line % len(LINES)][1], lw=1.5
        )
        for share, line in zip(shares, lines, strict=True)
    ]
    top = _round_limit(1.02 * max(float(share.max()) for share in shares))
    vertical = Ruler("object pixels per bin, %", 0.0, top, _round_ticks(top))
    image = _drawn(DEGREES, vertical, *artists)
    caption = (
        "Share of all object pixels per bin, ten bins to a decade of degrees; errors below 0.001° are in the first."
    )
    return Panel(key, f"Histogram of error, {what}", caption, image, legend=tuple(zip(curves, lines)), plot=True)


@lru_cache(maxsize=32)
def legend_image(legend: tuple[tuple[str, int], ...], width: int) -> np.ndarray:
    """Return a legend as an image of the given width, with one line of text for each curve, for plots in files."""
    figure = Figure(figsize=(width / PLOT_DPI, 0.06 + 0.17 * len(legend)), dpi=PLOT_DPI)
    handles = [Line2D([], [], **_style(line)) for _, line in legend]
    size = min(8.0, 8.0 * 48 / max(len(label) for label, _ in legend))
    labels = [label.replace("$", r"\$") for label, _ in legend]
    figure.legend(handles, labels, loc="center", fontsize=size, frameon=False, handlelength=2.6, labelspacing=0.3)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return _pixels(canvas)


# --- drawing ----------------------------------------------------------------------------------------------------------
# Matplotlib takes ten times as long for the frame of a plot (axes, ticks, labels) as for its curves, and many plots
# have the same frame. So each frame is drawn once and kept as pixels, and curves are drawn on a copy of these.


@dataclass(frozen=True)
class Ruler:
    """One axis of a plot."""

    label: str
    low: float  # end of the axis
    high: float
    ticks: tuple[float, ...]
    log: bool = False  # logarithmic


DEGREES = Ruler("angular error, degrees", 0.005, 180.0, (0.01, 0.1, 1.0, 10.0, 100.0), log=True)
PER_CENT = (0.0, 25.0, 50.0, 75.0, 100.0)
ROUND = {1.0: 4, 1.5: 3, 2.0: 4, 3.0: 3, 4.0: 4, 6.0: 3, 8.0: 4}  # leading digits at which an axis may end: its steps


@lru_cache(maxsize=32)
def _frame(x: Ruler, y: Ruler) -> tuple[Axes, FigureCanvasAgg, Any]:
    """Return (axes, their canvas, the canvas's pixels with the empty axes drawn) for a plot with axes ``x`` and ``y``.

    Plots with the same axes share them: each restores these pixels, draws on them, and leaves no artist on the axes.
    """
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
    axes.tick_params(labelsize=9, colors="#333333")
    axes.grid(True, color="#e3e7eb", lw=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return axes, canvas, canvas.copy_from_bbox(figure.bbox)


def _drawn(x: Ruler, y: Ruler, *artists: Artist) -> np.ndarray:
    """Return the image of a plot with axes ``x`` and ``y`` and with ``artists`` in the units of its data."""
    axes, canvas, background = _frame(x, y)
    canvas.restore_region(background)
    _draw(axes, *artists)
    return _pixels(canvas)


def _draw(axes: Axes, *artists: Artist) -> None:
    """Draw artists on the present pixels of the canvas of ``axes``, without adding them to the axes for good."""
    for artist in artists:
        axes.add_artist(artist)
        axes.draw_artist(artist)
        artist.remove()


@lru_cache(maxsize=1)
def _boxes() -> tuple[Axes, Axes, FigureCanvasAgg, Any]:
    """Return the two axes of a colour cloud, their canvas, and its pixels with the empty boxes on it."""
    figure = Figure(figsize=(2 * PLOT_INCHES[0], PLOT_INCHES[1]), dpi=CLOUD_DPI)
    both = []
    for left, names in ((0.0, ("R", "G", "B")), (0.5, ("axis 1", "axis 2", "axis 3"))):
        axes = figure.add_axes((left, 0.0, 0.5, 1.0))
        axes.set(xlim=(-1.11, 1.11), ylim=(-0.86, 0.86), aspect="equal")
        axes.set_axis_off()
        corners = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)]) - 0.5
        edges = [(a, b) for a in corners for b in corners if np.sum(b - a) == 1 and np.sum(a != b) == 1]
        for edge in edges:
            axes.plot(*(np.array(edge) @ VIEW).T, color="#cfd6dd", lw=0.7)
        for name, edge in zip(names, OUTER_EDGES, strict=True):
            x, y = np.mean(np.array(edge) - 0.5, axis=0) @ VIEW * 1.07
            side, above = ("center", "top") if y < -0.3 else ("left", "center")
            axes.text(x, y, name, fontsize=9, color="#333333", ha=side, va=above)
        both.append(axes)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return both[0], both[1], canvas, canvas.copy_from_bbox(figure.bbox)


def _draw_cloud(axes: Axes, points: np.ndarray, on: np.ndarray, wire: np.ndarray) -> None:
    """Draw points (N, 3), blue where ``on``, else orange, and lines ``wire`` (P, 3), in the view VIEW of their box."""
    every = np.concatenate([points, wire])
    low, high = np.nanmin(every, axis=0), np.nanmax(every, axis=0)

    def projected(xyz: np.ndarray) -> np.ndarray:
        return (((xyz - low) / np.maximum(high - low, 1e-12) - 0.5) @ VIEW).T

    artists = [Line2D(*projected(wire), color="#333333", lw=0.5, alpha=0.8)]
    for chosen, colour in ((~on, maps.REJECTED_COLOUR), (on, maps.ACCEPTED_COLOUR)):
        artists.append(
            Line2D(*projected(points[chosen]), ls="none", marker=".", ms=2.2, mew=0, color=tuple(colour / 255))
        )
    _draw(axes, *artists)


def _pixels(canvas: FigureCanvasAgg) -> np.ndarray:
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _style(line: int) -> dict[str, Any]:
    colour, dashes = LINES[line % len(LINES)]
    return {"color": colour, "ls": dashes, "lw": 1.5}


def _from_one(label: str, most: float) -> Ruler:
    """Return the axis of a ratio from 1 to ``most``: linear for a small range, otherwise logarithmic."""
    if most < 3.0:
        reach = _round_limit(most - 1.0)
        return Ruler(label, 1.0 - 0.04 * reach, 1.0 + 1.04 * reach, (1.0, 1.0 + reach / 2, 1.0 + reach))
    top = 1.1 * _round_limit(most)
    return Ruler(label, 0.9, top, _log_ticks(top), log=True)


def _log_ticks(most: float) -> tuple[float, ...]:
    """Return 1, 2, 5, 10 … up to ``most``, thinned to decades where they are many."""
    decades = int(np.ceil(np.log10(max(most, 1.0)))) + 1
    if decades <= 3:
        return tuple(m * 10.0**k for k in range(decades) for m in (1, 2, 5) if m * 10.0**k <= most)
    return tuple(10.0**k for k in range(0, decades, -(-decades // 6)))


def _read_png(path: Path) -> np.ndarray:
    import imageio.v3

    image = np.asarray(imageio.v3.imread(path))
    if image.ndim == 2:
        image = np.repeat(image[..., None], 3, axis=-1)
    return image[..., :3].astype(np.uint8)


def _round_limit(value: float) -> float:
    """Return the least of ROUND × 10^k not below ``value``: a round end for an axis."""
    value = max(value, 1e-3)
    decade = 10.0 ** np.floor(np.log10(value))
    return float(next(decade * m for m in (*ROUND, 10.0) if decade * m >= value * (1 - 1e-9)))


def _round_ticks(limit: float) -> tuple[float, ...]:
    """Return round numbers from 0 to a ``limit`` that `_round_limit` gave."""
    leading = limit / 10.0 ** np.floor(np.log10(limit) + 1e-9)
    steps = ROUND[min(ROUND, key=lambda m: abs(m - leading))]
    return tuple(limit * k / steps for k in range(steps + 1))


def _shrunk(panel: Panel) -> Panel:
    return panel if panel.plot else replace(panel, image=maps.shrink(panel.image, MAP_PIXELS))
