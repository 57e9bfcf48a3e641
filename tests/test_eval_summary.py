"""Each method over all pictures, worked by hand; and the order of the terminal's tables."""

import io
from dataclasses import replace

import numpy as np
import pytest

from huesphere.eval.metrics import Row, error_columns
from huesphere.eval.score import Score, score_of
from huesphere.eval.summary import HEADINGS, best_of, summarise
from huesphere.eval.table import terminal_tables


def result(config: str, method: str, errors: list[float], *, declined: int = 0, status: str = "ok") -> Score:
    error = np.array(errors)
    pixels = error.size + declined
    columns = error_columns(error)
    row = Row(config, "full", method, status, pixels, error.size, error.size / pixels, **columns, seconds=2.0)
    row = replace(row, verdict="trust" if status == "ok" else "doubtful")
    return score_of(row, error.reshape(1, -1))


SCORES = [
    result("a", "robust", [1.0] * 80, declined=20),
    result("b", "robust", [3.0] * 100),
    result("a", "unbounce", [2.0] * 100),
    result("b", "unbounce", [90.0] * 100, status="n3-signs"),
    score_of(Row("a", "full", "absent", "missing", pixels=100), np.full((1, 1), np.nan)),
    score_of(Row("c", "full", "robust", "failed"), np.full((1, 1), np.nan)),  # never rendered: no picture to fail on
]


def test_a_summary_counts_every_picture_in_coverage_and_only_ok_results_in_errors():
    found = {summary.method: summary for summary in summarise(SCORES)}
    robust, unbounce, absent = found["robust"], found["unbounce"], found["absent"]
    assert (robust.ok, robust.pictures, robust.coverage) == (2, 2, pytest.approx(0.9))
    assert robust.mean_deg == pytest.approx((80 * 1 + 100 * 3) / 180)
    assert (robust.median_deg, robust.p90_deg, robust.worst_deg) == (3.0, 3.0, 3.0)
    assert (unbounce.ok, unbounce.pictures, unbounce.coverage) == (1, 2, 0.5)
    assert (unbounce.median_deg, unbounce.worst_deg) == (2.0, 2.0)
    assert (absent.ok, absent.coverage) == (0, 0.0)
    assert np.isnan(absent.median_deg)


def test_summaries_come_sorted_and_their_best_is_marked():
    summaries = summarise(SCORES)
    assert [s.method for s in summaries] == ["unbounce", "robust", "absent"]
    best = {(summaries[i].method, cell) for i, cell in best_of(summaries)}
    headings = {(method, HEADINGS[cell]) for method, cell in best}
    least = {("unbounce", heading) for heading in ("median", "mean", "p90", "worst")}
    assert headings == {("robust", "trust"), ("robust", "cover %"), *least}


def test_normal_maps_of_others_are_not_counted_as_trusted():
    map_of_others = result("a", "network", [4.0] * 100)
    found = summarise([SCORES[0], replace(map_of_others, row=replace(map_of_others.row, verdict=""))])
    assert {s.method: s.cells[HEADINGS.index("trust")] for s in found} == {"robust": "1/1", "network": "–"}


def test_transports_are_never_put_together():
    direct = replace(SCORES[0], row=replace(SCORES[0].row, transport="direct"))
    found = [(s.transport, s.method, s.median_deg) for s in summarise([SCORES[1], direct])]
    assert found == [("direct", "robust", 1.0), ("full", "robust", 3.0)]


def test_the_terminal_shows_what_errs_least_first_and_what_is_not_ok_last():
    from rich.console import Console

    rows = [s.row for s in SCORES if s.row.config == "b"] + [result("b", "direct", [0.1] * 9).row]
    console = Console(width=100, record=True, file=io.StringIO())
    for table in terminal_tables(rows):
        console.print(table)
    text = console.export_text()
    places = [text.index(f"  {name}") for name in ("direct", "robust", "unbounce")]
    assert places == sorted(places)
