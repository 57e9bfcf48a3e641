"""Score a run and write its report: everything under <run>/report, made anew each time from what is on disk."""

import shutil
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

from configs.errors import InputError
from eval import export, figures, page, score
from eval.figures import Panel
from eval.page import CaseSection, ItemSection, Picture
from eval.score import Item, Score
from render.manifest import read_manifest

PARALLEL_FROM = 6  # items; for fewer, starting processes costs more than it saves
FULL_PAGE_CASES = 60  # a page of more results shows only BRIEF of each: it must stay fit to be sent around
BRIEF = ("picture", "truth_normals", "cumulative_methods", "normals", "error", "inliers", "histogram")
Result = tuple[ItemSection, list[Score]]


class Work(NamedTuple):
    """One item to be scored and drawn."""

    anchor: str  # of its section on the page
    item: Item
    methods: tuple[str, ...]
    brief: bool  # the page shows BRIEF only; figures/ has all


@dataclass(frozen=True)
class Report:
    """What was written, and where."""

    scores: tuple[Score, ...]
    page: Path


def write_report(
    run_dir: Path,
    methods: Sequence[str] = (),
    *,
    jobs: int = 1,
    progress: Callable[[int, int, str], None] = lambda done, total, what: None,
) -> Report:
    """Score every item of a run and write ``<run>/report``.

    Args:
        run_dir: a run folder; read-only but for its ``report``.
        methods: names to score; empty: each item's own, and whatever else has an estimate there.
        jobs: processes to spread the items over.
        progress: called with (items done, items in all, id of the one just done).

    Raises InputError where truth or estimates are damaged or do not belong together.
    """
    items = score.read_items(run_dir)
    versions = read_manifest(run_dir).get("versions", {})
    names = [score.methods_to_score(item, methods) for item in items]
    lines = {method: line for line, method in enumerate(dict.fromkeys(m for of_item in names for m in of_item))}
    if not lines:
        raise InputError("nothing to score: no method is asked for and there is no estimate", where=run_dir)
    folder = run_dir / "report"
    for stale in ("figures", "errors"):
        shutil.rmtree(folder / stale, ignore_errors=True)
    folder.mkdir(exist_ok=True)

    brief = sum(map(len, names)) > FULL_PAGE_CASES
    work = [
        Work(f"picture-{n}", item, of_item or tuple(lines), brief)
        for n, (item, of_item) in enumerate(zip(items, names, strict=True), start=1)
    ]
    sections, scores = [], []
    for section, of_item in _each(partial(_report_item, folder, lines), work, jobs):
        sections.append(section)
        scores += of_item
        progress(len(sections), len(items), section.item.id)

    export.write_tables(folder, scores, versions)
    across = _keep(folder / "figures", across_panels(scores, lines))
    rows = [each.row for each in scores]
    html = page.render_page(run_dir.resolve().name, rows, across, sections, versions)
    export.write_text(folder / "index.html", html)
    return Report(tuple(scores), folder / "index.html")


def across_panels(scores: Sequence[Score], lines: dict[str, int]) -> list[Panel]:
    """Return the curves that lay pictures side by side, none for a run of one picture.

    First one curve per method, over all pictures; then, per method, one curve per picture, or per transport where the
    pictures are too many to tell apart. ``lines``: method -> its line style throughout the report.
    """
    drawn = [s for s in scores if s.row.scored > 0]
    pictures = {(s.row.config, s.row.transport) for s in drawn}
    if len(pictures) < 2:
        return []
    by_method = _grouped(drawn, lambda s: s.row.method)
    pooled = {method: score.pooled(group) for method, group in by_method.items()}
    panels = _curves(pooled, [lines[m] for m in pooled], "methods", "all pictures")
    one_config = len({config for config, _ in pictures}) == 1
    few = len(pictures) <= len(figures.LINES)
    for method, group in by_method.items():
        name = (
            (lambda s: s.row.transport) if one_config or not few else (lambda s: f"{s.row.config} · {s.row.transport}")
        )
        curves = {label: score.pooled(members) for label, members in _grouped(group, name).items()}
        panels += _curves(curves, range(len(curves)), method, method)
    return panels


def _curves(curves: dict[str, Score], lines: Sequence[int], key: str, what: str) -> list[Panel]:
    return [
        figures.cumulative_plot(curves, lines, f"cumulative_{key}", what),
        figures.histogram_plot(curves, lines, f"histogram_{key}", what),
    ]


def _grouped(scores: Sequence[Score], name: Callable[[Score], str]) -> dict[str, list[Score]]:
    groups: dict[str, list[Score]] = {}
    for each in scores:
        groups.setdefault(name(each), []).append(each)
    return groups


def _report_item(folder: Path, lines: dict[str, int], work: Work) -> tuple[ItemSection, list[Score]]:
    """Score one item, write its figures and errors, and return its section of the page."""
    _, item, methods, brief = work
    if item.status != "done":
        scores = score.unscored(item, methods)
        return _section(work, (), scores, [()] * len(scores)), scores
    scene = score.read_scene(item)
    into = folder / "figures" / item.config / item.transport
    scores, pictures = [], []
    for method in methods:
        case = score.score_case(scene, method)
        if case.estimate is not None:
            export.write_error_exr(folder, item, case)
        scores.append(case.score)
        pictures.append(_keep(into / method, figures.case_panels(scene, case, lines[method]), brief))
    drawn = {s.row.method: s for s in scores if s.row.scored > 0}
    panels = figures.scene_panels(scene)
    if drawn:
        panels += _curves(drawn, [lines[m] for m in drawn], "methods", "all methods")
    return _section(work, _keep(into, panels, brief), scores, pictures), scores


def _section(
    work: Work, pictures: tuple[Picture, ...], scores: Sequence[Score], of_cases: Sequence[tuple[Picture, ...]]
) -> ItemSection:
    cases = (
        CaseSection(s.row, f"{work.anchor}-{k}", shown, page.case_summary(s.row))
        for k, (s, shown) in enumerate(zip(scores, of_cases, strict=True), start=1)
    )
    return ItemSection(work.item, work.anchor, pictures, tuple(cases))


def _keep(folder: Path, panels: Sequence[Panel], brief: bool = False) -> tuple[Picture, ...]:
    """Write panels as PNG under ``folder`` and return those that the page shows, made ready for it."""
    for panel in panels:
        export.write_figure(folder, panel)
    if brief:
        return tuple(page.picture(panel, quality=75) for panel in panels if panel.key in BRIEF)
    return tuple(page.picture(panel) for panel in panels)


def _each(function: Callable[[Work], Result], work: Sequence[Work], jobs: int) -> Iterator[Result]:
    """Yield ``function`` of every piece of work in order, by ``jobs`` processes where that pays."""
    if jobs < 2 or len(work) < PARALLEL_FROM:
        yield from map(function, work)
        return
    # Started afresh, not forked: whoever calls may have run threads of numba or BLAS, which do not survive a fork.
    with ProcessPoolExecutor(max_workers=jobs, mp_context=get_context("spawn")) as pool:
        yield from pool.map(function, work)
