"""Estimates of the golden pictures by every method, each made once for all tests of a run (tests/sharing.py).

Many tests look at the same estimates from different sides.
"""

import importlib.util
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType
from unittest.mock import patch

from make import read_pictures
from sharing import shared

from huesphere.recover.io.estimate import Estimate
from huesphere.recover.methods import calling
from huesphere.recover.run import recover_one
from huesphere.render.dataset import Observation


@dataclass(frozen=True)
class Made:
    """What one method made of one picture."""

    estimate: Estimate
    own: Estimate  # before it was judged
    files: list[str]  # of ``recover``, in the order of their first call; empty of what docs/architecture.py leaves out


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


def made(name: str, method: str) -> Made:
    """What the ``method`` makes of the picture ``name``."""
    return shared(f"{name}-{method}", lambda: _make(name, method))


def _make(name: str, method: str) -> Made:
    own: list[Estimate] = []
    judged = calling.judged

    def kept_and_judged(estimate: Estimate, *others: object) -> Estimate:
        own.append(estimate)
        return judged(estimate, *others)

    files: list[str] = []
    architecture().import_methods()
    # To be told of every call costs a fifth of the time.
    drawn = name in architecture().pictures_of(method)
    with patch.object(calling, "judged", kept_and_judged), architecture().reported(files) if drawn else nullcontext():
        estimate = recover_one(pictures()[name], method)
    return Made(estimate, own[0], files)
