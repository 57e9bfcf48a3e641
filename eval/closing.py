"""The last lines of ``evaluate`` in plain words: what was found, and how sure the methods themselves were of it."""

from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from huesphere.eval.metrics import Row, compared
from huesphere.eval.table import degrees_text, share_text

NOTHING_FOUND = "found: no method gave normals that could be scored"
FAILURES_ONLY = "found: no method stands by its result; the normals that failed ones left are"
MAPS_SAY_NOTHING = "sure:  not known, since normal maps from elsewhere have no verdict"


def closing_lines(rows: Sequence[Row]) -> list[str]:
    """Return two lines on ``rows``: the best method's coverage and errors, then how sure the methods were.

    The best is the method that has a result on the most pictures, of these the one that is trusted on the most,
    of these the one whose largest median error is the least. Methods that are given more than the picture, and normal
    maps from elsewhere, of which no verdict is known, are left out, unless nothing else was scored. The errors of the
    other methods are those of all their normals, also of those that the method does not stand by.
    """
    of_method: dict[str, list[Row]] = defaultdict(list)
    for row in rows:
        if row.method and not row.knows and row.verdict:
            of_method[row.method].append(row)
    scored = {name: found for name, of_it in of_method.items() if (found := [row for row in of_it if compared(row)])}
    if not scored:
        return _without_judged_results(rows)
    best = min(scored, key=lambda name: _rank(scored[name]))
    others = [row.median_deg for name, of_it in of_method.items() if name != best for row in of_it]
    others = [median for median in others if np.isfinite(median)]
    text = _found(best, scored[best], others)
    judged = of_method[best]
    trusted = sum(row.verdict == "trust" for row in judged)
    pictures = "1 picture" if len(judged) == 1 else f"{len(judged)} pictures"
    sure = f"sure:  its own verdict is trust on {trusted} of {pictures}"
    stated = [row.stated_median_deg for row in scored[best] if np.isfinite(row.stated_median_deg)]
    return [text, f"{sure}; it expects to be {degrees_range(stated)} off" if stated else sure]


def _without_judged_results(rows: Sequence[Row]) -> list[str]:
    """The lines where no method with a verdict counts: on the best map from elsewhere, else on failed results."""
    scored: dict[str, list[Row]] = defaultdict(list)
    for row in rows:
        if row.method and not row.knows and not row.verdict and compared(row):
            scored[row.method].append(row)
    if not scored:
        failed = [row.median_deg for row in rows if row.method and np.isfinite(row.median_deg)]
        return [f"{FAILURES_ONLY} {degrees_range(failed)} off (median)" if failed else NOTHING_FOUND]
    best = min(scored, key=lambda name: _rank(scored[name]))
    others = [row.median_deg for name, of_it in scored.items() if name != best for row in of_it]
    return [_found(best, scored[best], others), MAPS_SAY_NOTHING]


def _found(best: str, rows: Sequence[Row], others: Sequence[float]) -> str:
    """The line on the ``rows`` of the best method, and on the median errors of the ``others``, degrees."""
    errors = degrees_range([row.median_deg for row in rows])
    share = share_text(min(row.coverage for row in rows))
    text = f"found: {best}: normals of {share}% of the object, {errors} off (median)"
    return f"{text}; others {degrees_range(others)}" if others else text


def degrees_range(values: Sequence[float]) -> str:
    """Return the least and the greatest of some degrees, or one text where both have the same.

    >>> degrees_range([0.62, 0.0985]), degrees_range([3.0])
    ('0.098° to 0.62°', '3.00°')
    """
    texts = list(dict.fromkeys(degrees_text(value) for value in (min(values), max(values))))
    return " to ".join(f"{text}°" for text in texts)


def _rank(rows: Sequence[Row]) -> tuple[int, int, float]:
    """Key to sort methods by: the best is the least."""
    return -len(rows), -sum(row.verdict == "trust" for row in rows), max(row.median_deg for row in rows)
