"""The report's figures, one per function: Fig. 1 (a)-(g), Fig. 2 (a)-(c), and curves that put methods side by side.

Every figure is a ``Panel``: an image as bytes and the words beside it. Maps are coloured arrays at the picture's own
pixels (eval/maps.py); plots are drawn by matplotlib's object interface, with no global state.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from eval import maps, slopes
from eval.maps import Scale
from eval.score import HISTOGRAM_EDGES_DEG, QUANTILES, Case, Scene, Score
from eval.table import degrees_text
from recover.estimate import Estimate
from render.dataset import lights_seen

MAP_PIXELS = 512  # no side of a map is longer
CLOUD_POINTS = 2000
PLOT_INCHES, PLOT_DPI = (4.0, 3.1), 150
# Okabe & Ito's colours that show on white, each with its own dashes for grey print; a run's methods take them in order.
LINES: tuple[tuple[str, str | tuple[int, tuple[int, ...]]], ...] = (
    ("#0072B2", "-"),
    ("#D55E00", (0, (5, 2))),
    ("#009E73", (0, (1, 1))),
    ("#CC79A7", (0, (5, 1, 1, 1))),
    ("#000000", (0, (3, 1, 1, 1, 1, 1))),
    ("#56B4E9", "-"),
    ("#E69F00", (0, (5, 2))),
)
DEGREE_TICKS = [0.01, 0.1, 1.0, 10.0, 100.0]
# The colour cloud is seen from azimuth −60° and elevation 25°: (3, 2), to the right and up on the page.
VIEW = np.array([[0.866, -0.211], [0.5, 0.366], [0.0, 0.906]])
# Per axis the two corners of the unit box between which its outermost edge runs, seen so.
OUTER_EDGES = (((0, 0, 0), (1, 0, 0)), ((1, 0, 0), (1, 1, 0)), ((1, 1, 0), (1, 1, 1)))


@dataclass(frozen=True)
class Panel:
    """One figure: its bytes and what to say beside it."""

    key: str  # a file name without ending
    title: str
    caption: str
    image: np.ndarray  # (H, W, 3) uint8
    scale: Scale | None = None  # of a map: the colour bar to set under it
    plot: bool = False  # a plot with text in it, to be kept sharp

    @property
    def alt(self) -> str:
        return f"{self.title}: {self.caption}"


# --- of an item: what every method is judged against ------------------------------------------------------------------


def scene_panels(scene: Scene) -> list[Panel]:
    """Return the picture and the truth of an item: Fig. 1 (a), (b) and Fig. 2 (a) of the report, and more."""
    truth, mask = scene.truth, scene.mask
    panels = [
        Panel("picture", "Picture", "What recovery is given, display-encoded. (Fig. 1b)", picture(scene)),
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
        panels.append(Panel("lights_seen", "Lights seen", "Pixels that miss a light leave the ellipsoid.", image, scale))
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


# --- of a case: one method on one picture -----------------------------------------------------------------------------


def case_panels(scene: Scene, case: Case, line: int) -> list[Panel]:
    """Return the figures of one method on one picture; those that the estimate has no data for are left out."""
    estimate = case.estimate
    if estimate is None:
        return []
    mask = scene.mask
    normals = np.where((estimate.valid & mask)[..., None], estimate.normals, np.nan)
    panels = [
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
            maps.scalar_map(case.error_deg, mask, maps.ERROR_SCALE),
            maps.ERROR_SCALE,
        ),
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
            "Zero on a surface that exists.",
            maps.scalar_map(slopes.integrability_error(normals, np.isfinite(normals[..., 2])), mask, maps.INTEGRABILITY_SCALE),
            maps.INTEGRABILITY_SCALE,
        )
    )
    panels += [panel] if (panel := alpha_plot(estimate)) else []
    panels += shaded_panels(scene, estimate, normals)
    return [_shrunk(panel) for panel in panels]


def ellipsoid_panels(scene: Scene, estimate: Estimate) -> list[Panel]:
    """Return Fig. 1 (c) and (e): the colours on their ellipsoid, and |p_y − q_x| of the unrotated normals."""
    C = _matrix(estimate.diagnostics.get("C"))
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
            "The best that could be done there. (Fig. 2b)",
            maps.shading_map(truth, scene.mask),
        ),
        Panel(
            "recovered_shaded",
            "Recovered p and q, same light",
            "As close to the last as the method is right. (Fig. 2c)",
            maps.shading_map(recovered, scene.mask),
        ),
    ]


def error_plot(score: Score, line: int) -> Panel:
    """Return Fig. 1 (g): the histogram of angular errors, bars, and their cumulative share, line."""
    errors = score.quantiles_deg
    limit = _round_limit(float(np.interp(0.99, QUANTILES, errors)))
    x = np.linspace(0.0, limit, 33)
    # Quantiles stand for the errors: 401 of them hold a histogram of 32 bins to a fraction of a percent.
    below = 100.0 * np.interp(x, errors, QUANTILES, left=0.0, right=1.0)
    bars = np.diff(below)
    colour, median = LINES[line % len(LINES)][0], score.row.median_deg
    figure, axes = _plot()
    axes.stairs(100.0 * bars / max(bars.max(), 1e-12), x, fill=True, color=colour, alpha=0.45)
    axes.plot(x, below, color="black", lw=1.4)
    axes.axvline(median, color=colour, lw=1.2, ls=(0, (4, 2)))
    axes.set(xlim=(0, limit), ylim=(0, 102))
    axes.set_title(f"median {degrees_text(median)}°, mean {degrees_text(score.row.mean_deg)}°", fontsize=9)
    _ticks(axes, [limit * t for t in (0.0, 0.25, 0.5, 0.75, 1.0)], [0.0, 25.0, 50.0, 75.0, 100.0])
    _labels(axes, "angular error, degrees", "scored pixels below, %")
    caption = (
        "Line: share of the scored pixels whose error is below x. Bars: their density, the tallest bin drawn at 100. "
        "Dashed: the median. (Fig. 1g)"
    )
    return Panel("histogram", "Histogram of angular error", caption, _image(figure), plot=True)


def alpha_plot(estimate: Estimate) -> Panel | None:
    """Return Fig. 1 (f): what is minimised over the angle α about r3, one curve for each candidate eigenvector."""
    curve = estimate.diagnostics.get("alpha_curve")
    if not curve or not curve.get("value"):
        return None
    angles = np.asarray(curve["alpha_deg"], dtype=np.float64)
    values = np.array(curve["value"], dtype=np.float64)  # None, a gap, becomes NaN
    values = np.where(values > 0, values, np.nan)
    if not np.isfinite(values).any():
        return None
    values /= np.nanmin(values)
    figure, axes = _plot()
    for number, relative in enumerate(values):
        colour, dashes = LINES[number % len(LINES)]
        axes.plot(angles, relative, color=colour, ls=dashes, lw=1.6, label=f"candidate {number + 1}")
    most = float(np.nanmax(values))
    axes.set(xlim=(angles.min(), angles.max()), yscale="log", ylim=(0.9, 1.15 * most))
    _ticks(axes, list(np.linspace(angles.min(), angles.max(), 7)), _log_ticks(most))
    _labels(axes, "α, degrees", "integral of (p_y − q_x)², least = 1")
    caption = "What is minimised over the angle about r3, for both candidates. (Fig. 1f)"
    if isinstance(curve.get("chosen"), int | float):
        axes.axvline(curve["chosen"], color="black", lw=1.0, ls=(0, (4, 2)))
        caption = f"{caption[:-10]} Dashed: the angle taken, {curve['chosen']:.1f}°. (Fig. 1f)"
    axes.legend(fontsize=8, frameon=False, loc="lower center", bbox_to_anchor=(0.5, 0.99), ncols=2, handlelength=2.6)
    return Panel("alpha", "Angle α", caption, _image(figure), plot=True)


def colour_cloud(rgb: np.ndarray, mask: np.ndarray, accepted: np.ndarray, C: np.ndarray) -> Panel:
    """Return Fig. 1 (c): colours of the object and the ellipsoid ρᵀ C ρ = 1 that the method fitted, in colour space.

    Left in camera RGB; right along the ellipsoid's own axes, each in units of its semi-axis, where it is a unit sphere
    and shells that miss a light lie inside: natural light makes the ellipsoid too thin to read in RGB. Both are
    orthographic views of the box that holds them, whose three sides are stretched to one length.
    """
    index = np.flatnonzero(mask & np.isfinite(rgb).all(axis=-1))
    index = index[:: max(1, -(-len(index) // CLOUD_POINTS))]
    rho, on = rgb.reshape(-1, 3)[index].astype(np.float64), accepted.ravel()[index]
    values, vectors = np.linalg.eigh(C)
    to_sphere = vectors * np.sqrt(values)  # row vectors: ρ @ to_sphere lies on the unit sphere
    if np.median((rho @ to_sphere)[:, 0]) < 0:
        to_sphere[:, 0] *= -1.0  # the ellipsoid's longest axis points to brighter colours
    unit = rho @ to_sphere
    wire = _cap(unit[on] if on.any() else unit)
    figure = Figure(figsize=(2 * PLOT_INCHES[0], PLOT_INCHES[1]), dpi=PLOT_DPI)
    _draw_cloud(figure, (0.0, 0.0, 0.5, 1.0), rho, on, wire @ np.linalg.inv(to_sphere), ("R", "G", "B"))
    _draw_cloud(figure, (0.5, 0.0, 0.5, 1.0), unit, on, wire, ("axis 1", "axis 2", "axis 3"))
    caption = (
        "Blue: accepted, orange: rejected, lines: the fitted ellipsoid. Left in camera RGB; right along the ellipsoid's "
        "own axes, each in units of its semi-axis, where it is a sphere. (Fig. 1c)"
    )
    return Panel("colour_cloud", "Colours and their ellipsoid", caption, _image(figure), plot=True)


# --- across items -----------------------------------------------------------------------------------------------------


def cumulative_plot(scores: Sequence[Score], labels: Sequence[str], lines: Sequence[int], key: str, what: str) -> Panel:
    """Return overlaid cumulative curves: share of all *object* pixels whose error is below x, so each ends at coverage."""
    figure, axes = _plot(wide=True)
    for score, label, line in zip(scores, labels, lines, strict=True):
        colour, dashes = LINES[line % len(LINES)]
        x = np.maximum(score.quantiles_deg, 1e-9)
        axes.plot(x, 100 * QUANTILES * score.row.coverage, color=colour, ls=dashes, lw=1.5, label=label)
    axes.set(xscale="log", xlim=(0.005, 180.0))
    axes.set_ylim(0, 102)
    _ticks(axes, DEGREE_TICKS, [0.0, 25.0, 50.0, 75.0, 100.0])
    _labels(axes, "angular error, degrees", "object pixels below, %")
    _legend(axes, len(labels))
    caption = "Share of all object pixels whose error is below x. A curve ends at its coverage. Left and higher is better."
    return Panel(key, f"Cumulative error, {what}", caption, _image(figure), plot=True)


def histogram_plot(scores: Sequence[Score], labels: Sequence[str], lines: Sequence[int], key: str, what: str) -> Panel:
    """Return overlaid histograms of errors on a logarithmic axis, in per cent of all object pixels, ten bins a decade."""
    figure, axes = _plot(wide=True)
    edges = np.concatenate([[HISTOGRAM_EDGES_DEG[1] / 1.26], HISTOGRAM_EDGES_DEG[1:]])
    for score, label, line in zip(scores, labels, lines, strict=True):
        colour, dashes = LINES[line % len(LINES)]
        axes.stairs(100 * score.counts / score.row.pixels, edges, color=colour, ls=dashes, lw=1.4, label=label)
    axes.set(xscale="log", xlim=(0.005, 180.0))
    top = _round_limit(1.02 * max(100.0 * s.counts.max() / s.row.pixels for s in scores))
    axes.set_ylim(0, top)
    _ticks(axes, DEGREE_TICKS, [top * t for t in (0.0, 0.25, 0.5, 0.75, 1.0)])
    _labels(axes, "angular error, degrees", "object pixels per bin, %")
    _legend(axes, len(labels))
    return Panel(key, f"Histogram of error, {what}", "Ten bins to a decade of degrees.", _image(figure), plot=True)


# --- drawing ----------------------------------------------------------------------------------------------------------


def _plot(*, wide: bool = False) -> tuple[Figure, Axes]:
    width, height = PLOT_INCHES
    figure = Figure(figsize=(1.6 * width if wide else width, height), dpi=PLOT_DPI)
    axes = figure.add_axes((0.10, 0.16, 0.62, 0.80) if wide else (0.155, 0.16, 0.70, 0.75))
    return figure, axes


def _ticks(axes: Axes, x: list[float], y: list[float]) -> None:
    """Set few ticks by hand: matplotlib spends most of a small plot's time on them."""
    for axis, values in ((axes.xaxis, x), (axes.yaxis, y)):
        axis.set_major_locator(FixedLocator(values))
        axis.set_minor_locator(NullLocator())
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.4g}"))
    axes.tick_params(labelsize=8, colors="#333333")
    axes.grid(True, color="#e3e7eb", lw=0.6)
    axes.set_axisbelow(True)


def _labels(axes: Axes, x: str, y: str) -> None:
    axes.set_xlabel(x, fontsize=9)
    axes.set_ylabel(y, fontsize=9)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _log_ticks(most: float) -> list[float]:
    """Return 1, 2, 5, 10 … up to ``most``, thinned to decades where they are many."""
    decades = int(np.ceil(np.log10(max(most, 1.0)))) + 1
    if decades <= 3:
        return [m * 10.0**k for k in range(decades) for m in (1, 2, 5) if m * 10.0**k <= 1.15 * most]
    return [10.0**k for k in range(0, decades, -(-decades // 6))]


def _legend(axes: Axes, count: int) -> None:
    if count:
        size = 8 if count <= 8 else 6
        axes.legend(fontsize=size, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5), handlelength=2.6)


def _draw_cloud(
    figure: Figure, place: tuple[float, ...], points: np.ndarray, on: np.ndarray, wire: np.ndarray, names: Sequence[str]
) -> None:
    """Draw (N, 3) points and a (P, 3) wire seen along VIEW, in the box that holds them, into a part of ``figure``."""
    axes = figure.add_axes(place)
    axes.set(xlim=(-1.11, 1.11), ylim=(-0.86, 0.86), aspect="equal")
    axes.set_axis_off()
    every = np.concatenate([points, wire])
    low, high = np.nanmin(every, axis=0), np.nanmax(every, axis=0)

    def seen(xyz: np.ndarray) -> np.ndarray:
        return ((xyz - low) / np.maximum(high - low, 1e-12) - 0.5) @ VIEW

    corners = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)], dtype=np.float64)
    edges = [(a, b) for a in range(8) for b in range(a + 1, 8) if np.sum(corners[a] != corners[b]) == 1]
    for a, b in edges:
        axes.plot(*seen(low + corners[[a, b]] * (high - low)).T, color="#cfd6dd", lw=0.6)
    axes.plot(*seen(wire).T, color="#333333", lw=0.5, alpha=0.8)
    for chosen, colour in ((~on, maps.REJECTED_COLOUR), (on, maps.ACCEPTED_COLOUR)):
        axes.plot(*seen(points[chosen]).T, ls="none", marker=".", ms=2.2, mew=0, color=colour / 255)
    for axis, name in enumerate(names):
        _name_edge(axes, axis, f"{name}, {low[axis]:.2g} to {high[axis]:.2g}")


def _name_edge(axes: Axes, axis: int, text: str) -> None:
    """Write ``text`` along the outer edge of the box that runs in the direction of ``axis``."""
    ends = np.array(OUTER_EDGES[axis], dtype=np.float64) - 0.5
    start, end = ends @ VIEW
    outward = (start + end) / 2.0
    x, y = outward * (1.0 + 0.09 / np.linalg.norm(outward))
    angle = np.degrees(np.arctan2(*(end - start)[::-1]))
    angle = (angle + 90.0) % 180.0 - 90.0
    axes.text(x, y, text, fontsize=8, color="#333333", ha="center", va="center", rotation=angle)


def _cap(unit: np.ndarray) -> np.ndarray:
    """Return parallels and meridians on the unit sphere over the cap that unit vectors (N, 3) take, (P, 3), NaN between."""
    pole = unit.mean(axis=0)
    pole /= max(float(np.linalg.norm(pole)), 1e-12)
    reach = min(np.arccos(np.clip(np.quantile(unit @ pole, 0.01), -1.0, 1.0)) + np.radians(8.0), np.pi)
    across = np.linalg.svd(pole[None])[2][1:]

    def at(polar: np.ndarray | float, azimuth: np.ndarray | float) -> np.ndarray:
        polar, azimuth = np.broadcast_arrays(polar, azimuth)
        sideways = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1) @ across
        return np.cos(polar)[:, None] * pole + np.sin(polar)[:, None] * sideways

    lines = [at(polar, np.linspace(0.0, 2 * np.pi, 61)) for polar in np.linspace(0.0, reach, 7)[1:]]
    lines += [at(np.linspace(0.0, reach, 16), azimuth) for azimuth in np.arange(12) * np.pi / 6]
    return np.concatenate([np.pad(line, ((0, 1), (0, 0)), constant_values=np.nan) for line in lines])


def _image(figure: Figure) -> np.ndarray:
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _read_png(path: Path) -> np.ndarray:
    import imageio.v3

    image = np.asarray(imageio.v3.imread(path))
    if image.ndim == 2:
        image = np.repeat(image[..., None], 3, axis=-1)
    return image[..., :3].astype(np.uint8)


def _matrix(value: object) -> np.ndarray | None:
    """Return a (3, 3) positive definite matrix from a method's diagnostics, or None where there is none."""
    try:
        C = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        return None
    if C.shape != (3, 3) or not np.isfinite(C).all() or np.linalg.eigvalsh(C)[0] <= 0:
        return None
    return C


def _round_limit(value: float) -> float:
    """Return the least of 1, 1.5, 2, 3, 5, 7 × 10^k that is not below ``value``: an axis that ends on a round number."""
    value = max(value, 1e-3)
    decade = 10.0 ** np.floor(np.log10(value))
    return float(next(decade * m for m in (1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0) if decade * m >= value * (1 - 1e-9)))


def _shrunk(panel: Panel) -> Panel:
    return panel if panel.plot else replace(panel, image=maps.shrink(panel.image, MAP_PIXELS))
