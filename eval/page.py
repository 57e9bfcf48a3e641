"""The report as one HTML file that needs nothing else: no network, no script, every image inside it."""

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import jinja2
import numpy as np

from eval import maps
from eval.figures import LINES, Panel
from eval.maps import Scale
from eval.metrics import Row
from eval.score import Item
from eval.table import COLUMNS, PICTURE_COLUMNS, best_cells, degrees_text, failures, share_text


@dataclass(frozen=True)
class Picture:
    """A panel made ready for the page: its image as a data URI, its colour bar as another."""

    title: str
    caption: str
    alt: str
    uri: str
    width: int
    height: int
    plot: bool
    bar: str | None  # data URI of the colours, low to high
    bar_label: str
    ticks: tuple[tuple[float, str], ...]  # (per cent along the bar, text)
    legend: tuple[tuple[str, str, str], ...]  # (label, colour, SVG dash array) of a plot's curves


@dataclass(frozen=True)
class CaseSection:
    """One method on one picture, as the page shows it."""

    row: Row
    anchor: str
    pictures: tuple[Picture, ...]
    summary: str


@dataclass(frozen=True)
class ItemSection:
    """One picture with all methods on it."""

    item: Item
    anchor: str
    pictures: tuple[Picture, ...]
    cases: tuple[CaseSection, ...]


def picture(panel: Panel, quality: int = 90) -> Picture:
    """Return ``panel`` with its image encoded in WebP's ``quality``, up to 100."""
    height, width = panel.image.shape[:2]
    scale = panel.scale
    ticks = tuple((100.0 * float(scale.position(v)), text) for v, text in scale.ticks) if scale else ()
    return Picture(
        title=panel.title,
        caption=panel.caption,
        alt=panel.alt,
        uri=data_uri(panel.image, quality),
        width=width,
        height=height,
        plot=panel.plot,
        bar=_bar_uri(scale) if scale else None,
        bar_label=scale.label if scale else "",
        ticks=ticks,
        legend=tuple((label, *_svg_style(line)) for label, line in panel.legend),
    )


def data_uri(image: np.ndarray, quality: int) -> str:
    """Return (H, W, 3) bytes as a WebP data URI: small, since a page holds a dozen of them per result."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "WEBP", quality=quality, method=1)
    return "data:image/webp;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")


@lru_cache(maxsize=32)
def _bar_uri(scale: Scale) -> str:
    return data_uri(maps.bar(scale, height=4), 90)


def case_summary(row: Row) -> str:
    """Return the sentence that stands above a case's figures."""
    if row.status == "missing":
        return "No estimate on disk: the method was not run on this picture."
    if not row.scored > 0:
        return "The method gives no normals here, so there is nothing to score."
    text = (
        f"Median error {degrees_text(row.median_deg)}°, mean {degrees_text(row.mean_deg)}°, over "
        f"{share_text(row.coverage)} % of the object's pixels."
    )
    if row.accepted > 0:
        text += f" On accepted pixels the median is {degrees_text(row.accepted_median_deg)}°."
    if row.median_deg > 2 * row.median_deg_flip:
        text += f" Its convex/concave twin would be better: {degrees_text(row.median_deg_flip)}°."
    return text


def render_page(
    name: str,
    rows: Sequence[Row],
    across: Sequence[Picture],
    items: Sequence[ItemSection],
    versions: dict[str, Any],
) -> str:
    """Return the page. Everything that comes from configs and estimates is escaped by the template engine.

    Args:
        name: of the run.
        rows: the overview table, in order.
        across: figures over all items.
        items: a section each; their cases come in the order of ``rows``.
        versions: of the programs that made the run, from its manifest.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("eval", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    best = best_cells(rows)
    anchors = [case.anchor for section in items for case in section.cases]
    table = [
        {
            "row": row,
            "anchor": anchor,
            "first": not i or (row.config, row.transport) != (rows[i - 1].config, rows[i - 1].transport),
            "facts": [f"{column.heading} {column.cell(row)}" for column in PICTURE_COLUMNS],
            "cells": [(column.cell(row), (i, column.key) in best) for column in COLUMNS],
        }
        for i, (row, anchor) in enumerate(zip(rows, anchors, strict=True))
    ]
    return environment.get_template("index.html.j2").render(
        name=name,
        columns=COLUMNS,
        picture_columns=PICTURE_COLUMNS,
        table=table,
        across=across,
        items=items,
        versions=versions,
        failures=failures(rows),
    )


def _svg_style(line: int) -> tuple[str, str]:
    colour, dashes = LINES[line % len(LINES)]
    return colour, "none" if isinstance(dashes, str) else " ".join(f"{2 * length}" for length in dashes[1])
