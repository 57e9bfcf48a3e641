"""Summary of each method over all pictures of one level of transport: number of results, coverage, and errors."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from huesphere.configs.visible import visible
from huesphere.eval.metrics import NAN, compared
from huesphere.eval.references import REFERENCES
from huesphere.eval.score import QUANTILES, Score, in_order, pooled
from huesphere.eval.table import degrees_text, seconds_text, share_text

if TYPE_CHECKING:
    from rich.console import RenderableType


@dataclass(frozen=True)
class Summary:
    """One method and transport. Errors in degrees over results as ``metrics.compared``; pictures weigh the same."""

    method: str
    transport: str
    pictures: int  # number of rendered pictures
    ok: float  # number of results with status ok, which are those with verdict trust; NaN: maps without a verdict
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
        degrees = [degrees_text(v) for v in (self.median_deg, self.mean_deg, self.p90_deg, self.worst_deg)]
        trusted = "–" if np.isnan(self.ok) else f"{self.ok:.0f}/{self.pictures}"
        cover = share_text(self.coverage)
        return (*degrees[:2], cover, *degrees[2:], trusted, seconds_text(self.seconds))


HEADINGS = ("median", "mean", "cover %", "p90", "worst", "trust", "s")
FIELDS = ("median_deg", "mean_deg", "coverage", "p90_deg", "worst_deg", "ok", "seconds")
LEGEND = (
    "median, mean, p90: error in degrees over results that are ok or doubted by the verdict alone; cover %: share of "
    "all objects with a normal; worst: largest median of a picture; trust: results with that verdict; s: mean seconds"
)
BETTER = (-1, -1, +1, -1, -1, +1, 0)  # +1: the greatest value is best, −1: the least is, 0: none is marked as best


def summarise(scores: Sequence[Score]) -> list[Summary]:
    """Return one summary per method and transport: transports as they come, methods in order of their median error.

    Methods without any result come last. Errors of different transports are never put together: what a method loses to
    shadows and interreflection is what the transports are there to show.
    """
    rendered = [s for s in scores if s.row.method and s.row.pixels > 0]
    transports = in_order(s.row.transport for s in rendered)
    keys = dict.fromkeys((s.row.method, s.row.transport) for s in rendered)
    found = [_summary(*key, [s for s in rendered if (s.row.method, s.row.transport) == key]) for key in keys]
    return sorted(found, key=lambda s: (transports.index(s.transport), _last_if_unknown(s.median_deg)))


def _last_if_unknown(value: float) -> float:
    return np.inf if np.isnan(value) else value


def best_of(summaries: Sequence[Summary]) -> set[tuple[int, int]]:
    """Return (index of summary, index of cell) of the best of two or more values of one transport.

    Equal texts are equally good.
    """
    best = set()
    for transport in dict.fromkeys(s.transport for s in summaries):
        for cell, (field, better) in enumerate(zip(FIELDS, BETTER, strict=True)):
            values = {i: better * getattr(s, field) for i, s in enumerate(summaries) if s.transport == transport}
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

    title = Text("all pictures together, by transport", style="bold")
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("method", overflow="fold", min_width=18)
    for heading in HEADINGS:
        table.add_column(heading, justify="right", no_wrap=True)
    best = best_of(summaries)
    transport = None
    for i, summary in enumerate(summaries):
        if summary.transport != transport:
            transport = summary.transport
            table.add_row(Text(visible(transport), style="bold"))
        cells = (Text(text, style="bold" if (i, k) in best else "") for k, text in enumerate(summary.cells))
        table.add_row(Text(f"  {visible(summary.label)}"), *cells)
    return table


def _summary(method: str, transport: str, scores: Sequence[Score]) -> Summary:
    good = [s for s in scores if compared(s.row)]
    of_others = bool(good) and not any(s.row.verdict for s in good)  # normal maps, which say nothing of themselves
    ok = NAN if of_others else sum(s.row.status == "ok" for s in good)
    coverage = sum(s.row.coverage for s in good) / len(scores)
    timed = [s.row.seconds for s in scores if np.isfinite(s.row.seconds)]
    seconds = float(np.mean(timed)) if timed else NAN
    if not good:
        return Summary(method, transport, len(scores), 0, coverage, NAN, NAN, NAN, NAN, seconds)
    median, p90 = np.interp([0.5, 0.9], QUANTILES, pooled(good).quantiles_deg)
    # Weighted as the quantiles are: each picture by the method's coverage of it.
    mean = np.average([s.row.mean_deg for s in good], weights=[s.row.coverage for s in good])
    worst = max(s.row.median_deg for s in good)
    return Summary(method, transport, len(scores), ok, coverage, float(mean), float(median), float(p90), worst, seconds)
