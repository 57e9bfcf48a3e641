"""Where estimates and reports of a run are kept: in the run folder, or in another one where that may not be written.

A data set that somebody shares read-only is evaluated with ``--out DIR``: DIR then holds the same relative paths,
DIR/<config>/<transport>/estimates and DIR/report. Estimates that the run itself has are used, not made again.
"""

import os
from pathlib import Path

from huesphere.configs.errors import InputError


def results_root(run: Path, out: Path | None) -> Path:
    """The folder that results of ``run`` are written to: ``out`` if it is given, else the run folder itself.

    Raises InputError if ``out`` is no folder, or another run folder.
    """
    if out is None or out.resolve() == run.resolve():
        return run
    if out.exists() and not out.is_dir():
        raise InputError("--out", got="a file", expected="a folder", where=out)
    if (out / "manifest.json").exists():
        raise InputError("--out", got="another run folder", expected="a folder for results", where=out)
    return out


def require_writable(folder: Path) -> None:
    """Raise InputError if files cannot be made in ``folder``, or the folder itself cannot be made.

    Called before work starts, whose results would be lost.
    """
    place = folder.absolute()
    while not place.exists() and place != place.parent:
        place = place.parent
    if not os.access(place, os.W_OK | os.X_OK):
        raise InputError("may not be written", expected="--out DIR, a folder for results", where=place)
