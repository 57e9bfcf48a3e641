"""What a study has to say, and the three files that say it: a self-contained page, Markdown, CSV."""

import csv
import io
import math
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from huesphere.eval.export import write_text
from huesphere.eval.html import templates
from huesphere.eval.maps import data_uri


@dataclass(frozen=True)
class Figure:
    """One picture or plot; its key is the name of its file."""

    key: str
    title: str
    image: np.ndarray  # (H, W, 3) bytes
    caption: str = ""


@dataclass(frozen=True)
class Table:
    """Cells as text; the first column names the row."""

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""

    @property
    def numeric(self) -> tuple[bool, ...]:
        """Which columns hold numbers, to be set to the right."""
        first = ("", *("".join(row[k][:1] for row in self.rows) for k in range(1, len(self.head))))
        return tuple(any(c.isdigit() or c == "–" for c in letters) for letters in first)


@dataclass(frozen=True)
class Claim:
    """What is said, what we measure, and whether it holds."""

    key: str
    place: str  # in the report: "2.2, Fig. 1(c)"
    says: str
    measured: str
    verdict: str  # one of VERDICTS
    numbers: dict[str, float] = field(default_factory=dict)


VERDICTS = {"holds": "✓", "in part": "◐", "does not hold": "✗", "does not follow": "≠", "measured": "•"}


@dataclass(frozen=True)
class Section:
    """A heading and what stands under it, in this order: text, claims, tables, figures."""

    title: str
    text: tuple[str, ...] = ()
    claims: tuple[Claim, ...] = ()
    tables: tuple[Table, ...] = ()
    figures: tuple[Figure, ...] = ()
    wide: bool = False  # its figures want the whole width

    @property
    def anchor(self) -> str:
        return "".join(c if c.isalnum() else "-" for c in self.title.lower()).strip("-")


@dataclass(frozen=True)
class Study:
    """A finished study."""

    name: str  # of its config
    title: str
    answer: tuple[str, ...]  # paragraphs; the first is the answer in short
    sections: tuple[Section, ...]
    rows: tuple[dict[str, Any], ...]  # of the CSV; empty: the numbers of the claims
    seconds: float = 0.0


def verdict(holds: bool, in_part: bool = False) -> str:
    """The word for an outcome: ``in_part`` matters where it does not hold."""
    return "holds" if holds else "in part" if in_part else "does not hold"


def write_study(folder: Path, study: Study) -> Path:
    """Write index.html, study.md, results.csv and figures/*.png into ``folder``; returns the page."""
    from PIL import Image

    shutil.rmtree(folder / "figures", ignore_errors=True)  # none of an earlier run may stay
    (folder / "figures").mkdir(parents=True)
    for figure in _figures(study):
        Image.fromarray(figure.image).save(folder / "figures" / f"{figure.key}.png", optimize=True)
    write_text(folder / "results.csv", csv_text(study))
    write_text(folder / "study.md", markdown(study))
    page = folder / "index.html"
    write_text(page, html(study))
    return page


def html(study: Study) -> str:
    """The page, with every image inside it and nothing to fetch."""
    uris = {figure.key: data_uri(figure.image, 88) for figure in _figures(study)}
    claims = [(claim, section) for section in study.sections for claim in section.claims]
    tally = {word: sum(claim.verdict == word for claim, _ in claims) for word in VERDICTS}
    return (
        templates()
        .get_template("study.html.j2")
        .render(study=study, uris=uris, claims=claims, marks=VERDICTS, tally={w: n for w, n in tally.items() if n})
    )


def markdown(study: Study) -> str:
    """The same, for reading as text and for the documentation; figures by their files."""
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
    """Every number with all its digits; an empty cell is not known."""
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
    return "" if isinstance(value, float) and not math.isfinite(value) else value


def _figures(study: Study) -> list[Figure]:
    found = [figure for section in study.sections for figure in section.figures]
    keys = [figure.key for figure in found]
    if len(set(keys)) < len(keys):
        raise ValueError(f"two figures of one name: {sorted(k for k in set(keys) if keys.count(k) > 1)}")
    return found


def _markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    def line(cells: Sequence[str]) -> str:
        return "| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in cells) + " |"

    return [line(head), line(["---"] * len(head)), *(line(row) for row in rows), ""]
