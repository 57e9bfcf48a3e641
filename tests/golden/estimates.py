"""Estimates of the golden pictures by every method, each made once for all tests of a run.

Many tests look at the same estimates from different sides. Processes of one run share them through files in a folder
that ``conftest.py`` makes for the run, and removes at its end.
"""

import importlib.util
import os
import pickle
import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType
from unittest.mock import patch

from make import read_pictures

from huesphere.recover.io.estimate import Estimate
from huesphere.recover.methods import calling
from huesphere.recover.run import recover_one
from huesphere.render.dataset import Observation

SHARED = Path(os.environ["HUESPHERE_SHARED_ESTIMATES"])  # as conftest.py has it
LONGEST_S = 600.0  # that an estimate may be waited for, which another process has begun


@dataclass(frozen=True)
class Made:
    """What one method made of one picture."""

    estimate: Estimate
    own: Estimate  # before it was judged
    files: list[str]  # of ``recover``, in the order of their first call


@cache
def pictures() -> dict[str, Observation]:
    return read_pictures()


@cache
def architecture() -> ModuleType:
    """docs/architecture.py, which knows how to see which files a method runs."""
    path = Path(__file__).parents[2] / "docs" / "architecture.py"
    spec = importlib.util.spec_from_file_location("architecture", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def estimate_of(name: str, method: str) -> Estimate:
    """The estimate of the picture ``name``, with its verdict."""
    return made(name, method).estimate


@cache
def made(name: str, method: str) -> Made:
    """What the ``method`` makes of the picture ``name``, from the file of it if it is there."""
    kept, begun = SHARED / f"{name}-{method}.pickle", SHARED / f"{name}-{method}.begun"
    try:
        begun.touch(exist_ok=False)
    except FileExistsError:
        until = time.monotonic() + LONGEST_S
        while not kept.exists() and time.monotonic() < until:
            time.sleep(0.05)
    if kept.exists():
        return pickle.loads(kept.read_bytes())
    found = _make(name, method)
    partial = kept.with_suffix(f".{os.getpid()}")
    partial.write_bytes(pickle.dumps(found))
    partial.replace(kept)
    return found


def _make(name: str, method: str) -> Made:
    own: list[Estimate] = []
    judged = calling.judged

    def kept_and_judged(estimate: Estimate, *others: object) -> Estimate:
        own.append(estimate)
        return judged(estimate, *others)

    files: list[str] = []
    architecture().import_methods()
    with patch.object(calling, "judged", kept_and_judged), architecture().reported(files):
        estimate = recover_one(pictures()[name], method)
    return Made(estimate, own[0], files)
