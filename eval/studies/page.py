"""The content of a finished study as records, and its three files: a self-contained HTML page, Markdown, and CSV."""

import csv
import io
import math
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from huesphere.eval.export import save_vector, write_text
from huesphere.eval.html import templates
from huesphere.eval.maps import data_uri

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas


@dataclass(frozen=True)
class Figure:
    """One picture or plot."""

    key: str  # unique within a study; the name of its file
    title: str
    image: np.ndarray  # (H, W, 3) bytes
    caption: str = ""
    vector: "Canvas | None" = None  # of a plot: the same as a Matplotlib figure, for SVG and PDF


@dataclass(frozen=True)
class Table:
    """A table of texts; the first column names the row."""

    head: tuple[str, ...]  # headings of the columns
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""

    @property
    def numeric(self) -> tuple[bool, ...]:
        """Whether each column holds numbers, which are aligned to the right."""
        first_letters = ("", *("".join(row[k][:1] for row in self.rows) for k in range(1, len(self.head))))
        return tuple(any(c.isdigit() or c == "–" for c in letters) for letters in first_letters)


@dataclass(frozen=True)
class Claim:
    """A statement of the report, what this project measures of it, and whether it holds."""

    key: str  # unique within a study
    place: str  # where the statement is in the report, such as "2.2, Fig. 1(c)"
    says: str  # the statement
    measured: str  # the measurement, in sentences
    verdict: str  # one of VERDICTS
    numbers: dict[str, float] = field(default_factory=dict)  # the measured numbers, for the CSV file


# Verdicts and their marks. "does not follow": the statement may be true, but not for the reason that is given.
# "measured": there is no statement to judge.
VERDICTS = {"holds": "✓", "in part": "◐", "does not hold": "✗", "does not follow": "≠", "measured": "•"}


@dataclass(frozen=True)
class Section:
    """A section of the page: its heading, then text, claims, tables and figures in this order."""

    title: str
    text: tuple[str, ...] = ()  # paragraphs
    claims: tuple[Claim, ...] = ()
    tables: tuple[Table, ...] = ()
    figures: tuple[Figure, ...] = ()
    wide: bool = False  # whether each figure takes the whole width of the page

    @property
    def anchor(self) -> str:
        """The section's id on the page."""
        return "".join(c if c.isalnum() else "-" for c in self.title.lower()).strip("-")


@dataclass(frozen=True)
class Study:
    """The content of a finished study."""

    name: str  # name of its config
    title: str
    answer: tuple[str, ...]  # paragraphs; the first is the answer in short
    sections: tuple[Section, ...]
    rows: tuple[dict[str, Any], ...]  # rows of results.csv by column; if empty, the numbers of the claims are written
    seconds: float = 0.0  # that the study took


def verdict(holds: bool, in_part: bool = False) -> str:
    """The verdict for an outcome; ``in_part`` is used only where the statement does not hold."""
    return "holds" if holds else "in part" if in_part else "does not hold"


def write_study(folder: Path, study: Study) -> Path:
    """Write index.html, study.md, results.csv and figures/*.png into ``folder``; returns the path of index.html.

    Plots are written as SVG and PDF too. Figures of an earlier run are removed. Raises ValueError where two figures
    have the same key.
    """
    from PIL import Image

    shutil.rmtree(folder / "figures", ignore_errors=True)
    (folder / "figures").mkdir(parents=True)
    for figure in _figures(study):
        Image.fromarray(figure.image).save(folder / "figures" / f"{figure.key}.png", optimize=True)
        if figure.vector is not None:
            save_vector(figure.vector, folder / "figures", figure.key)
    write_text(folder / "results.csv", csv_text(study))
    write_text(folder / "study.md", markdown(study))
    page = folder / "index.html"
    write_text(page, html(study))
    return page


def html(study: Study) -> str:
    """The HTML page of a study, with all images embedded, so that it needs no other file."""
    uris = {figure.key: data_uri(figure.image, 88) for figure in _figures(study)}
    claims = [(claim, section) for section in study.sections for claim in section.claims]
    tally = {word: sum(claim.verdict == word for claim, _ in claims) for word in VERDICTS}
    return (
        templates()
        .get_template("study.html.j2")
        .render(study=study, uris=uris, claims=claims, marks=VERDICTS, tally={w: n for w, n in tally.items() if n})
    )


def markdown(study: Study) -> str:
    """The content of a study as Markdown, for the documentation; it refers to the files of the figures."""
    lines = [f"# {study.title}", ""]
    for paragraph in study.answer:
        lines += [paragraph, ""]
    for section in study.sections:
        lines += [f"## {section.title}", ""]
        for paragraph in section.text:
            lines += [paragraph, ""]
        if section.claims:
            lines += _markdown_table(
                ("report", "what it says", "what we measure", "verdict"),
                [(c.place, c.says, c.measured, f"{VERDICTS[c.verdict]} {c.verdict}") for c in section.claims],
            )
        for table in section.tables:
            lines += [f"*{table.caption}*", ""] if table.caption else []
            lines += _markdown_table(table.head, table.rows)
        for figure in section.figures:
            said = f"{figure.title}. {figure.caption}".strip()
            lines += [f"![{figure.title}](figures/{figure.key}.png)", "", f"*{said}*", ""]
    return "\n".join(lines).rstrip() + "\n"


def csv_text(study: Study) -> str:
    """results.csv of a study: ``study.rows``, or the numbers of the claims; an empty cell means not known."""
    rows = study.rows or tuple(
        {"claim": claim.key, "report": claim.place, "verdict": claim.verdict, "number": name, "value": value}
        for section in study.sections
        for claim in section.claims
        for name, value in claim.numbers.items()
    )
    head = list(dict.fromkeys(key for row in rows for key in row))
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(head)
    for row in rows:
        writer.writerow([_cell(row.get(key, "")) for key in head])
    return out.getvalue()


def _cell(value: Any) -> Any:
    """``value`` as a cell of a CSV file: empty if it is a number that is not finite."""
    return "" if isinstance(value, float) and not math.isfinite(value) else value


def _figures(study: Study) -> list[Figure]:
    """All figures of a study. Raises ValueError where two have the same key."""
    found = [figure for section in study.sections for figure in section.figures]
    keys = [figure.key for figure in found]
    if len(set(keys)) < len(keys):
        raise ValueError(f"two figures with the same key: {sorted(k for k in set(keys) if keys.count(k) > 1)}")
    return found


def _markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """The lines of a Markdown table and an empty line."""

    def line(cells: Sequence[str]) -> str:
        return "| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in cells) + " |"

    return [line(head), line(["---"] * len(head)), *(line(row) for row in rows), ""]
