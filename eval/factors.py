"""Finds the factors of a run: the keys of its configs whose values differ between items."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from huesphere.configs.errors import InputError
from huesphere.configs.file_paths import is_file_key
from huesphere.configs.load import read_yaml
from huesphere.configs.own_folder import inside
from huesphere.eval.score import Item

MOST_FACTORS = 8
# Beginnings of keys that belong to the run or to its random numbers, not to the scene
NOT_FACTORS = ("name", "recover.", "camera.seed", "render.")
Value = float | str


@dataclass(frozen=True)
class Factor:
    """One key that varies, and its value in every item."""

    key: str  # dotted key of the config, as in `--set`; or "transport"
    values: Mapping[str, Value]  # by item id; all numbers, or all words
    numeric: bool  # whether they are numbers

    @property
    def levels(self) -> list[Value]:
        """Distinct values: numbers in order, words in the order of the items."""
        found = list(dict.fromkeys(self.values.values()))
        return sorted(found) if self.numeric else found  # type: ignore[type-var]


def read_factors(items: Sequence[Item]) -> list[Factor]:
    """Return the keys whose values differ between the items' configs, at most ``MOST_FACTORS``, and the transport.

    If two keys divide the items into the same groups, they are one factor, which has the name of the first. Items whose
    config cannot be read are ignored.
    """
    leaves = {item.id: flat for item in items if (flat := _leaves(item.folder))}
    found: list[Factor] = []
    seen: set[tuple[int, ...]] = set()
    columns: dict[str, dict[str, Any]] = {"transport": {item.id: item.transport for item in items if item.id in leaves}}
    for key in dict.fromkeys(key for flat in leaves.values() for key in flat):
        if not key.startswith(NOT_FACTORS):
            columns[key] = {identity: flat.get(key) for identity, flat in leaves.items()}
    for key, column in columns.items():
        levels: dict[str, int] = {}
        grouping = tuple(levels.setdefault(_word(value), len(levels)) for value in column.values())
        if len(levels) < 2 or grouping in seen:
            continue
        seen.add(grouping)
        numeric = all(isinstance(v, int | float) and not isinstance(v, bool) for v in column.values())
        found.append(Factor(key, {i: float(v) if numeric else _word(v) for i, v in column.items()}, numeric))
    return found[:MOST_FACTORS]


def _leaves(folder: Path) -> dict[str, Any]:
    """The values in an item's config.yaml by dotted key; {} if it cannot be read."""
    try:
        config, _ = read_yaml(inside(folder, "config.yaml"))
    except InputError:
        return {}
    flat: dict[str, Any] = {}
    _flatten(config, "", flat)
    return flat


def _flatten(value: Any, key: str, into: dict[str, Any]) -> None:
    """Add the values within ``value`` to ``into`` by dotted key. A list without mappings in it is one value."""
    if isinstance(value, dict):
        for name, entry in value.items():
            _flatten(entry, f"{key}.{name}" if key else str(name), into)
    elif isinstance(value, list) and any(isinstance(entry, dict) for entry in value):
        into[f"{key} (number)"] = len(value)
        for number, entry in enumerate(value):
            _flatten(entry, f"{key}.{number}", into)
    elif is_file_key(key) and isinstance(value, str):
        into[key] = value.removeprefix("./").replace("../", "")  # not where it lies from the item's folder
    else:
        into[key] = value


def _word(value: Any) -> str:
    """``value`` as text."""
    if isinstance(value, list):
        return " ".join(map(_word, value))
    return f"{value:g}" if isinstance(value, float) else str(value)
