"""``evaluate``: run what estimates are missing, score what is on disk, print the table, write the report."""

import argparse
import sys
from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING

from configs.commandline import Parser, finish
from configs.errors import InputError

if TYPE_CHECKING:
    from eval.score import Item

TABLE_WIDTH = 100  # characters, where the output is no terminal


def parser() -> argparse.ArgumentParser:
    """Return the command's arguments."""
    p = Parser(
        prog="evaluate",
        description="Score recovered normals against the truth of a run folder: first runs the methods whose estimates "
        "are missing, then scores what is on disk, prints a table and writes RUN_DIR/report (index.html, metrics.csv, "
        "metrics.json, table.md, table.tex, figures/, errors/).",
        epilog="examples: evaluate run --method drew-kontsevich --method weak-integrability; "
        "evaluate --study report_1994",
    )
    p.add_argument("run_dir", metavar="RUN_DIR", type=Path, nargs="?", help="folder written by render")
    p.add_argument(
        "--method",
        dest="methods",
        metavar="NAME",
        action="append",
        default=[],
        help="only this method; may be given again (default: those of the item's config, and all with an estimate)",
    )
    p.add_argument("--overwrite", action="store_true", help="make estimates again that are on disk already")
    study = p.add_argument_group("studies, in place of a run folder")
    study.add_argument(
        "--study", metavar="NAME_OR_PATH", help="render, recover and answer: report_1994, one_bounce_study, …"
    )
    study.add_argument("--out", metavar="DIR", type=Path, help="where to write (default: study-NAME)")
    study.add_argument("--shape", metavar="PATH", help="report_1994: a scan to repeat its figures on")
    study.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="override a key of the study")
    study.add_argument("--jobs", type=int, metavar="N", help="processes (default: as many as there are cores)")
    return p


def main(argv: Sequence[str] | None = None) -> None:
    """The command: exits with 0 when done, 2 on bad input, 1 on anything else."""
    finish(lambda: evaluate(parser().parse_args(argv)))


def evaluate(arguments: argparse.Namespace) -> None:
    """Do what the arguments say."""
    if arguments.study is not None:
        _study(arguments)
        return
    if arguments.run_dir is None:
        raise InputError("evaluate: required: RUN_DIR, or --study NAME (see evaluate --help)")
    for name in ("out", "shape", "jobs"):
        if getattr(arguments, name) is not None:
            raise InputError(f"--{name} is for studies", got="a run folder", where=arguments.run_dir)
    from eval.score import read_items
    from recover.methods import METHODS

    run_dir, methods = arguments.run_dir, tuple(dict.fromkeys(arguments.methods))
    _check_methods(methods, set(METHODS), read_items(run_dir))
    ours = [name for name in methods if name in METHODS]
    if ours or not methods:
        from recover.run import recover_run

        recover_run(run_dir, ours, overwrite=arguments.overwrite, report=lambda line: print(line, file=sys.stderr))
    _report(run_dir, methods)


def _study(arguments: argparse.Namespace) -> None:
    """Run a study, and say where its page lies and what it found."""
    import os

    if arguments.run_dir is not None or arguments.methods:
        raise InputError("--study takes no RUN_DIR and no --method: its config names them", where=arguments.study)
    if arguments.jobs is not None and arguments.jobs < 1:
        raise InputError("--jobs", got=arguments.jobs, expected="1 or more")
    from configs.study import Report1994, load_study

    study = load_study(arguments.study, overrides=arguments.set)
    if arguments.shape is not None:
        if not isinstance(study, Report1994):
            raise InputError("--shape is for report_1994", where=arguments.study)
        if not Path(arguments.shape).is_file():
            raise InputError("no such file", where=arguments.shape)
        study = study.model_copy(update={"scan": str(Path(arguments.shape).resolve())})

    from eval.studies.run import run_study

    folder = arguments.out or Path(f"study-{Path(arguments.study).stem}")
    found, page = run_study(
        study,
        folder,
        jobs=arguments.jobs or os.cpu_count() or 1,
        log=lambda line: print(line, file=sys.stderr, flush=True),
    )
    for paragraph in found.answer:
        print(f"{paragraph}\n")
    print(f"page: {page}  ({found.seconds:.0f} s)")


def _check_methods(methods: Sequence[str], ours: set[str], items: "Sequence[Item]") -> None:
    """Raise InputError for a name that is neither one of ours nor has an estimate in any item's folder."""
    from eval.score import methods_on_disk

    known = ours.union(*(methods_on_disk(item) for item in items))
    for name in methods:
        if name not in known:
            near = get_close_matches(name, known, n=1)
            hint = f"{near[0]!r} (did you mean it?)" if near else f"one of {', '.join(sorted(known))}"
            raise InputError("no such method", got=name, expected=hint, where="--method")


def _report(run_dir: Path, methods: Sequence[str]) -> None:
    """Score, write the report, print the table."""
    import os

    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    from eval.report import write_report
    from eval.table import terminal_tables

    console = Console(width=None if sys.stdout.isatty() else TABLE_WIDTH)
    columns = (TextColumn("scoring {task.description}"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty()) as bar:
        task = bar.add_task("", total=None)
        report = write_report(
            run_dir,
            methods,
            jobs=os.cpu_count() or 1,
            progress=lambda done, total, what: bar.update(task, completed=done, total=total, description=what),
        )
    for table in terminal_tables([score.row for score in report.scores]):
        console.print(table)
    console.print(f"report: {report.page}", soft_wrap=True, highlight=False, markup=False)


if __name__ == "__main__":
    main()
