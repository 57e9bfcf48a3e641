"""The evaluation report as HTML without any link to the network: one file, or an overview and a page per picture."""

import importlib.metadata
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from huesphere.eval import maps, viewer
from huesphere.eval.figures import Panel
from huesphere.eval.html import templates
from huesphere.eval.maps import Scale, data_uri
from huesphere.eval.metrics import Row
from huesphere.eval.plot import LINES
from huesphere.eval.regions import RegionErrors
from huesphere.eval.score import Item
from huesphere.eval.summary import HEADINGS, Summary, best_of
from huesphere.eval.table import COLUMNS, PICTURE_COLUMNS, best_cells, degrees_text, doubted_results, share_text
from huesphere.eval.verdict import NO_VERDICT, VERDICTS, Verdict

THUMBNAIL_PIXELS = 128  # no side of a thumbnail is longer
PLOTTING_LIBRARY = "plotly.min.js"  # file name, if several pages share it
NO_GALLERY = "There are too many pictures to show each small on this page: the table leads to the page of each."


@dataclass(frozen=True)
class Picture:
    """A figure ready for the page, with its image and colour bar as data URIs."""

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
class Thumbnail:
    """A small image for the gallery."""

    alt: str
    uri: str
    width: int
    height: int


@dataclass(frozen=True)
class CaseSection:
    """The section of the page on one method on one picture."""

    row: Row
    anchor: str  # id of the section
    summary: str  # sentences above the figures
    thumbnails: tuple[Thumbnail, ...]
    pictures: tuple[Picture, ...] = ()  # figures; () if those of this picture are not drawn
    verdict: Verdict = NO_VERDICT  # of the method itself
    regions: tuple[RegionErrors, ...] = ()  # errors by what the light does at a pixel
    tried: tuple[str, ...] = ()  # of a result that is not trusted: what the method did
    facts: tuple[str, ...] = ()  # likewise: what the picture's colours show


@dataclass(frozen=True)
class ItemSection:
    """The section of the page on one picture with all methods."""

    item: Item
    anchor: str  # id of the section
    cases: tuple[CaseSection, ...]
    thumbnails: tuple[Thumbnail, ...] = ()
    viewer: Path | None = None  # JSON file with the data for the inspector; None if the picture was not rendered
    pictures: tuple[Picture, ...] = ()


def picture(panel: Panel, quality: int = 90) -> Picture:
    """Return ``panel`` as a figure of the page; ``quality`` is WebP's, up to 100."""
    height, width = panel.image.shape[:2]
    scale = panel.scale
    return Picture(
        title=panel.title,
        caption=panel.caption,
        alt=panel.alt,
        uri=data_uri(panel.image, quality, clear=not panel.plot),
        width=width,
        height=height,
        plot=panel.plot,
        bar=_bar_uri(scale) if scale else None,
        bar_label=scale.label if scale else "",
        ticks=_ticks(scale) if scale else (),
        legend=tuple((label, *_svg_style(line)) for label, line in panel.legend),
    )


def thumbnail(image: np.ndarray, alt: str) -> Thumbnail:
    """Return a small copy of an image (H, W, 3) of bytes, with the alternative text ``alt``."""
    small = maps.shrink(image, THUMBNAIL_PIXELS)
    return Thumbnail(alt, data_uri(small, 75, clear=True), small.shape[1], small.shape[0])


def case_summary(row: Row) -> str:
    """Return the sentences above the figures of a case."""
    if row.status == "missing":
        return "No estimate on disk: the method was not run on this picture."
    if not row.scored > 0:
        return "The method gives no normals for this picture, so there is nothing to score."
    text = (
        f"Median error {degrees_text(row.median_deg)}°, mean {degrees_text(row.mean_deg)}°, over "
        f"{share_text(row.coverage)}\u00a0% of the object's pixels."
    )
    if np.isfinite(row.within_stated):
        text += (
            f" Stated is {degrees_text(row.stated_median_deg)}° (median); {share_text(row.within_stated)}\u00a0% of "
            "the pixels err by no more than is stated for them."
        )
    if row.accepted > 0:
        text += f" On accepted pixels the median is {degrees_text(row.accepted_median_deg)}°."
    if row.median_deg > 2 * row.median_deg_flip:
        text += f" Its convex/concave twin would be better: {degrees_text(row.median_deg_flip)}°."
    return text


# More than seven parameters and more than sixty lines: everything that the pages show, and the list of their parts.
def render_pages(
    name: str,
    rows: Sequence[Row],
    summaries: Sequence[Summary],
    across: Sequence[Picture],
    items: Sequence[ItemSection],
    versions: dict[str, Any],
    *,
    notes: Sequence[str] = (),
    limit: float,
) -> Iterator[tuple[str, str]]:
    """Yield the files of the report one by one as (path, text).

    It is one page if that is no larger than ``limit`` bytes, and otherwise an overview and a page for each picture. If
    the overview by itself would be larger than ``limit``, it has no thumbnails, and a note says so. The template engine
    escapes everything that comes from configs and estimates.

    Args:
        name: name of the run.
        rows: rows of the overview table, in order.
        summaries: summary of each method over all items.
        across: figures over all items.
        items: section of each item; their cases are in the order of ``rows``.
        versions: versions of the programs that made the run, from its manifest.
        notes: remarks for the reader, such as on figures that are not drawn.
        limit: largest size of one page in bytes.
    """
    environment = templates()
    constants = viewer.constants()
    environment.globals |= {
        "degrees": degrees_text,
        "share": share_text,
        "docs": documentation(),
        "constants": constants,
    }
    library = _plotting_library()
    shared = {
        "name": name,
        "versions": versions,
        "error_bar": {"uri": _bar_uri(maps.ERROR_SCALE), "ticks": _ticks(maps.ERROR_SCALE)},
    }
    overview = {
        **shared,
        "items": items,
        "gallery": items,
        "columns": COLUMNS,
        "picture_columns": PICTURE_COLUMNS,
        "table": _table(rows, items),
        "methods": list(dict.fromkeys(row.method for row in rows if row.method)),
        "statuses": list(dict.fromkeys(row.status for row in rows)),
        "verdicts": [word for word in VERDICTS if any(row.verdict == word for row in rows)],
        "summaries": _summaries(summaries),
        "summary_headings": HEADINGS,
        "across": across,
        "doubted": doubted_results(rows, [case.verdict for section in items for case in section.cases]),
        "notes": notes,
    }
    index = environment.get_template("index.html.j2")
    if len(library) + sum(section.viewer.stat().st_size for section in items if section.viewer) <= limit:
        html = index.render(**overview, split=False, library=library)
        if len(html.encode()) <= limit:
            yield "index.html", html
            return
    html = index.render(**overview, split=True, library="")
    if len(html.encode()) > limit:
        overview |= {"gallery": (), "notes": [*notes, NO_GALLERY]}
        html = index.render(**overview, split=True, library="")
    yield "index.html", html
    yield PLOTTING_LIBRARY, library
    template = environment.get_template("picture.html.j2")
    for n, section in enumerate(items):
        around = {"before": items[n - 1] if n else None, "after": items[n + 1] if n + 1 < len(items) else None}
        yield f"pictures/{section.anchor}.html", template.render(**shared, **around, section=section, split=True)


def documentation() -> str:
    """Address of the documentation as the installed package names it, ending in "/"; "" if it names none."""
    try:
        given = importlib.metadata.metadata("huesphere").get_all("Project-URL") or []
    except importlib.metadata.PackageNotFoundError:
        return ""
    named = dict(entry.split(", ", 1) for entry in given if ", " in entry)
    address = str(named.get("Documentation", ""))
    return address.rstrip("/") + "/" if address else ""


def _table(rows: Sequence[Row], items: Sequence[ItemSection]) -> list[dict[str, Any]]:
    """Lines of the overview table: text of each cell, value to sort by, and whether it is the best on its picture."""
    best = best_cells(rows)
    places = [(section, case) for section in items for case in section.cases]
    return [
        {
            "row": row,
            "section": section,
            "anchor": case.anchor,
            "verdict": case.verdict,
            "cells": [
                {"text": column.cell(row), "value": getattr(row, column.key), "best": (i, column.key) in best}
                for column in (*COLUMNS, *PICTURE_COLUMNS)
            ],
        }
        for i, (row, (section, case)) in enumerate(zip(rows, places, strict=True))
    ]


def _summaries(summaries: Sequence[Summary]) -> list[tuple[str, str, list[tuple[str, bool]]]]:
    """For each method and transport their names, and the text of each cell with whether it is the best."""
    best = best_of(summaries)
    return [
        (s.label, s.transport, [(text, (i, k) in best) for k, text in enumerate(s.cells)])
        for i, s in enumerate(summaries)
    ]


@lru_cache(maxsize=1)
def _plotting_library() -> str:
    """The code of plotly.js, from the Python package plotly."""
    from plotly.offline import get_plotlyjs

    return get_plotlyjs()


def _ticks(scale: Scale) -> tuple[tuple[float, str], ...]:
    """(place in per cent of the colour bar, text) of each tick."""
    return tuple((100.0 * float(scale.position(v)), text) for v, text in scale.ticks)


@lru_cache(maxsize=32)
def _bar_uri(scale: Scale) -> str:
    return data_uri(maps.bar(scale, height=4), 90)


def _svg_style(line: int) -> tuple[str, str]:
    """Colour and SVG dash array of the style LINES[line]."""
    colour, dashes = LINES[line % len(LINES)]
    return colour, "none" if isinstance(dashes, str) else " ".join(f"{2 * length}" for length in dashes[1])
