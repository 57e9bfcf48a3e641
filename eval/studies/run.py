"""The table of studies, and the function that runs one and writes its files."""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from huesphere.configs.study import AnyStudy
from huesphere.eval.studies.assumptions import assumptions
from huesphere.eval.studies.one_bounce import one_bounce
from huesphere.eval.studies.page import Study, write_study
from huesphere.eval.studies.pictures import Log
from huesphere.eval.studies.real_photographs import real_photographs
from huesphere.eval.studies.report_1994 import report_1994

STUDIES: dict[str, Callable[[Any, Path, Log, int], Study]] = {
    "report_1994": report_1994,
    "one_bounce": one_bounce,
    "assumptions": assumptions,
    "real_photographs": real_photographs,
}


def run_study(study: AnyStudy, folder: Path, *, jobs: int, log: Log) -> tuple[Study, Path]:
    """Run a study and write its files into ``folder``; returns (study, path of index.html).

    Pictures and estimates are kept in ``folder``/run; those that exist are not made again. ``jobs``: processes.
    """
    started = time.monotonic()
    folder.mkdir(parents=True, exist_ok=True)
    found = STUDIES[study.study](study, folder, log, jobs)
    found = replace(found, seconds=time.monotonic() - started)
    return found, write_study(folder, found)
