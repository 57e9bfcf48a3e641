"""Tuned numbers: what each means, its unit, and where its value comes from.

Every package of ``recover`` has a file ``parameters.py`` with one frozen record, whose fields are made by ``tuned``,
and one instance of it that the package's modules read. ``docs/parameters.md`` is generated from these records, and
``benchmarks/recover_sensitivity.py`` measures what happens at half and at twice each value.

A number belongs there if another value would give other results and nothing but experience chose it. Mathematical
constants, guards, tolerances and bounds of iterations, and sizes of work (trials, chunks, grids) stay where they are
used, as constants with their meaning beside them: at half and at twice their value results hardly change.

Weights that were fitted to data, many at once, are in JSON files beside the code that uses them. Each says which script
fitted them, to which data, and what they are weights of; the same page lists them.
"""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import field, fields, is_dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any


def tuned(default: Any, *, unit: str, meaning: str, origin: str) -> Any:
    """A field of a record of parameters: its default, unit, meaning in one sentence, and what set the value.

    ``origin`` names the report's section, a publication, or the script and data that the value was chosen with.
    """
    return field(default=default, metadata={"unit": unit, "meaning": meaning, "origin": origin})


@contextmanager
def overridden(record: Any, **values: Any) -> Iterator[None]:
    """``record`` with other ``values`` within the block: for experiments on sensitivity, never for the methods.

    Raises AttributeError for a name that the record does not have.
    """
    before = {name: getattr(record, name) for name in values}
    try:
        for name, value in values.items():
            object.__setattr__(record, name, value)
        yield
    finally:
        for name, value in before.items():
            object.__setattr__(record, name, value)


def described(record: Any) -> list[tuple[str, Any, str, str, str]]:
    """(name, value, unit, meaning, origin) of each parameter of a record, in its order."""
    return [
        (f.name, getattr(record, f.name), *(f.metadata[k] for k in ("unit", "meaning", "origin")))
        for f in fields(record)
    ]


@cache
def learned(file: str) -> dict[str, Any]:
    """The content of a file of learned weights, such as "cues/silhouette_weights.json"."""
    found: dict[str, Any] = json.loads((Path(__file__).parent / file).read_text(encoding="utf-8"))
    return found


def learned_files() -> list[str]:
    """The files that ``learned`` reads."""
    return sorted(path.relative_to(Path(__file__).parent).as_posix() for path in Path(__file__).parent.glob("*/*.json"))


def records() -> dict[str, Any]:
    """Every package's record of tuned numbers, by the name of its instance."""
    found: dict[str, Any] = {}
    for path in sorted(Path(__file__).parent.glob("*/parameters.py")):
        module = import_module(f"{__package__}.{path.parent.name}.parameters")
        found |= {name: one for name, one in vars(module).items() if name.isupper() and is_dataclass(one)}
    return found
