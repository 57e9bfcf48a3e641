"""Summary of each method over all pictures of a run: number of results, coverage, and errors."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from huesphere.configs.visible import visible
from huesphere.eval.metrics import NAN, compared
from huesphere.eval.references import REFERENCES
from huesphere.eval.score import QUANTILES, Score, pooled
from huesphere.eval.table import degrees_text, seconds_text, share_text

if TYPE_CHECKING:
    from rich.console import RenderableType


@dataclass(frozen=True)
class Summary:
    """One method. Errors are in degrees, over the results that are ok or doubtful; each picture has the same weight."""

    method: str
    pictures: int  # number of rendered pictures
    ok: int  # number of results with status ok
    coverage: float  # mean over all rendered pictures; 0 for a failed result
    mean_deg: float
    median_deg: float
    p90_deg: float
    worst_deg: float  # the largest median of a picture
    seconds: float  # mean time of the method

    @property
    def knows(self) -> str:
        """What a reference method is given beyond one picture; "" for all others."""
        return REFERENCES.get(self.method, "")

    @property
    def label(self) -> str:
        """The method's name with what it knows."""
        return f"{self.method} [{self.knows}]" if self.knows else self.method

    @property
    def cells(self) -> tuple[str, ...]:
        """The texts of a table's cells under HEADINGS."""
        degrees = (degrees_text(v) for v in (self.mean_deg, self.median_deg, self.p90_deg, self.worst_deg))
        return (f"{self.ok}/{self.pictures}", share_text(self.coverage), *degrees, seconds_text(self.seconds))


HEADINGS = ("ok", "cover %", "mean", "median", "p90", "worst", "s")
FIELDS = ("ok", "coverage", "mean_deg", "median_deg", "p90_deg", "worst_deg", "seconds")
BETTER = (+1, +1, -1, -1, -1, -1, 0)  # +1: the greatest value is best, −1: the least is, 0: none is marked as best


def summarise(scores: Sequence[Score]) -> list[Summary]:
    """Return one summary per method, in order of the median error; methods without any result come last."""
    rendered = [s for s in scores if s.row.method and s.row.pixels > 0]
    methods = dict.fromkeys(s.row.method for s in rendered)
    found = [_summary(method, [s for s in rendered if s.row.method == method]) for method in methods]
    return sorted(found, key=lambda s: np.inf if np.isnan(s.median_deg) else s.median_deg)


def best_of(summaries: Sequence[Summary]) -> set[tuple[int, int]]:
    """Return (index of summary, index of cell) of the best of two or more values; equal texts are equally good."""
    best = set()
    for cell, (field, better) in enumerate(zip(FIELDS, BETTER, strict=True)):
        values = {i: better * getattr(s, field) for i, s in enumerate(summaries)}
        values = {i: v for i, v in values.items() if better and np.isfinite(v) and not summaries[i].knows}
        if len(values) >= 2:
            text = summaries[max(values, key=values.__getitem__)].cells[cell]
            best |= {(i, cell) for i in values if summaries[i].cells[cell] == text}
    return best


def summary_table(summaries: Sequence[Summary]) -> "RenderableType":
    """Return a table for the terminal, with the best values in bold."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table
    from rich.text import Text

    title = Text("all pictures, errors of the results that are ok or doubtful", style="bold")
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("method", overflow="fold", min_width=18)
    for heading in HEADINGS:
        table.add_column(heading, justify="right", no_wrap=True)
    best = best_of(summaries)
    for i, summary in enumerate(summaries):
        cells = (Text(text, style="bold" if (i, k) in best else "") for k, text in enumerate(summary.cells))
        table.add_row(Text(visible(summary.label)), *cells)
    return table


def _summary(method: str, scores: Sequence[Score]) -> Summary:
    good = [s for s in scores if compared(s.row)]
    ok = sum(s.row.status == "ok" for s in good)
    coverage = sum(s.row.coverage for s in good) / len(scores)
    timed = [s.row.seconds for s in scores if np.isfinite(s.row.seconds)]
    seconds = float(np.mean(timed)) if timed else NAN
    if not good:
        return Summary(method, len(scores), 0, coverage, NAN, NAN, NAN, NAN, seconds)
    median, p90 = np.interp([0.5, 0.9], QUANTILES, pooled(good).quantiles_deg)
    # Weighted as the quantiles are: each picture by the method's coverage of it.
    mean = np.average([s.row.mean_deg for s in good], weights=[s.row.coverage for s in good])
    worst = max(s.row.median_deg for s in good)
    return Summary(method, len(scores), ok, coverage, float(mean), float(median), float(p90), worst, seconds)
