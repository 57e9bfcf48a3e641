"""Scores as files for other programs: CSV, JSON, Markdown, LaTeX, PNG figures, and the error of every pixel as EXR."""

import csv
import io
import json
from collections.abc import Sequence
from dataclasses import asdict, fields
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from huesphere.configs.own_folder import made_folder, replacing, write_text
from huesphere.eval import maps
from huesphere.eval.calibration import calibration_curve
from huesphere.eval.compare import Comparison
from huesphere.eval.figures import Panel, legend_entries, legend_image
from huesphere.eval.maps import Scale
from huesphere.eval.metrics import COLUMNS, Row
from huesphere.eval.regions import RegionErrors
from huesphere.eval.score import HISTOGRAM_EDGES_DEG, QUANTILES, Case, Item, Score
from huesphere.eval.table import latex_table, markdown_table
from huesphere.render.dataset import FORMAT_VERSION
from huesphere.render.exr import write_exr

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def write_tables(
    folder: Path, scores: Sequence[Score], comparisons: Sequence[Comparison], versions: dict[str, Any]
) -> None:
    """Write metrics.csv, metrics.json, paired.csv, regions.csv, calibration.csv, table.md and table.tex."""
    rows = [score.row for score in scores]
    write_text(folder / "metrics.csv", csv_text(COLUMNS, rows))
    write_text(folder / "paired.csv", csv_text([field.name for field in fields(Comparison)], comparisons))
    write_text(folder / "regions.csv", _regions_csv(scores))
    write_text(folder / "calibration.csv", _calibration_csv(scores))
    record = {
        "format_version": FORMAT_VERSION,
        "versions": versions,
        "quantiles": QUANTILES,
        "histogram_edges_deg": HISTOGRAM_EDGES_DEG,
        "rows": [asdict(s.row) | {"quantiles_deg": s.quantiles_deg, "histogram": s.counts} for s in scores],
    }
    write_text(folder / "metrics.json", json.dumps(_json_able(record)) + "\n")
    write_text(folder / "table.md", markdown_table(rows))
    write_text(folder / "table.tex", latex_table(rows))


def _regions_csv(scores: Sequence[Score]) -> str:
    """Errors of each result by what the light does at a pixel, as CSV."""
    names = ["config", "transport", "method", *(field.name for field in fields(RegionErrors))]
    lines = [
        [s.row.config, s.row.transport, s.row.method, *asdict(region).values()] for s in scores for region in s.regions
    ]
    return _csv(names, lines)


def _calibration_csv(scores: Sequence[Score]) -> str:
    """The true error by stated error of each result, as CSV; degrees."""
    lines: list[list[Any]] = []
    for s in scores:
        if s.stated is not None:
            curve = calibration_curve([s.stated])
            columns = (curve.stated_deg, curve.low_deg, curve.median_deg, curve.high_deg)
            for *degrees, pixels in zip(*(column.tolist() for column in columns), curve.pixels.tolist(), strict=True):
                lines.append([s.row.config, s.row.transport, s.row.method, *degrees, pixels])
    names = "config,transport,method,stated_deg,true_quartile_deg,true_median_deg,true_upper_quartile_deg,pixels"
    return _csv(names.split(","), lines)


def _csv(names: Sequence[str], lines: Sequence[Sequence[object]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    writer.writerows([_csv_cell(value) for value in line] for line in lines)
    return text.getvalue()


def csv_text(columns: Sequence[str], records: Sequence[Row | Comparison]) -> str:
    """Return a table as CSV: one line per record, numbers with all digits, an empty cell for NaN."""
    return _csv(columns, [list(asdict(record).values()) for record in records])


def write_error_exr(folder: Path, item: Item, case: Case) -> None:
    """Write errors/<config>/<transport>/<method>.exr: channel error_deg in degrees, NaN where not scored."""
    path = folder / "errors" / item.config / item.transport / f"{case.score.row.method}.exr"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_exr(path, {"error_deg": case.error_deg}, {"format_version": FORMAT_VERSION, "status": case.score.row.status})


def write_figure(folder: Path, panel: Panel, *, vector: bool = False) -> None:
    """Write one panel as <folder>/<key>.png, with its colour bar or legend below; if ``vector``, as SVG and PDF too."""
    from PIL import Image

    made_folder(folder)
    image = panel.image
    if panel.scale is not None:
        image = with_bar(image, panel.scale)
    if panel.legend:
        image = np.concatenate([image, legend_image(panel.legend, image.shape[1])])
    with replacing(folder / f"{panel.key}.png") as partial:
        Image.fromarray(image).save(partial, "PNG", compress_level=1)
    if vector:
        _write_vector(folder, panel)


def _write_vector(folder: Path, panel: Panel) -> None:
    """Write a panel as <folder>/<key>.svg and .pdf; without dates, so that the same figure is the same file."""
    figure = _map_figure(panel) if panel.vector is None else panel.vector()
    if panel.legend:
        handles, labels = legend_entries(panel.legend)
        figure.legend(handles, labels, loc="upper center", bbox_to_anchor=(0.5, 0.0), fontsize=8, frameon=False)
    save_vector(figure, folder, panel.key)


def save_vector(figure: "Figure", folder: Path, name: str) -> None:
    """Write a Matplotlib figure as <folder>/<name>.svg and .pdf, without dates."""
    import matplotlib

    for ending, metadata in (("svg", {"Date": None}), ("pdf", {"CreationDate": None})):
        with matplotlib.rc_context({"svg.hashsalt": "huesphere"}), replacing(folder / f"{name}.{ending}") as part:
            figure.savefig(part, format=ending, metadata=metadata, bbox_inches="tight")


def _map_figure(panel: Panel) -> "Figure":
    """A map as a Matplotlib figure: its pixels as they are, and its colour bar."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm, Normalize
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.0, 4.0))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.imshow(panel.image, interpolation="nearest")
    axes.set_axis_off()
    if panel.scale is not None:
        scale = panel.scale
        norm = (LogNorm if scale.log else Normalize)(scale.low, scale.high)
        colours = ScalarMappable(norm, scale.colours)
        bar = figure.colorbar(colours, ax=axes, orientation="horizontal", fraction=0.05, pad=0.03, label=scale.label)
        bar.set_ticks([value for value, _ in scale.ticks], labels=[text for _, text in scale.ticks])
        bar.minorticks_off()
    return figure


def with_bar(image: np.ndarray, scale: Scale) -> np.ndarray:
    """Return an image (H, W, 3) with its colour bar below, (H', W', 3); where the bar is wider, white is added."""
    strip = _bar_image(scale, max(image.shape[1], 300))
    side = strip.shape[1] - image.shape[1]
    padded = np.pad(image, ((0, 6), (side // 2, side - side // 2), (0, 0)), constant_values=255)
    return np.concatenate([padded, strip], axis=0)


@lru_cache(maxsize=32)
def _bar_image(scale: Scale, width: int) -> np.ndarray:
    """The colour bar of a scale with its ticks and label, as an image of this width."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width / 100, 0.52), dpi=100)
    axes = figure.add_axes((0.08, 0.74, 0.84, 0.24))
    axes.imshow(maps.bar(scale), aspect="auto", extent=(0.0, 1.0, 0.0, 1.0))
    axes.set_xticks([float(scale.position(value)) for value, _ in scale.ticks], [text for _, text in scale.ticks])
    axes.tick_params(labelsize=7, length=2, pad=2)
    axes.set_yticks([])
    axes.set_xlabel(scale.label, fontsize=7, labelpad=2)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _csv_cell(value: object) -> str:
    """``value`` as text, empty for NaN."""
    if isinstance(value, float):
        return "" if np.isnan(value) else repr(value)
    return str(value)


def _json_able(value: Any) -> Any:
    """Return ``value`` in types of JSON; NaN and infinity, which JSON does not have, become null."""
    if isinstance(value, dict):
        return {key: _json_able(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray):
        return value.tolist() if np.isfinite(value).all() else _json_able(value.tolist())
    if isinstance(value, list | tuple):
        return [_json_able(entry) for entry in value]
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return value
