"""The last lines of `evaluate`: what was found, and how sure the methods were."""

from dataclasses import replace

from huesphere.eval.closing import MAPS_SAY_NOTHING, NOTHING_FOUND, closing_lines
from huesphere.eval.metrics import Row


def row(method: str, transport: str, median: float, verdict: str = "trust", **more) -> Row:
    status = "ok" if verdict == "trust" else "uncertain"
    return Row(
        "a", transport, method, status, 100, 90, 0.9, median_deg=median, stated_median_deg=1.5, verdict=verdict, **more
    )


def test_the_best_method_is_the_one_trusted_on_every_picture_not_the_one_best_on_one():
    rows = [row("auto", "direct", 0.1), row("auto", "full", 0.6)]
    rows += [row("weak", "direct", 0.05), row("weak", "full", 7.4, "doubtful")]
    found, sure = closing_lines(rows)
    assert found == "found: auto: normals of 90.0% of the object, 0.10° to 0.60° off (median); others 0.050° to 7.40°"
    assert sure == "sure:  its own verdict is trust on 2 of 2 pictures; it expects to be 1.50° off"


def test_failures_count_among_the_pictures_and_references_are_no_competition():
    failed = Row("a", "full", "auto", "flat-surface", 100, 0, 0.0, verdict="failed")
    given = row("woodham1980", "direct", 0.001, knows="its lights")
    found, sure = closing_lines([row("auto", "direct", 2.0), failed, given])
    assert found == "found: auto: normals of 90.0% of the object, 2.00° off (median)"
    assert "trust on 1 of 2 pictures" in sure


def test_the_others_count_with_all_their_normals_also_with_those_they_do_not_stand_by():
    unsure = Row("a", "direct", "weak", "no-convergence", 100, 90, 0.9, median_deg=40.0, verdict="doubtful")
    found, sure = closing_lines([row("auto", "direct", 1.0), row("old", "direct", 2.0), unsure])
    assert found.endswith("; others 2.00° to 40.0°")
    assert "trust on 1 of 1 picture;" in sure


def test_without_any_normals_that_is_said():
    assert closing_lines([]) == [NOTHING_FOUND]
    assert closing_lines([Row("a", "full", "auto", "flat-surface", verdict="failed")]) == [NOTHING_FOUND]


def test_normals_of_failed_results_alone_are_told_as_what_they_are():
    failed = [
        Row("a", "full", "auto", "rotation-undetermined", 100, 90, 0.9, median_deg=m, verdict="doubtful")
        for m in (2.0, 13.3)
    ]
    assert closing_lines(failed) == [
        "found: no method stands by its result; the normals that failed ones left are 2.00° to 13.3° off (median)"
    ]


def test_maps_of_others_that_are_scored_alone_are_told_without_a_verdict():
    maps = [replace(row(name, "full", median), verdict="", status="ok") for name, median in (("b", 9.0), ("a", 2.0))]
    failed = Row("a", "full", "auto", "flat-surface", verdict="failed")
    for others in ([], [failed]):
        found, sure = closing_lines([*maps, *others])
        assert found == "found: a: normals of 90.0% of the object, 2.00° off (median); others 9.00°"
        assert sure == MAPS_SAY_NOTHING
