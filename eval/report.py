"""Scores a run and writes its report, all files under <run>/report, from the pictures and estimates on disk."""

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from huesphere.configs.errors import InputError, Unfinished
from huesphere.configs.own_folder import made_folder, remove_abandoned, remove_tree, write_text
from huesphere.eval import compare, export, figures, maps, page, score, viewer
from huesphere.eval.calibration_figures import calibration_panels
from huesphere.eval.factor_figures import comparison_panel, factor_panels
from huesphere.eval.factors import read_factors
from huesphere.eval.figures import Panel
from huesphere.eval.frames import Frame
from huesphere.eval.page import CaseSection, ItemSection, Picture
from huesphere.eval.picture_facts import picture_facts, what_was_tried
from huesphere.eval.score import Item, Score
from huesphere.eval.summary import summarise
from huesphere.render.jobs import Function, Log, Lost, Progress, each
from huesphere.render.manifest import read_manifest
from huesphere.render.results import results_root

PARALLEL_FROM = 6  # least number of items for which processes are started; for fewer that takes longer than it saves
ALL_FIGURES_UP_TO = 60  # most results for which all figures are drawn; those of 500 results would take 195 MB
FIRST_AND_WORST = 3  # with more results: number of first, and of worst, pictures whose figures are drawn
PARTS = ".parts"  # folder for data of the pages, which would not fit in memory for thousands of pictures
PAGE_BYTES = 80e6  # largest size of the page; if it would be larger, there is a page for each picture


class Work(NamedTuple):
    """One item to be scored."""

    anchor: str  # id of its section on the page
    item: Item
    methods: tuple[str, ...]


class Scored(NamedTuple):
    """The result of scoring one item."""

    section: ItemSection  # its section of the page
    scores: list[Score]  # one for each method
    pairs: list[compare.Pair]


@dataclass(frozen=True)
class Report:
    """The scores of a run, and the path of its report."""

    scores: tuple[Score, ...]
    page: Path  # index.html

    def __repr__(self) -> str:
        return f"Report({len(self.scores)} results, {self.page})"


# More than seven parameters: they are the options of the command, each on its own.
def write_report(
    run_dir: Path,
    methods: Sequence[str] = (),
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    all_figures: bool = False,
    vector: bool = False,
    estimates: Mapping[str, Mapping[str, Path]] | None = None,
    frames: Mapping[str, Frame] | None = None,
    notes: Sequence[str] = (),
    out: Path | None = None,
    progress: Callable[[int, int, str], None] = lambda done, total, what: None,
) -> Report:
    """Score every item of a run and write ``<run>/report``, or ``<out>/report``.

    Args:
        run_dir: a run folder; only its folder ``report`` is written to, and nothing if ``out`` is given.
        methods: names of the methods to score, beside ``estimates``; if empty, those of each item's config and all with
            an estimate.
        jobs: number of processes; ``scheduler``: address of a Dask cluster instead, for which paths must be absolute.
        all_figures: draw the figures of every picture, however many there are.
        vector: write every figure as SVG and PDF too, not only those over all pictures.
        estimates: paths of external normal maps, by item id and name of method (``find_external_maps``).
        frames: frames of these maps, by name of method; of others ours.
        notes: remarks for the reader, shown on the page.
        out: folder for the report, outside the run, which may have further estimates (``render.results``).
        progress: called with (items done, items in all, id of the item just done).

    Raises InputError if truth or estimates are damaged or do not belong together, and Unfinished if a worker process
    dies while it works on an item.
    """
    items = [
        replace(item, external=(estimates or {}).get(item.id, {}), frames=frames or {})
        for item in score.read_items(run_dir, out)
    ]
    names = [score.methods_to_score(item, methods) for item in items]
    # Each method's line style in the plots: an index in ``figures.LINES``.
    lines = {method: line for line, method in enumerate(dict.fromkeys(m for of_item in names for m in of_item))}
    if not lines:
        raise InputError("nothing to score: no method is asked for and there is no estimate", where=run_dir)
    work = [
        Work(f"picture-{n}", item, of_item or tuple(lines))
        for n, (item, of_item) in enumerate(zip(items, names, strict=True), start=1)
    ]
    folder = _emptied(results_root(run_dir, out) / "report")
    spread = partial(_spread, jobs=jobs, scheduler=scheduler)
    try:
        found: dict[int, Scored] = {}
        for n, scored in spread(partial(_score_item, folder=folder), work):
            found[n] = scored
            progress(len(found), len(work), work[n].item.id)
        of_items = [found[n] for n in range(len(work))]
        drawn, more_notes = _to_be_drawn([scored.scores for scored in of_items], all_figures)
        to_draw = [of_items[n].section for n in drawn]
        for k, section in spread(partial(_draw_item, folder=folder, lines=lines, vector=vector), to_draw):
            of_items[drawn[k]] = of_items[drawn[k]]._replace(section=section)
        return _write(run_dir, folder, of_items, lines, [*notes, *more_notes])
    finally:
        shutil.rmtree(folder / PARTS, ignore_errors=True)


def _emptied(folder: Path) -> Path:
    """The folder of the report, emptied of the files of an earlier report, with an empty folder PARTS.

    Raises InputError if it is a link, which would lead out of the run folder.
    """
    made_folder(folder.parent, folder.name)
    for stale in ("figures", "errors", "pictures", PARTS, page.PLOTTING_LIBRARY):
        remove_tree(folder / stale)
    remove_abandoned(folder)
    (folder / PARTS).mkdir()
    return folder


def _spread(
    function: Function, tasks: Sequence[Work | ItemSection], *, jobs: int, scheduler: str | None
) -> Iterator[tuple[int, Any]]:
    """Yield (number of the task, result) as tasks finish, computed by ``jobs`` processes or by a cluster.

    Raises Unfinished if a worker dies.
    """
    jobs = jobs if len(tasks) >= PARALLEL_FROM else 1
    silent: dict[str, Callable[..., None]] = {"progress": lambda share, what: None, "log": lambda line: None}
    with closing(each(function, tasks, jobs=jobs, scheduler=scheduler, **silent)) as results:
        for n, result in results:
            if isinstance(result, Lost):
                raise Unfinished(f"{tasks[n].item.id}: {result.why}")
            yield n, result


def _write(
    run_dir: Path, folder: Path, of_items: Sequence[Scored], lines: dict[str, int], notes: Sequence[str]
) -> Report:
    """Write the tables, the figures over all items, and the pages.

    ``of_items``: the results of the items, in the order of the run. ``lines``: for each method, the number of its line
    style (an index in ``figures.LINES``), so that a method has one colour and one kind of dashes in all plots.
    ``notes``: remarks for the reader, shown on the page.
    """
    versions = read_manifest(run_dir).get("versions", {})
    scores = [one for scored in of_items for one in scored.scores]
    sections = [scored.section for scored in of_items]
    rows = [one.row for one in scores]
    comparisons = compare.compare([pair for scored in of_items for pair in scored.pairs])
    summaries = summarise(scores)
    export.write_tables(folder, scores, comparisons, versions)
    panels = across_panels(scores, lines) + factor_panels(rows, read_factors([s.item for s in sections]), lines)
    for transport in score.in_order(comparison.transport for comparison in comparisons):
        own = [comparison for comparison in comparisons if comparison.transport == transport]
        if any(np.isfinite(comparison.low) for comparison in own):
            # Sorted by error; of too many pairs only those with the best method are drawn.
            best = next(summary.method for summary in summaries if summary.transport == transport)
            panels.append(comparison_panel(own, best, f"paired_{transport}", f", {transport}"))
    across = _keep(folder / "figures", panels, vector=True)
    name = run_dir.resolve().name
    for path, html in page.render_pages(
        name, rows, summaries, across, sections, versions, notes=notes, limit=PAGE_BYTES
    ):
        (folder / path).parent.mkdir(exist_ok=True)
        write_text(folder / path, html)
    return Report(tuple(scores), folder / "index.html")


def _to_be_drawn(of_items: Sequence[Sequence[Score]], everything: bool) -> tuple[list[int], list[str]]:
    """Return the indices of the items whose figures are drawn, and notes for the reader if these are not all.

    If there are many, these are the first items and those with the largest error of the best method.
    """
    if everything or sum(map(len, of_items)) <= ALL_FIGURES_UP_TO:
        return list(range(len(of_items))), []
    least = [min((s.row.median_deg for s in scores if s.row.scored > 0), default=np.inf) for scores in of_items]
    worst = sorted(range(len(of_items)), key=lambda n: -least[n])[:FIRST_AND_WORST]
    chosen = sorted({*range(min(FIRST_AND_WORST, len(of_items))), *worst})
    note = (
        f"Figures are drawn for {len(chosen)} of {len(of_items)} pictures: the first {FIRST_AND_WORST}, and the "
        f"{FIRST_AND_WORST} with the largest error of the best method. The option --all-figures draws them all."
    )
    return chosen, [note]


def across_panels(scores: Sequence[Score], lines: dict[str, int]) -> list[Panel]:
    """Return plots that compare methods and pictures; none for a run of one picture.

    For each transport of several pictures there are three with a curve for each method: errors, their histogram, and
    true against stated error. Then come two for each method with a curve for each picture, or for each transport if
    there are too many pictures. Transports are never pooled. ``lines``: index in LINES of each method's style.
    """
    drawn = [s for s in scores if s.row.scored > 0]
    pictures = {(s.row.config, s.row.transport) for s in drawn}
    if len(pictures) < 2:
        return []
    by_method = _grouped(drawn, lambda s: s.row.method)
    panels: list[Panel] = []
    by_transport = _grouped(drawn, lambda s: s.row.transport)
    for transport in score.in_order(by_transport):
        of_transport = by_transport[transport]
        if len({s.row.config for s in of_transport}) > 1:
            groups = _grouped(of_transport, lambda s: s.row.method)
            pooled = {method: score.pooled(group) for method, group in groups.items()}
            styles = [lines[m] for m in pooled]
            panels += _curves(pooled, styles, f"methods_{transport}", f"all pictures, {transport}")
            panels += calibration_panels(pooled, styles, f"calibration_{transport}", f", all pictures, {transport}")
    one_config = len({config for config, _ in pictures}) == 1
    few = len(pictures) <= len(figures.LINES)
    for method, group in by_method.items():
        name = (
            (lambda s: s.row.transport) if one_config or not few else (lambda s: f"{s.row.config} · {s.row.transport}")
        )
        curves = {label: score.pooled(members) for label, members in _grouped(group, name).items()}
        if len(curves) > 1:
            panels += _curves(curves, range(len(curves)), method, method)
    return panels


def _curves(curves: dict[str, Score], lines: Sequence[int], key: str, what: str) -> list[Panel]:
    """The cumulative plot and the histogram of the same curves."""
    return [
        figures.cumulative_plot(curves, lines, f"cumulative_{key}", what),
        figures.histogram_plot(curves, lines, f"histogram_{key}", what),
    ]


def _grouped(scores: Sequence[Score], name: Callable[[Score], str]) -> dict[str, list[Score]]:
    """The scores by the ``name`` of each."""
    groups: dict[str, list[Score]] = {}
    for one in scores:
        groups.setdefault(name(one), []).append(one)
    return groups


def _score_item(work: Work, progress: Progress, log: Log, *, folder: Path) -> Scored:
    """Score one item and write its error images and the inspector's data; its section has no figures yet."""
    anchor, item, methods = work
    anchors = [f"{anchor}-{k}" for k in range(1, len(methods) + 1)]
    if item.status != "done":
        scores = score.unscored(item, methods)
        shown = (
            CaseSection(s.row, a, page.case_summary(s.row), (), verdict=s.verdict)
            for s, a in zip(scores, anchors, strict=True)
        )
        return Scored(ItemSection(item, anchor, tuple(shown)), scores, [])
    scene = score.read_scene(item)
    cases = [score.score_case(scene, method) for method in methods]
    sections, step = [], maps.thinning(scene.mask.shape, page.THUMBNAIL_PIXELS)
    for case, a in zip(cases, anchors, strict=True):
        if case.estimate is not None:
            export.write_error_exr(folder, item, case)
        small = tuple(page.thumbnail(panel.image, panel.title) for panel in figures.core_panels(scene, case, step))
        sections.append(_case_section(scene, case, a, small))
    small = (
        page.thumbnail(figures.picture(scene), "Picture"),
        page.thumbnail(
            maps.normal_map(scene.truth.normals[::step, ::step], scene.mask[::step, ::step]), "True normals"
        ),
    )
    data = folder / PARTS / f"{anchor}.json"
    data.write_text(viewer.viewer_json(scene, cases, anchors), encoding="utf-8")
    section = ItemSection(item, anchor, tuple(sections), small, data)
    return Scored(section, [case.score for case in cases], compare.pairs(item.config, item.transport, cases))


def _case_section(scene: score.Scene, case: score.Case, anchor: str, small: tuple[page.Thumbnail, ...]) -> CaseSection:
    """The section of a result, which says more of what is not to be trusted; without figures yet."""
    found, estimate = case.score, case.estimate
    doubted = found.verdict.word in ("doubtful", "failed")
    return CaseSection(
        found.row,
        anchor,
        page.case_summary(found.row),
        small,
        verdict=found.verdict,
        regions=found.regions,
        tried=what_was_tried(found.row.method, estimate.steps) if doubted and estimate is not None else (),
        facts=picture_facts(scene) if doubted else (),
    )


def _draw_item(
    section: ItemSection, progress: Progress, log: Log, *, folder: Path, lines: dict[str, int], vector: bool
) -> ItemSection:
    """Draw the figures of one item, write them, and return its section with them."""
    item = section.item
    if item.status != "done":
        return section
    scene = score.read_scene(item)
    into = folder / "figures" / item.config / item.transport
    cases, drawn = [], {}
    for of_case in section.cases:
        method = of_case.row.method
        case = score.score_case(scene, method)
        drawings = figures.case_panels(scene, case, lines[method])
        if case.estimate is not None:
            drawings += calibration_panels({method: case.score}, [lines[method]], "calibration", "")
        cases.append(replace(of_case, pictures=_keep(into / method, drawings, vector=vector)))
        if case.score.row.scored > 0:
            drawn[method] = case.score
    panels = figures.scene_panels(scene)
    if drawn:
        styles = [lines[m] for m in drawn]
        panels += _curves(drawn, styles, "methods", "all methods")
        panels += calibration_panels(drawn, styles, "calibration_methods", ", all methods")
    return replace(section, cases=tuple(cases), pictures=_keep(into, panels, vector=vector))


def _keep(folder: Path, panels: Sequence[Panel], *, vector: bool) -> tuple[Picture, ...]:
    """Write panels as PNG files, or as SVG and PDF too, under ``folder``; returns them as figures of the page."""
    for panel in panels:
        export.write_figure(folder, panel, vector=vector)
    return tuple(page.picture(panel, quality=80) for panel in panels)
