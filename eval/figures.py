"""Figures of the evaluation report: Figs. 1(a)–(g) and 2(a)–(c) of the 1994 report, and curves that compare methods.

Every figure is a ``Panel``: an image with its title and caption. Maps have one colour for each pixel of the picture
(``eval.maps``); plots are drawn by Matplotlib's object interface, without global state (``eval.plot``).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import StepPatch

from huesphere.eval import maps, slopes
from huesphere.eval.cloud import ellipsoid_matrix, fitted_ellipsoid, sample_colours
from huesphere.eval.maps import Scale
from huesphere.eval.plot import (
    LINES,
    PLOT_DPI,
    PLOT_INCHES,
    Plot,
    Ruler,
    draw_on,
    from_one,
    pixels_of,
    round_limit,
    round_ticks,
    style_of,
)
from huesphere.eval.score import HISTOGRAM_EDGES_DEG, QUANTILES, Case, Scene, Score
from huesphere.eval.table import degrees_text
from huesphere.eval.verdict import DOUBTFUL_DEG, doubtful_pixels
from huesphere.recover.io.estimate import Estimate
from huesphere.render.dataset import lights_seen

MAP_PIXELS = 512  # no side of a map is longer
CLOUD_DPI = 110
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
    vector: Callable[[], Figure] | None = None  # makes a plot as a figure, for SVG and PDF

    @property
    def alt(self) -> str:
        """Alternative text of the image."""
        return f"{self.title}: {self.caption}"


def plot_panel(key: str, title: str, caption: str, plot: Plot, legend: tuple[tuple[str, int], ...] = ()) -> Panel:
    """Return ``plot`` as a panel."""
    return Panel(key, title, caption, plot.image(), legend=legend, plot=True, vector=plot.figure)


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
    """Return the figures that every estimate has, with every ``step``-th pixel: normals, error, doubtful pixels."""
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
        Panel(
            "doubtful",
            "Doubtful pixels",
            f"Hatched: no normal, interpolated, or a stated error of {DOUBTFUL_DEG:g}° or more.",
            maps.hatched(picture(scene)[thin], doubtful_pixels(estimate, scene.mask)[thin]),
        ),
    ]


def ellipsoid_panels(scene: Scene, estimate: Estimate) -> list[Panel]:
    """Return Fig. 1 (c) and (e): the colours on their ellipsoid, and |p_y − q_x| of the unrotated normals.

    Where the method found no ellipsoid, the colours alone: they show what was missing.
    """
    C = ellipsoid_matrix(estimate.solution)
    mask, rgb = scene.mask, scene.observation.rgb
    accepted = estimate.inlier & mask
    if C is None:
        return bare_cloud(rgb, mask, accepted)
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
    limit = round_limit(float(np.interp(0.99, QUANTILES, errors)))
    x = np.linspace(0.0, limit, 33)
    # Computed from 401 quantiles of the errors: accurate to a fraction of a per cent for 32 bins.
    below = 100.0 * np.interp(x, errors, QUANTILES, left=0.0, right=1.0)
    bars, median = np.diff(below), score.row.median_deg
    colour = LINES[line % len(LINES)][0]
    horizontal = Ruler("angular error, degrees", 0.0, limit, round_ticks(limit))
    plot = Plot(
        horizontal,
        Ruler("scored pixels below, %", 0.0, 102.0, PER_CENT),
        lambda: (
            StepPatch(100.0 * bars / max(bars.max(), 1e-12), x, fill=True, color=colour, alpha=0.45, lw=0),
            Line2D(x, below, color="black", lw=1.4),
            Line2D([median, median], [0.0, 102.0], color=colour, lw=1.3, ls=(0, (4, 2))),
        ),
    )
    caption = (
        "Line: share of the scored pixels whose error is below x. Bars: their density, the tallest bin drawn at 100. "
        f"Dashed: the median, {degrees_text(median)}°. (Fig. 1g)"
    )
    return plot_panel("histogram", "Histogram of angular error", caption, plot)


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
        plot = _over_alpha(curves.alpha_deg, condition, vertical, chosen)
        caption = f"Zero where (18) has an extremum. {words} (Fig. 1f)"
        panels.append(plot_panel("alpha", "Angle α, Eq. (19)", caption, plot))
    if np.nanmax(integral) > 0:
        integral = np.where(integral > 0, integral, np.nan)
        integral = integral / np.nanmin(integral)
        vertical = from_one("integral of (p_y − q_x)², least = 1", float(np.nanmax(integral)))
        plot = _over_alpha(curves.alpha_deg, integral, vertical, chosen)
        caption = f"The integral that the angle about r3 minimises. {words}"
        panels.append(plot_panel("alpha_integral", "Angle α, integral (18)", caption, plot))
    return panels


def _over_alpha(angles: np.ndarray, curves: np.ndarray, vertical: Ruler, chosen: float) -> Plot:
    """Return the plot of curves (K, A) over α (A,) in degrees, with the chosen angle marked."""
    low, high = float(angles.min()), float(angles.max())
    horizontal = Ruler("α, degrees", low, high, tuple(np.linspace(low, high, 7).tolist()))
    return Plot(
        horizontal,
        vertical,
        lambda: (
            *(Line2D(angles, v, **style_of(line)) for line, v in enumerate(curves)),
            Line2D([chosen, chosen], [vertical.low, vertical.high], color="black", lw=1.0, ls=(0, (1, 1))),
        ),
    )


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
    reach = ", ".join(f"{name} {v.min():.2g} to {v.max():.2g}" for name, v in zip("RGB", rho.T, strict=True))
    caption = (
        f"Blue: accepted, orange: rejected, lines: the fitted ellipsoid. Left in camera RGB ({reach}); right along the "
        "ellipsoid's own axes, the longest first, each in units of its semi-axis: there it is a sphere. (Fig. 1c)"
    )
    clouds = (rho, wire @ np.linalg.inv(fitted.to_sphere)), (unit, wire)
    return _two_clouds("Colours and their ellipsoid", caption, clouds, on)


def bare_cloud(rgb: np.ndarray, mask: np.ndarray, accepted: np.ndarray) -> list[Panel]:
    """Return the colours of the object without an ellipsoid, in RGB and along their principal axes, as a list.

    An empty one with fewer than three colours.
    """
    index = sample_colours(rgb, mask)
    if len(index) < 3:
        return []
    rho, on = rgb.reshape(-1, 3)[index].astype(np.float64), accepted.ravel()[index]
    middle = rho.mean(axis=0)
    _, spread, axes = np.linalg.svd(rho - middle, full_matrices=False)
    no_wire = np.full((1, 3), np.nan)
    ratio = " : ".join(f"{v:.2g}" for v in spread / max(spread[0], 1e-300))
    caption = (
        "No ellipsoid was found. Left in camera RGB; right along the colours' own principal axes, each stretched to "
        f"fill the box: in truth they spread by {ratio}. Blue: accepted, orange: rejected."
    )
    clouds = (rho, no_wire), ((rho - middle) @ axes.T, no_wire)
    return [_two_clouds("Colours", caption, clouds, on)]


def _two_clouds(
    title: str,
    caption: str,
    clouds: tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]],
    on: np.ndarray,
) -> Panel:
    """The panel of two clouds side by side, each of points (N, 3) and lines (P, 3); blue points where ``on`` (N,)."""
    left, right, canvas, background = _boxes()
    canvas.restore_region(background)
    for axes, (points, lines) in zip((left, right), clouds, strict=True):
        draw_on(axes, *_cloud(points, on, lines))

    def vector() -> Figure:
        figure, *both = _empty_boxes()
        for axes, (points, lines) in zip(both, clouds, strict=True):
            for artist in _cloud(points, on, lines):
                axes.add_artist(artist)
        return figure

    return Panel("colour_cloud", title, caption, pixels_of(canvas), plot=True, vector=vector)


# --- pictures and methods side by side --------------------------------------------------------------------------------


def cumulative_plot(curves: Mapping[str, Score], lines: Sequence[int], key: str, what: str) -> Panel:
    """Return cumulative curves: share of all *object* pixels whose error is below x, which ends at the coverage.

    Args:
        curves: score of each curve by label.
        lines: style of each curve, an index in LINES.
        key: file name of the panel.
        what: the compared things, for the title.
    """
    plot = Plot(
        DEGREES,
        Ruler("object pixels below, %", 0.0, 102.0, PER_CENT),
        lambda: [
            Line2D(np.maximum(s.quantiles_deg, 1e-9), 100.0 * QUANTILES * s.row.coverage, **style_of(line))
            for s, line in zip(curves.values(), lines, strict=True)
        ],
    )
    caption = (
        "Share of all object pixels whose error is below x. A curve ends at its coverage. Left and higher is better."
    )
    return plot_panel(key, f"Cumulative error, {what}", caption, plot, tuple(zip(curves, lines)))


def histogram_plot(curves: Mapping[str, Score], lines: Sequence[int], key: str, what: str) -> Panel:
    """Return histograms of errors on a logarithmic axis, in per cent of object pixels; arguments of cumulative_plot."""
    # The first and last bin are drawn to beyond the ends of the axis.
    edges = np.concatenate([[HISTOGRAM_EDGES_DEG[1] / 1.26], HISTOGRAM_EDGES_DEG[1:-1], [1000.0]])
    shares = [100.0 * s.counts / s.row.pixels for s in curves.values()]
    styles = [LINES[line % len(LINES)] for line in lines]
    top = round_limit(1.02 * max(float(share.max()) for share in shares))
    vertical = Ruler("object pixels per bin, %", 0.0, top, round_ticks(top))
    plot = Plot(
        DEGREES,
        vertical,
        lambda: [
            StepPatch(share, edges, fill=False, edgecolor=colour, ls=dashes, lw=1.5)
            for share, (colour, dashes) in zip(shares, styles, strict=True)
        ],
    )
    caption = (
        "Share of all object pixels per bin, ten bins to a decade of degrees; errors below 0.001° are in the first."
    )
    return plot_panel(key, f"Histogram of error, {what}", caption, plot, tuple(zip(curves, lines)))


def legend_entries(legend: tuple[tuple[str, int], ...]) -> tuple[list[Line2D], list[str]]:
    """(a line in its style, its label) of each curve of a ``legend``; no label is taken for a formula."""
    handles = [Line2D([], [], **style_of(line)) for _, line in legend]
    return handles, [label.replace("$", r"\$") for label, _ in legend]


@lru_cache(maxsize=32)
def legend_image(legend: tuple[tuple[str, int], ...], width: int) -> np.ndarray:
    """Return a legend as an image of the given width, with one line of text for each curve, for plots in files."""
    figure = Figure(figsize=(width / PLOT_DPI, 0.06 + 0.17 * len(legend)), dpi=PLOT_DPI)
    handles, labels = legend_entries(legend)
    size = min(8.0, 8.0 * 48 / max(len(label) for label, _ in legend))
    figure.legend(handles, labels, loc="center", fontsize=size, frameon=False, handlelength=2.6, labelspacing=0.3)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return pixels_of(canvas)


DEGREES = Ruler("angular error, degrees", 0.005, 180.0, (0.01, 0.1, 1.0, 10.0, 100.0), log=True)
PER_CENT = (0.0, 25.0, 50.0, 75.0, 100.0)


@lru_cache(maxsize=1)
def _boxes() -> tuple[Axes, Axes, FigureCanvasAgg, Any]:
    """Return the two axes of a colour cloud, their canvas, and its pixels with the empty boxes on it."""
    figure, left, right = _empty_boxes()
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return left, right, canvas, canvas.copy_from_bbox(figure.bbox)


def _empty_boxes() -> tuple[Figure, Axes, Axes]:
    """A new figure with the two empty boxes of a colour cloud."""
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
    return figure, both[0], both[1]


def _cloud(points: np.ndarray, on: np.ndarray, wire: np.ndarray) -> list[Line2D]:
    """Points (N, 3), blue where ``on``, else orange, and lines ``wire`` (P, 3), in the view VIEW of their box."""
    every = np.concatenate([points, wire])
    low, high = np.nanmin(every, axis=0), np.nanmax(every, axis=0)

    def projected(xyz: np.ndarray) -> np.ndarray:
        return (((xyz - low) / np.maximum(high - low, 1e-12) - 0.5) @ VIEW).T

    artists = [Line2D(*projected(wire), color="#333333", lw=0.5, alpha=0.8)]
    for chosen, colour in ((~on, maps.REJECTED_COLOUR), (on, maps.ACCEPTED_COLOUR)):
        artists.append(
            Line2D(*projected(points[chosen]), ls="none", marker=".", ms=2.2, mew=0, color=tuple(colour / 255))
        )
    return artists


def _read_png(path: Path) -> np.ndarray:
    import imageio.v3

    image = np.asarray(imageio.v3.imread(path))
    if image.ndim == 2:
        image = np.repeat(image[..., None], 3, axis=-1)
    return image[..., :3].astype(np.uint8)


def _shrunk(panel: Panel) -> Panel:
    return panel if panel.plot else replace(panel, image=maps.shrink(panel.image, MAP_PIXELS))
