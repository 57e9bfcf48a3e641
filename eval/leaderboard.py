"""The leaderboard: a page of the documentation, made of the rows that submissions left.

Methods are in order of their points, which count pixels without a normal as wrong, so that nobody rises by leaving out
what is hard. Methods whose intervals overlap that of the one before share its place.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.eval.submission import BEST_DEG, WORST_DEG, Row, read_row
from huesphere.eval.table import degrees_text, share_text


def read_rows(folder: Path) -> list[Row]:
    """The rows in the JSON files of ``folder``, the best first.

    Raises InputError if there is none, if two have the same name, or if they are of different benchmarks.
    """
    paths = sorted(folder.glob("*.json"))
    rows = [read_row(path) for path in paths]
    if not rows:
        raise InputError("no row of a leaderboard there", expected="JSON files of evaluate --submit", where=folder)
    for path, row in zip(paths, rows, strict=True):
        if (row.benchmark, row.sha256) != (rows[0].benchmark, rows[0].sha256):
            got = f"{row.benchmark} with sum {row.sha256[:8]}"
            expected = f"{rows[0].benchmark} with sum {rows[0].sha256[:8]}"
            raise InputError("rows of different benchmarks", got=got, expected=expected, where=path)
    names = [row.name for row in rows]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError("two rows of one name", got=twice, where=folder)
    return sorted(rows, key=lambda row: (-row.points, row.name))


def ranks(rows: Sequence[Row]) -> list[int]:
    """The place of each of the sorted ``rows``: a method shares that of the first one whose interval meets its own."""
    places: list[int] = []
    for number, row in enumerate(rows):
        leader = places[-1] - 1 if places else number
        places.append(places[-1] if places and row.high >= rows[leader].low else number + 1)
    return places


def leaderboard(rows: Sequence[Row]) -> str:
    """The page in Markdown: a table of all methods, and for each a matrix of points by shape and surface."""
    first = rows[0]
    part = f" Only {len(first.scenes)} scenes, a part of the edition: for trying out." if first.part else ""
    made = (
        f"{len(first.scenes)} scenes, sum `{first.sha256[:16]}`.{part} A method enters by its normal maps alone, see "
        "[evaluate](evaluate.md#the-benchmark). This page is made of the files in `leaderboard/` by "
        "`evaluate --leaderboard`."
    )
    points = (
        f"**Points** go from 0 to 100: over all pixels of the object, an error of {BEST_DEG:g}° or less is worth 1, of "
        f"{WORST_DEG:g}° or more 0, its logarithm counting linearly between; a pixel without a normal is worth 0. The "
        "mean over scenes, with its 95 % interval from resampled scenes. Methods whose intervals overlap that of the "
        "first share its place. Median and mean are of the pixels with a normal, in degrees: read them beside the "
        "coverage."
    )
    head = "| place | method | points | 95 % interval | median | mean | cover % | scenes without a map |"
    rule = "| ---: | --- | ---: | ---: | ---: | ---: | ---: | ---: |"
    lines = [f"# Leaderboard, benchmark {first.benchmark}", "", made, "", points, "", head, rule]
    for place, row in zip(ranks(rows), rows, strict=True):
        cells = (
            str(place),
            row.name.replace("|", "\\|"),
            f"{row.points:.1f}",
            f"{row.low:.1f} – {row.high:.1f}",
            degrees_text(row.median_deg),
            degrees_text(row.mean_deg),
            share_text(row.coverage),
            str(len(row.missing)),
        )
        lines.append(f"| {' | '.join(cells)} |")
    lines += ["", "## Points by shape and surface", ""]
    for row in rows:
        lines += [f"### {row.name}", "", *_matrix(row), ""]
    return "\n".join(lines)


def _matrix(row: Row) -> list[str]:
    """The lines of a table of points by shape (down) and surface (across), with the mean of each."""
    shapes = list(dict.fromkeys(scene.shape for scene in row.scenes))
    surfaces = list(dict.fromkeys(scene.surface for scene in row.scenes))
    lines = [f"| | {' | '.join(surfaces)} | all |", f"| --- |{' ---: |' * (len(surfaces) + 1)}"]
    for shape in shapes:
        own = row.matrix[shape]
        cells = [f"{own[surface]:.0f}" if surface in own else "–" for surface in surfaces]
        lines.append(f"| {shape} | {' | '.join(cells)} | {_mean(row, shape=shape):.0f} |")
    foot = [f"{_mean(row, surface=surface):.0f}" for surface in surfaces]
    return [*lines, f"| all | {' | '.join(foot)} | {row.points:.0f} |"]


def _mean(row: Row, *, shape: str | None = None, surface: str | None = None) -> float:
    own = [s.points for s in row.scenes if shape in (None, s.shape) and surface in (None, s.surface)]
    return float(np.mean(own))
