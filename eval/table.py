"""The columns of the tables for people: selection, number formats, and best values; one list for all kinds of table."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from huesphere.configs.commandline import wrapped
from huesphere.configs.visible import visible
from huesphere.eval.metrics import Row, compared
from huesphere.eval.verdict import Verdict

if TYPE_CHECKING:
    from rich.console import RenderableType

MOST_NAMED = 6  # results that are named together in a line of verdicts
VERDICT_STYLES = {"trust": "green", "doubtful": "yellow", "failed": "red", "": ""}


def degrees_text(value: float) -> str:
    """Return degrees with about three digits; "–" for NaN."""
    if not np.isfinite(value):
        return "–"
    if value < 0.0005:
        return "<0.001"
    return f"{value:.3f}" if value < 0.0995 else f"{value:.2f}" if value < 9.995 else f"{value:.1f}"


def share_text(value: float) -> str:
    """Return a share from 0 to 1 in per cent, "100" only for exactly 1; "–" for NaN."""
    if not np.isfinite(value):
        return "–"
    percent = 100.0 * value
    return f"{min(percent, 99.9):.1f}" if value < 1.0 else "100"


def number_text(value: float) -> str:
    """Return a number with three digits; "–" for NaN, "∞" for infinity."""
    if np.isnan(value):
        return "–"
    if np.isinf(value):
        return "∞"
    if value >= 1e5:
        return f"{value:.0e}"
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"


def seconds_text(value: float) -> str:
    """Return seconds with about three digits; "–" for NaN."""
    if not np.isfinite(value):
        return "–"
    return f"{value:.2f}" if value < 9.995 else f"{value:.1f}" if value < 99.95 else f"{value:.0f}"


@dataclass(frozen=True)
class Column:
    """One column of the tables for people; metrics.csv has more."""

    key: str  # a field of Row
    heading: str
    text: Callable[[float], str]  # format of its numbers
    better: int  # −1: the least value is best, +1: the greatest is, 0: none is marked as best
    meaning: str

    def cell(self, row: Row) -> str:
        """The text of this column's cell in a row."""
        return self.text(float(getattr(row, self.key)))


COLUMNS = (
    Column("median_deg", "median", degrees_text, -1, "median angular error over the pixels with a normal, degrees"),
    Column("mean_deg", "mean", degrees_text, -1, "mean angular error over those pixels, degrees"),
    Column("coverage", "cover %", share_text, +1, "share of the object's pixels that the method gives a normal for"),
    Column("p90_deg", "p90", degrees_text, -1, "90th percentile of the angular error, degrees"),
    Column("within_5", "<5° %", share_text, +1, "share of those pixels whose error is below 5 degrees"),
    Column(
        "stated_median_deg", "stated", degrees_text, 0, "median of the error that the method itself states, degrees"
    ),
    Column("accepted_median_deg", "inlier", degrees_text, 0, "median error over the pixels accepted as inliers"),
    Column(
        "median_deg_flip", "flip", degrees_text, -1, "median error of the better of the result and its twin (−x, −y)"
    ),
    Column(
        "median_deg_gauge", "gauge", degrees_text, -1, "median error after the best orthogonal alignment to the truth"
    ),
    Column("seconds", "s", seconds_text, 0, "seconds that the method took"),
)
# Columns of the terminal's tables, which are no wider than 80 characters, and what they mean in a line below
TERMINAL_COLUMNS = tuple(c for c in COLUMNS if c.heading in ("median", "mean", "cover %", "p90", "gauge", "s"))
LEGEND = (
    "verdict: the method's own; median, mean, p90: error in degrees over the pixels with a normal; "
    "cover %: their share of the object; gauge: median after the best alignment; s: seconds; "
    "floor: median of the best 3×3 matrix; cond F: how many times noise is magnified"
)
# Columns that depend on the picture only and are the same for every method
PICTURE_COLUMNS = (
    Column(
        "oracle_linear_median_deg", "floor", degrees_text, 0, "median error of the best 3×3 matrix fitted to the truth"
    ),
    Column("cond_F", "cond F", number_text, 0, "how many times the picture's relative noise is magnified"),
)


def best_cells(rows: Sequence[Row]) -> set[tuple[int, str]]:
    """Return (index of row, key of column) of the best values of each picture.

    Only results with status ok, or doubted by the verdict alone, compete. Reference methods, which are given more than
    the picture, are left out.

    Values with the same text are equally good. A picture with fewer than two values has no best.
    """
    groups: dict[tuple[str, str], list[int]] = defaultdict(list)
    for index, row in enumerate(rows):
        if compared(row) and not row.knows:
            groups[row.config, row.transport].append(index)
    best = set()
    for column in (c for c in COLUMNS if c.better):
        for members in groups.values():
            values = {i: column.better * getattr(rows[i], column.key) for i in members}
            values = {i: v for i, v in values.items() if np.isfinite(v)}
            if len(values) >= 2:
                text = column.cell(rows[max(values, key=values.__getitem__)])
                best |= {(i, column.key) for i in values if column.cell(rows[i]) == text}
    return best


@dataclass(frozen=True)
class Doubted:
    """Results with the same status, reasons and advice, which are told together."""

    where: tuple[str, ...]  # "<config>/<transport> <method>" of each
    status: str
    verdict: Verdict

    @property
    def word(self) -> str:
        """The verdict, with the status in brackets where that says more."""
        return self.verdict.word if self.status == self.verdict.word else f"{self.verdict.word} ({self.status})"


def doubted_results(rows: Sequence[Row], verdicts: Sequence[Verdict]) -> list[Doubted]:
    """Return the results that are not to be trusted, those together of which the same is said; failures come first.

    Normal maps of other programs have no verdict and are not in the list.
    """
    groups: dict[tuple[str, Verdict], list[str]] = defaultdict(list)
    for row, verdict in zip(rows, verdicts, strict=True):
        if verdict.word not in ("", "trust"):
            groups[row.status, verdict].append(f"{row.config}/{row.transport} {row.method}".rstrip())
    found = [Doubted(tuple(where), status, verdict) for (status, verdict), where in groups.items()]
    return sorted(found, key=lambda one: one.verdict.word != "failed")


def markdown_table(rows: Sequence[Row]) -> str:
    """Return a GitHub-flavoured Markdown table with the best values in bold."""
    best, every = best_cells(rows), (*COLUMNS, *PICTURE_COLUMNS)
    head = ["config", "transport", "method", "status", *(c.heading for c in every)]
    lines = [head, ["---"] * 4 + ["---:"] * len(every)]
    for i, row in enumerate(rows):
        cells = [f"**{c.cell(row)}**" if (i, c.key) in best else c.cell(row) for c in every]
        lines.append([_markdown(t) for t in (row.config, row.transport, row.label, row.status)] + cells)
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def latex_table(rows: Sequence[Row]) -> str:
    """Return a LaTeX tabular in the style of booktabs, best values in bold; needs \\usepackage{booktabs}."""
    best, every = best_cells(rows), (*COLUMNS, *PICTURE_COLUMNS)
    head = ["config", "transport", "method", *(c.heading for c in every)]
    lines = [f"\\begin{{tabular}}{{lll{'r' * len(every)}}}", "\\toprule", _latex_line(map(_latex, head)), "\\midrule"]
    for i, row in enumerate(rows):
        if i and (row.config, row.transport) != (rows[i - 1].config, rows[i - 1].transport):
            lines.append("\\addlinespace")
        method = row.label if row.status == "ok" else f"{row.label} ({row.status})"
        texts = [(c.key, _latex(c.cell(row))) for c in every]
        cells = [f"\\textbf{{{text}}}" if (i, key) in best else text for key, text in texts]
        lines.append(_latex_line([_latex(row.config), _latex(row.transport), _latex(method), *cells]))
    return "\n".join([*lines, "\\bottomrule", "\\end{tabular}", ""])


def terminal_tables(rows: Sequence[Row]) -> "list[RenderableType]":
    """Return a table for the terminal per config, 80 columns wide, with the best values in bold.

    Methods are in order of their median error.
    """
    best = best_cells(rows)
    tables: list[RenderableType] = []
    for config in dict.fromkeys(row.config for row in rows):
        of_config = [(i, row) for i, row in enumerate(rows) if row.config == config]
        pictures = list(dict.fromkeys(row.transport for _, row in of_config))
        of_config.sort(key=lambda pair: (pictures.index(pair[1].transport), *_order(pair[1])))
        tables.append(_terminal_table(config, of_config, best))
    return tables


def verdict_lines(doubted: Sequence[Doubted]) -> list[str]:
    """Return lines, of TERMINAL_WIDTH characters at most, on untrusted results: which they are, why, what to do."""
    lines: list[str] = []
    for one in doubted:
        more = len(one.where) - MOST_NAMED
        named = ", ".join(one.where[:MOST_NAMED]) + f" and {more} more" * (more > 0)
        lines += wrapped(f"{one.verdict.sign} {one.word}: {named}", indent=4)
        lines += [line for why in one.verdict.why for line in wrapped(f"    why: {why}", indent=9)]
        lines += [line for todo in one.verdict.todo for line in wrapped(f"    do:  {todo}", indent=9)]
    pages = dict.fromkeys(one.verdict.page for one in doubted if one.verdict.page)
    return lines + ([f"    see {', '.join(pages)}"] if pages else [])


def _order(row: Row) -> tuple[bool, float]:
    """Key to sort rows by: results that are ok first, then by median error; without an error last."""
    return row.status != "ok", row.median_deg if np.isfinite(row.median_deg) else np.inf


def _terminal_table(config: str, rows: list[tuple[int, Row]], best: set[tuple[int, str]]) -> "RenderableType":
    from rich.box import SIMPLE_HEAD
    from rich.table import Table
    from rich.text import Text

    table = Table(
        title=Text(visible(config), style="bold"), title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0)
    )
    table.add_column("degrees", overflow="fold", min_width=18)
    table.add_column("verdict", no_wrap=True)
    for column in TERMINAL_COLUMNS:
        table.add_column(column.heading, justify="right", no_wrap=True)
    transport = None
    for i, row in rows:
        if row.transport != transport:
            transport = row.transport
            floor, condition = PICTURE_COLUMNS
            facts = Text(visible(transport), style="bold")
            table.add_row(facts.append(f", {condition.heading} {condition.cell(row)}", style="not bold dim"))
            table.add_row(Text(f"  {floor.heading}", style="dim"), "", Text(floor.cell(row), style="dim"))
        name = Text(f"  {visible(row.label)}" if row.method else "")
        word = row.verdict or ("" if row.status == "ok" else row.status)
        cells = (Text(c.cell(row), style="bold" if (i, c.key) in best else "") for c in TERMINAL_COLUMNS)
        table.add_row(name, Text(visible(word), style=VERDICT_STYLES.get(word, "yellow")), *cells)
    return table


def _markdown(text: str) -> str:
    return visible(text).replace("\\", "\\\\").replace("|", "\\|").replace("\n", " ").replace("<", "&lt;")


def _latex(text: str) -> str:
    special = {c: f"\\{c}" for c in "&%$#_{}"}
    special |= {"\\": "\\textbackslash{}", "~": "\\textasciitilde{}", "^": "\\textasciicircum{}"}
    special |= {"<": "$<$", ">": "$>$", "°": "$^\\circ$", "∞": "$\\infty$", "–": "--"}
    return "".join(special.get(c, c) for c in visible(text))


def _latex_line(cells: Iterable[str]) -> str:
    return " & ".join(cells) + r" \\"
