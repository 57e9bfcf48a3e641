"""Sweeps: one config file for many items. `sweep:` maps keys to lists of values; all combinations are made.

    sweep:
      lights.0.intensity: [0.5, 1, 2]
      surface.reflectance: [light skin, 0.8]

gives six items, named after the config and what is their own: ``mozart-intensity_0.5-reflectance_light-skin`` …
"""

import copy
import itertools
import re
from collections.abc import Iterator
from typing import Any

from configs.errors import InputError
from configs.places import set_key

MOST_ITEMS = 100_000
LONGEST_NAME = 100


def expand(data: dict[str, Any], where: object) -> Iterator[tuple[dict[str, Any], dict[tuple[str | int, ...], str]]]:
    """Each config that the mapping ``data`` stands for, and the sweep's key behind each place that it set.

    Without a `sweep` that is ``data`` itself. Raises InputError for a sweep that is none.
    """
    sweep = data.pop("sweep", None)
    if sweep is None:
        yield data, {}
        return
    if not isinstance(sweep, dict) or not sweep:
        raise InputError("sweep", got=type(sweep).__name__, expected="keys with lists of values", where=where)
    for key, values in sweep.items():
        if not isinstance(values, list) or not values:
            raise InputError(f"sweep.{key}", got=repr(values)[:60], expected="a list of values", where=where)
    total = 1
    for values in sweep.values():
        total *= len(values)
    if total > MOST_ITEMS:
        raise InputError("sweep", got=f"{total} combinations", expected=f"at most {MOST_ITEMS}", where=where)
    short = _short_keys([str(key) for key in sweep])
    labels = [[_label(value, i) for i, value in enumerate(values)] for values in sweep.values()]
    suffixes = ["-".join(parts) for parts in itertools.product(*_tagged(short, labels))]
    names = [f"{data.get('name')}-{suffix}" for suffix in suffixes]
    if len(set(names)) < total or max(map(len, names)) > LONGEST_NAME:
        names = [f"{data.get('name')}-{number:05d}" for number in range(total)]
    choices = itertools.product(*(range(len(values)) for values in sweep.values()))
    for name, chosen in zip(names, choices, strict=True):
        one = copy.deepcopy(data)
        places = {}
        for key, values, which in zip(sweep, sweep.values(), chosen, strict=True):
            places[set_key(one, str(key), values[which], what="sweep")] = f"sweep.{key}"
        one["name"] = name
        yield one, places


def _tagged(keys: list[str], labels: list[list[str]]) -> list[list[str]]:
    return [[f"{key}_{label}" for label in row] for key, row in zip(keys, labels, strict=True)]


def _short_keys(keys: list[str]) -> list[str]:
    """The last word of each key, or all of it where another ends alike."""
    last = [key.split(".")[-1] for key in keys]
    return [_plain(word if last.count(word) == 1 else key) for word, key in zip(last, keys, strict=True)]


def _label(value: Any, number: int) -> str:
    return _plain(str(value)) if isinstance(value, str | int | float) else str(number)


def _plain(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9._]+", "-", text).strip("-") or "x"
