"""Results that several tests look at, each made once for all processes of a test run.

Processes share them through files in a folder that ``conftest.py`` makes for the run, and removes at its end.
"""

import os
import pickle
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

SHARED = Path(os.environ["HUESPHERE_SHARED_ESTIMATES"])  # as conftest.py has it
LONGEST_S = 600.0  # that a result may be waited for, which another process has begun

_here: dict[str, Any] = {}  # of this process


def shared(name: str, make: Callable[[], Any]) -> Any:
    """The result of ``make``, which the first that asks for this ``name`` calls; nobody may change what is shared."""
    if name not in _here:
        _here[name] = _shared(name, make)
    return _here[name]


def _shared(name: str, make: Callable[[], Any]) -> Any:
    kept, begun = SHARED / f"{name}.pickle", SHARED / f"{name}.begun"
    try:
        begun.touch(exist_ok=False)
    except FileExistsError:
        until = time.monotonic() + LONGEST_S
        while begun.exists() and not kept.exists() and time.monotonic() < until:
            time.sleep(0.05)
    if kept.exists():
        return pickle.loads(kept.read_bytes())
    try:
        found = make()
    except BaseException:
        begun.unlink(missing_ok=True)  # nobody waits for what failed
        raise
    partial = kept.with_suffix(f".{os.getpid()}")
    partial.write_bytes(pickle.dumps(found))
    partial.replace(kept)
    return found
