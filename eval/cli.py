"""The command ``evaluate``: runs methods whose estimates are missing, scores, prints the table, writes the report."""

import argparse
import os
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from huesphere.configs.commandline import (
    TERMINAL_WIDTH,
    Parser,
    discard,
    finish,
    path_argument,
    say,
    say_wrapped,
    wrapped,
)
from huesphere.configs.errors import InputError
from huesphere.configs.own_folder import write_text
from huesphere.configs.suggest import suggested
from huesphere.configs.visible import visible
from huesphere.render.jobs import add_options

if TYPE_CHECKING:
    from huesphere.eval.external_maps import ExternalMaps, Maps
    from huesphere.eval.frames import Frame
    from huesphere.eval.metrics import Row
    from huesphere.eval.score import Item

DATA_SETS = ("webdataset", "huggingface", "hdf5")  # keys of datasets.shards.FORMATS
EXPORTS = ("diligent", "npz", "ply", "glb", "points", *DATA_SETS)
OF_DATA_SETS = ("title", "license", "include", "splits", "shards")  # options that only DATA_SETS have
MOST_TABLES = 12  # most configs whose tables are printed; with more only the summary of each method is
MOST_RESULTS = 60  # most results of which the doubts are printed; with more the page has them


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command's arguments."""
    p = Parser(
        prog="evaluate",
        description="Score recovered normals against the truth of a run folder: first runs the methods whose estimates "
        "are missing, then scores what is on disk, prints a table and writes RUN_DIR/report (index.html, metrics.csv, "
        "metrics.json, paired.csv, table.md, table.tex, figures/, errors/).",
        epilog="examples: evaluate run --method drew-kontsevich --method weak-integrability; "
        "evaluate --study report_1994",
    )
    p.add_argument("run_dir", metavar="RUN_DIR", type=path_argument, nargs="?", help="folder written by render")
    p.add_argument(
        "--method",
        dest="methods",
        metavar="NAME",
        action="append",
        default=[],
        help="only this method; may be given again (default: those of the item's config, and all with an estimate); "
        "woodham1980 is calibrated least squares, which is given the lights and a picture under each",
    )
    add_options(p, default=None)
    p.add_argument("--verify", action="store_true", help="only check that every file is the one that was written")
    p.add_argument(
        "--estimates",
        metavar="DIR",
        type=path_argument,
        help="score normal maps of other programs too: DIR/METHOD/CONFIG/TRANSPORT.npy "
        "(or .npz, .mat, .exr, .tif, .png)",
    )
    p.add_argument(
        "--frame",
        metavar="NAME",
        help="of these maps: opengl (ours: x right, y up, z toward the camera), directx, opencv, diligent … or three "
        "letters such as RDF; auto: the one that agrees best with the truth (default: DIR/METHOD/frame.txt, or opengl)",
    )
    p.add_argument("--vector", action="store_true", help="figures of each picture as SVG and PDF too")
    p.add_argument("--all-figures", action="store_true", help="draw the figures of every picture, however many")
    p.add_argument(
        "--export",
        dest="exports",
        metavar=("KIND", "DIR"),
        nargs=2,
        action="append",
        default=[],
        help="instead of scoring write what is on disk for other programs: diligent (DiLiGenT folders), npz (NumPy), "
        "ply or glb (meshes of the recovered surfaces), points (PLY point clouds); data sets to train on: webdataset "
        "(tar), huggingface (Parquet, Croissant), hdf5; may be given again",
    )
    p.add_argument(
        "--out",
        metavar="DIR",
        type=path_argument,
        help="where to write estimates and report (default: RUN_DIR; of a study, study-NAME)",
    )
    p.add_argument("--overwrite", action="store_true", help="make estimates again that are on disk already")
    p.add_argument("--verbose", action="store_true", help="a line for each estimate as it is made")
    _add_options_of_data_sets(p)
    _add_options_of_studies(p)
    _add_options_of_the_benchmark(p)
    return p


def _add_options_of_studies(p: argparse.ArgumentParser) -> None:
    """Add the options of studies."""
    study = p.add_argument_group("studies, in place of a run folder")
    study.add_argument(
        "--study", metavar="NAME_OR_PATH", help="run a study: report_1994, one_bounce_study, assumptions, or a config"
    )
    study.add_argument("--shape", metavar="PATH", help="report_1994: a scan to repeat its figures on")
    study.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="override a key of the study")


def _add_options_of_the_benchmark(p: argparse.ArgumentParser) -> None:
    """Add the options of the frozen test sets."""
    mark = p.add_argument_group("benchmark, in place of a run folder")
    mark.add_argument(
        "--benchmark",
        metavar="NAME_OR_DIR",
        help="make the frozen test set of that name (v1) in DIR of --out; beside --submit, the folder of a set",
    )
    mark.add_argument(
        "--submit",
        metavar="NORMALS",
        help="score a folder of normal maps (SCENE.npy, .npz, .mat, .exr, .tif or .png), a module:function, or a "
        "method, on the set",
    )
    mark.add_argument("--name", metavar="NAME", help="of what is submitted, on the leaderboard")
    mark.add_argument("--leaderboard", metavar="DIR", type=path_argument, help="print the page of the rows in DIR")


def _add_options_of_data_sets(p: argparse.ArgumentParser) -> None:
    """Add the options OF_DATA_SETS."""
    data = p.add_argument_group("data sets, beside --export webdataset, huggingface or hdf5")
    data.add_argument("--license", metavar="ID_OR_URL", help="of the data, such as CC-BY-4.0: for the card, required")
    data.add_argument("--title", metavar="TEXT", help="for the card (default: the name of the run folder)")
    data.add_argument("--include", metavar="LIST", help="of normals, depth, albedo, masks, layers, lights")
    data.add_argument("--splits", metavar="A,B,C", help="shares of shapes: train, validation, test (default: 80,10,10)")
    data.add_argument("--shards", metavar="N", type=int, help="files of each split (default: 1)")


def main(argv: Sequence[str] | None = None) -> None:
    """Run the command and exit: status 0 for success, 2 for bad input, 1 for any other error."""
    finish(lambda: evaluate(parser().parse_args(argv)))


def evaluate(arguments: argparse.Namespace) -> None:
    """Run the command with these arguments. Raises InputError for arguments that do not go together."""
    if arguments.study is not None:
        _study(arguments)
        return
    if arguments.benchmark or arguments.submit or arguments.leaderboard:
        _benchmark(arguments)
        return
    _refuse(arguments, ("name",), "is for --submit", arguments.run_dir)
    if arguments.run_dir is None:
        raise InputError("evaluate: required: RUN_DIR, or --study NAME (see evaluate --help)")
    _refuse(arguments, ("shape", "set"), "is for studies", arguments.run_dir)
    if arguments.frame is not None and arguments.estimates is None:
        raise InputError("--frame is for normal maps of other programs", expected="--estimates DIR")
    _refuse_options_of_data_sets(arguments)
    if arguments.verify:
        ignored = ("methods", "estimates", "exports", "overwrite", "all_figures", "vector")
        _refuse(arguments, ignored, "has no meaning beside --verify", arguments.run_dir)
        _verify(arguments.run_dir)
        return
    from huesphere.eval.external_maps import find_external_maps
    from huesphere.eval.references import REFERENCES
    from huesphere.eval.score import read_items
    from huesphere.recover.methods.table import METHODS
    from huesphere.render.manifest import require_all_items
    from huesphere.render.results import require_writable, results_root

    run_dir, out, methods = arguments.run_dir, arguments.out, tuple(dict.fromkeys(arguments.methods))
    estimates = arguments.estimates
    if arguments.exports:
        beside = "has no meaning beside --export, which writes what is on disk"
        _refuse(arguments, ("estimates", "overwrite", "all_figures", "vector"), beside, run_dir)
    if arguments.scheduler is not None:  # workers of a cluster have another current folder
        run_dir, out, estimates = (path and path.resolve() for path in (run_dir, out, estimates))
    items = read_items(run_dir, out)
    others = find_external_maps(estimates, items) if estimates else {}
    _check_methods(methods, {*METHODS, *REFERENCES, *(name for of_item in others.values() for name in of_item)}, items)
    if arguments.exports:
        _export(items, methods, arguments)
        return
    require_writable(results_root(run_dir, out) / "report")
    maps = _external(arguments, items, others)
    _run_missing(arguments, items, methods, run_dir, out)
    _report(
        run_dir,
        methods,
        out=out,
        jobs=arguments.jobs or os.cpu_count() or 1,
        scheduler=arguments.scheduler,
        all_figures=arguments.all_figures,
        vector=arguments.vector,
        maps=maps,
    )
    require_all_items(run_dir)


def _run_missing(
    arguments: argparse.Namespace, items: "list[Item]", methods: Sequence[str], run_dir: Path, out: Path | None
) -> None:
    """Make the estimates of ``methods`` that are missing; of no methods, those of each item's config."""
    from huesphere.eval.references import REFERENCES
    from huesphere.recover.methods.table import METHODS

    references = [name for name in methods if name in REFERENCES]
    if references:
        from huesphere.eval.calibrated import run_references

        run_references(items, references, overwrite=arguments.overwrite, say=_say)
    ours = [name for name in methods if name in METHODS]
    if ours or not methods:
        from huesphere.recover.run import recover_run
        from huesphere.render.progress import SECONDS_OF_SWEEPS, shown_progress

        # What each estimate says of itself is told once, below the tables.
        with shown_progress("recover", every=SECONDS_OF_SWEEPS) as progress:
            recover_run(
                run_dir,
                ours,
                out=out,
                overwrite=arguments.overwrite,
                jobs=arguments.jobs or 1,
                scheduler=arguments.scheduler,
                report=_say if arguments.verbose else lambda line: None,
                progress=progress,
            )


def _refuse(arguments: argparse.Namespace, names: Sequence[str], why: str, where: object) -> None:
    """Raise InputError for the first of the options ``names``, as the parser stores them, that was given."""
    for name in names:
        if getattr(arguments, name) not in (None, False, []):
            option = {"methods": "method", "exports": "export"}.get(name, name).replace("_", "-")
            raise InputError(f"--{option} {why}", where=where)


def _refuse_options_of_data_sets(arguments: argparse.Namespace) -> None:
    """Raise InputError for an option of data sets if none is exported."""
    if not any(kind in DATA_SETS for kind, _ in arguments.exports):
        _refuse(arguments, OF_DATA_SETS, f"is for --export {', '.join(DATA_SETS)}", arguments.run_dir)


def _say(line: str) -> None:
    say(line, sys.stderr)


def _named(maps: "Maps", methods: Sequence[str]) -> "Maps":
    """The ``maps`` that are to be scored: all, or if ``methods`` name some of them, these. The others are told."""
    names = list(dict.fromkeys(name for of_item in maps.values() for name in of_item))
    left_out = [name for name in names if name not in methods] if set(names) & set(methods) else []
    if left_out:
        _say(f"not scored, since --method does not name them: {', '.join(left_out)}")
    return {item: {n: path for n, path in of_item.items() if n not in left_out} for item, of_item in maps.items()}


def _external(arguments: argparse.Namespace, items: "Sequence[Item]", paths: "Maps") -> "ExternalMaps":
    """Those of the normal maps at ``paths`` that are to be scored, with the frame of each method's maps."""
    from huesphere.eval.external_maps import ExternalMaps, written_frame
    from huesphere.eval.frame_detection import settle_frames
    from huesphere.eval.frames import OURS, parse_frame

    maps = _named(paths, arguments.methods)
    asked: dict[str, Frame | None] = {}
    for method in dict.fromkeys(name for of_item in maps.values() for name in of_item):
        written = written_frame(arguments.estimates, method)
        if arguments.frame is not None:
            asked[method] = parse_frame(arguments.frame)
        elif written is not None:
            asked[method] = parse_frame(written[0], where=written[1])
        else:
            asked[method] = OURS
    frames, found, hints = settle_frames(items, maps, asked)
    for line in found:
        _say(line)
    return ExternalMaps(maps, frames, tuple(hints))


def _verify(run_dir: Path) -> None:
    """Check every file against the manifest. Raises InputError that names the first bad one; the others are printed."""
    from huesphere.render.manifest import OPTIONAL_FILES
    from huesphere.render.verify import left_out, verified

    faults, count = [], 0
    for path, fault in verified(run_dir):
        count += 1
        faults += [(path, fault)] if fault is not None else []
    for path, fault in faults[1:]:
        say(f"{run_dir / path}: {fault}", sys.stderr)
    if faults:
        path, fault = faults[0]
        more = f" (and {len(faults) - 1} more of {count} files)" if len(faults) > 1 else ""
        raise InputError(f"{fault}{more}", where=run_dir / path)
    say(f"{count} files are those that were written")
    for name, items in left_out(run_dir).items():
        say(f"{items} items were rendered without {name} ({OPTIONAL_FILES[name]})")


def _export(items: "Sequence[Item]", methods: Sequence[str], arguments: argparse.Namespace) -> None:
    """Export every finished item as each (kind, folder) of --export, and print how many files were written."""
    from huesphere.eval.archives import export_npz
    from huesphere.eval.diligent import export_diligent
    from huesphere.eval.surface import export_surfaces

    for kind, folder in arguments.exports:
        if kind not in EXPORTS:
            expected = suggested(kind, EXPORTS, f"one of {', '.join(EXPORTS)}")
            raise InputError("no such kind of export", got=kind, expected=expected, where="--export")
        if kind in DATA_SETS:
            _export_dataset(arguments, kind, Path(folder))
            continue
        written: list[Path] = []
        for item in (item for item in items if item.status == "done"):
            if kind == "diligent":
                written.append(export_diligent(item, Path(folder)))
            elif kind == "npz":
                written.append(export_npz(item, Path(folder)))
            else:
                written += export_surfaces(item, Path(folder), kind, methods)
        if kind == "diligent":
            write_text(Path(folder) / "objects.txt", "".join(f"{path.name}\n" for path in written))
        say(f"{kind}: {len(written)} written under {folder}")


def _export_dataset(arguments: argparse.Namespace, kind: str, folder: Path) -> None:
    """Export the run as a data set to train on, and print what was written."""
    from huesphere.eval.datasets.card import About
    from huesphere.eval.datasets.sample import USUAL, parse_contents
    from huesphere.eval.datasets.shards import empty_splits, export_dataset
    from huesphere.eval.datasets.splits import Shares, parse_shares

    if not arguments.license:
        raise InputError("--license is missing", expected="the licence of the data, such as CC-BY-4.0", where=folder)
    about = About(
        title=arguments.title or arguments.run_dir.resolve().name,
        license=arguments.license,
        contents=USUAL if arguments.include is None else parse_contents(arguments.include),
        shares=Shares() if arguments.splits is None else parse_shares(arguments.splits),
        shards=1 if arguments.shards is None else arguments.shards,
    )
    written = export_dataset(arguments.run_dir, folder, kind, about)
    say(f"{kind}: {len(written)} files with their records written under {folder}")
    for split in empty_splits(written):
        say(f"{split}: no shape of this run is in this split")


def _study(arguments: argparse.Namespace) -> None:
    """Run a study, and print its answer and the path of its page."""
    if arguments.run_dir is not None or arguments.methods:
        raise InputError("--study takes no RUN_DIR and no --method: its config names them", where=arguments.study)
    ignored = ("verify", "estimates", "exports", "overwrite", "all_figures", "vector", "scheduler")
    _refuse(arguments, ignored, "is for a run folder, not for a study", arguments.study)
    from huesphere.configs.study import Report1994, load_study

    study = load_study(arguments.study, overrides=arguments.set)
    if arguments.shape is not None:
        if not isinstance(study, Report1994):
            raise InputError("--shape is for report_1994", where=arguments.study)
        if not Path(arguments.shape).is_file():
            raise InputError("no such file", where=arguments.shape)
        study = study.model_copy(update={"scan": str(Path(arguments.shape).resolve())})

    from huesphere.eval.studies.run import run_study

    folder = arguments.out or Path(f"study-{Path(arguments.study).stem}")
    found, page = run_study(
        study,
        folder,
        jobs=arguments.jobs or os.cpu_count() or 1,
        log=lambda line: say(line, sys.stderr),
    )
    for paragraph in found.answer:
        say(f"{paragraph}\n")
    say(f"page: {page}  ({found.seconds:.0f} s)")


def _benchmark(arguments: argparse.Namespace) -> None:
    """Make a benchmark, score a method on one, or print the leaderboard."""
    if arguments.run_dir is not None:
        raise InputError("--benchmark, --submit and --leaderboard take no RUN_DIR", got=arguments.run_dir)
    ignored = ("methods", "verify", "estimates", "exports", "overwrite", "all_figures", "vector", "scheduler", "set")
    _refuse(arguments, ignored, "is for a run folder, not for a benchmark", "evaluate")
    if arguments.leaderboard is not None:
        from huesphere.eval.leaderboard import leaderboard, read_rows

        text = leaderboard(read_rows(arguments.leaderboard))
        if arguments.out is None:
            say(text.rstrip("\n"))
        else:
            write_text(arguments.out, text)
            say(f"leaderboard: {arguments.out}")
    elif arguments.submit is not None:
        _submit(arguments)
    else:
        from huesphere.eval.benchmark import find_edition, make_benchmark
        from huesphere.render.progress import SECONDS_OF_SWEEPS, shown_progress

        edition = find_edition(arguments.benchmark)
        folder = arguments.out or Path(f"benchmark-{edition.name}")
        with shown_progress(f"benchmark {edition.name}", every=SECONDS_OF_SWEEPS) as progress:
            path = make_benchmark(edition, folder, jobs=arguments.jobs or 1, progress=progress)
        say(f"benchmark: {path}")
        say(f"next: evaluate --submit NORMALS --name NAME --benchmark {folder}")


def _submit(arguments: argparse.Namespace) -> None:
    """Score what is submitted, and say the points and the files."""
    from huesphere.eval.benchmark import check_sums, open_benchmark
    from huesphere.eval.frames import parse_frame
    from huesphere.eval.submission import submit

    if not arguments.name:
        raise InputError("--submit needs a name", expected="--name NAME")
    benchmark = open_benchmark(Path(arguments.benchmark or "benchmark-v1"))
    wrong = check_sums(benchmark)
    if wrong:
        more = f" (and {len(wrong) - 1} more)" if len(wrong) > 1 else ""
        raise InputError(f"a scene that is not the benchmark's{more}", got=wrong[0], where=benchmark.folder)
    frame = parse_frame(arguments.frame) if arguments.frame is not None else None
    row, archive = submit(benchmark, arguments.submit, arguments.name, arguments.out or Path(), frame=frame)
    if row.missing:
        named = ", ".join(row.missing[:4]) + (" …" if len(row.missing) > 4 else "")
        for line in wrapped(f"without a map, and worth no points: {len(row.missing)} scenes ({named})", indent=4):
            say(line)
    say_wrapped(
        f"{row.name} on {row.benchmark}: {row.points:.1f} points (95 % interval {row.low:.1f} to {row.high:.1f})"
    )
    say_wrapped(f"median {row.median_deg:.3g}°, mean {row.mean_deg:.3g}°, {row.coverage:.1%} of the objects covered")
    say_wrapped(f"written: {archive}")
    say_wrapped(f"row: {archive.with_suffix('.json')}, for a folder of rows: evaluate --leaderboard DIR")


def _check_methods(methods: Sequence[str], ours: set[str], items: "Sequence[Item]") -> None:
    """Raise InputError for a name that is not in ``ours`` and has no estimate in any item's folder."""
    from huesphere.eval.score import methods_on_disk

    known = ours.union(*(methods_on_disk(item) for item in items))
    for name in methods:
        if name not in known:
            expected = suggested(name, known, f"one of {', '.join(sorted(known))}")
            raise InputError("no such method", got=name, expected=expected, where="--method")


# More than seven parameters and sixty lines: the options of the command, and what is printed, in its order.
def _report(
    run_dir: Path,
    methods: Sequence[str],
    *,
    out: Path | None,
    jobs: int,
    scheduler: str | None,
    all_figures: bool,
    vector: bool,
    maps: "ExternalMaps",
) -> None:
    """Score a run, write its report, print the tables, then how maps of others were read and hints on their frames."""
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    from huesphere.eval.closing import closing_lines
    from huesphere.eval.report import write_report
    from huesphere.eval.summary import LEGEND as SUMMARY_LEGEND
    from huesphere.eval.summary import summarise, summary_table
    from huesphere.eval.table import LEGEND, doubted_results, terminal_tables, verdict_lines

    class PatientConsole(Console):
        """A console whose reader may go away, as in `… | head`."""

        def on_broken_pipe(self) -> None:
            discard(sys.stdout)

    console = PatientConsole(width=min(TERMINAL_WIDTH, PatientConsole().width if sys.stdout.isatty() else 80))

    def lines(texts: Sequence[str]) -> None:
        for text in texts:
            console.print(text, soft_wrap=True, highlight=False, markup=False)

    columns = (TextColumn("scoring {task.description}"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty()) as bar:
        task = bar.add_task("", total=None)
        report = write_report(
            run_dir,
            methods,
            jobs=jobs,
            scheduler=scheduler,
            all_figures=all_figures,
            vector=vector,
            estimates=maps.paths,
            frames=maps.frames,
            notes=maps.hints,
            out=out,
            progress=lambda done, total, what: bar.update(
                task, completed=done, total=total, description=escape(visible(what))
            ),
        )
    rows = [score.row for score in report.scores]
    configs = len({row.config for row in rows})
    if configs <= MOST_TABLES:
        for table in terminal_tables(rows):
            console.print(table)
        lines([*wrapped(LEGEND), ""])
    if configs > 1:
        console.print(summary_table(summarise(report.scores)))
        lines([*wrapped(SUMMARY_LEGEND), ""])
    doubted = verdict_lines(doubted_results(rows, [score.verdict for score in report.scores]))
    if len(rows) <= MOST_RESULTS:
        lines([*doubted, *[""] * bool(doubted)])
    else:
        counts = Counter(row.verdict or row.status for row in rows)
        lines(wrapped(f"verdicts: {', '.join(f'{n} {word}' for word, n in counts.most_common())}"))
    if configs > MOST_TABLES:
        lines([visible(f"tables of all {configs} configs: {report.page.with_name('table.md')}")])
    for line in [*_how_read([row for row in rows if row.method in maps.frames]), *maps.hints]:
        lines(wrapped(line, indent=4))
    if len(rows) <= MOST_RESULTS:
        for line in closing_lines(rows):
            lines(wrapped(line, indent=7))
    lines([visible(f"report: {report.page}")])


def _how_read(rows: "Sequence[Row]") -> list[str]:
    """A line for each thing that is to be said of how maps of a method were read."""
    counts = Counter((row.method, row.message) for row in rows if row.status == "ok" and row.message)
    return [f"{method}: {text}" + (f" ({n} pictures)" if n > 1 else "") for (method, text), n in counts.items()]


if __name__ == "__main__":
    main()
