"""Expands a sweep: one config file that describes many items.

The key `sweep:` maps keys of the config to lists of values, and there is a config for each combination of values:

    sweep:
      lights.0.intensity: [0.5, 1, 2]
      surface.reflectance: [light skin, 0.8]

gives six configs, named after the file and their own values: ``mozart-intensity_0.5-reflectance_light-skin`` …
A key may have a random distribution (``configs.draws``) in place of a list. Then each combination of the lists is made
`count` times, each time with other random values, called a *draw*:

    sweep:
      count: 200
      seed: 7
      lights.0.direction: {cone: 60}
      surface.reflectance: {uniform: [0.2, 0.9]}

The random value of a key depends only on the seed, the key and the number of the draw. So a larger count adds items and
does not change the others, and draw number 5 has the same values in every combination of the lists. Unless the sweep
sets `camera.seed`, it is derived for each item from the config's own seed and the item's values, so that no two items
have the same noise. Of a file among the values, names and seeds depend on the path as it is written and on the file's
contents, so they are the same wherever the files lie. Where a part of the scene is left to chance
(``configs.random_scene``), each draw has its own, with or without other distributions.
"""

import copy
import itertools
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from huesphere.configs.draws import derived_seed, draw, is_distribution
from huesphere.configs.errors import InputError
from huesphere.configs.file_paths import PathAsWritten, without_place
from huesphere.configs.places import set_key
from huesphere.configs.random_scene import RANDOM, draw_random, is_random

MOST_ITEMS = 100_000
LONGEST_NAME = 100  # characters
# A config as a mapping; and for each place that the sweep set, as keys and indices, the dotted key in the sweep
Expanded = tuple[dict[str, Any], dict[tuple[str | int, ...], str]]


@dataclass(frozen=True)
class _Sweep:
    """The parts of a `sweep:` mapping, in the order in which they were written."""

    lists: dict[str, list[Any]]  # keys with lists of values
    random: dict[str, dict[str, Any]]  # keys with distributions
    count: int  # number of draws; 1 if nothing is random
    drawn: bool  # whether items are draws, and named by the number of theirs
    seed: int  # of the draws
    where: object  # place of the sweep, for error messages

    @property
    def total(self) -> int:
        """Number of items."""
        total = self.count
        for values in self.lists.values():
            total *= len(values)
        return total


def expand(data: dict[str, Any], where: object) -> Iterator[Expanded]:
    """Yield each config that the mapping ``data`` describes, with the places that the sweep set (``Expanded``).

    Without a key `sweep`, ``data`` itself is the only config. The key is removed from ``data``. ``where`` is the place
    of the sweep for error messages. Raises InputError for an invalid sweep.
    """
    written = data.pop("sweep", None)
    if written is None:
        draw_random(data, 0, where)
        yield data, {}
        return
    sweep = _read(written, data, where)
    names = _names(str(data.get("name")), sweep)
    choices = itertools.product(*(range(len(values)) for values in sweep.lists.values()), range(sweep.count))
    for name, (*chosen, number) in zip(names, choices, strict=True):
        values = {key: listed[which] for (key, listed), which in zip(sweep.lists.items(), chosen, strict=True)}
        values |= {key: draw(key, what, sweep.seed, number, where) for key, what in sweep.random.items()}
        config = copy.deepcopy(data)
        places = {
            set_key(config, key, copy.deepcopy(value), what="sweep"): f"sweep.{key}" for key, value in values.items()
        }
        told = draw_random(config, number, where)
        config["name"] = f"{name}-{_plain(told)}"[:LONGEST_NAME] if told and sweep.drawn else name
        _set_camera_seed(config, values, number if sweep.drawn else None)
        yield config, places


def _read(written: Any, data: dict[str, Any], where: object) -> _Sweep:
    """The parts of a sweep as it is ``written`` in the config ``data``. Raises InputError if it is invalid."""
    if not isinstance(written, dict) or not written:
        raise InputError("sweep", got=type(written).__name__, expected="keys with lists of values", where=where)
    lists, random = {}, {}
    for key, values in written.items():
        if key in ("count", "seed"):
            continue
        if isinstance(values, dict) and list(values) == [RANDOM]:  # a part of the scene, drawn as in the config itself
            lists[str(key)] = [values]
        elif is_distribution(values):
            random[str(key)] = values
        elif isinstance(values, list) and values:
            lists[str(key)] = values
        else:
            raise InputError(
                f"sweep.{key}", got=repr(values)[:60], expected="a list of values or a distribution", where=where
            )
    count = _whole(written, "count", 1, where)
    if random and "count" not in written:
        raise InputError("sweep.count is missing: how many draws", where=where)
    by_chance = bool(random) or _has_random_parts(data, lists)
    if not by_chance and "count" in written:
        raise InputError("sweep.count", got=count, expected="a key with a distribution to draw from", where=where)
    drawn = by_chance and "count" in written
    sweep = _Sweep(lists, random, count, drawn, _whole(written, "seed", 0, where), where)
    if sweep.total > MOST_ITEMS:
        raise InputError("sweep", got=f"{sweep.total} items", expected=f"at most {MOST_ITEMS}", where=where)
    return sweep


def _has_random_parts(data: dict[str, Any], lists: dict[str, list[Any]]) -> bool:
    """Whether the config with the first value of each list leaves a part of the scene to chance."""
    first = copy.deepcopy(data)
    for key, values in lists.items():
        set_key(first, key, copy.deepcopy(values[0]), what="sweep")
    return is_random(first)


def _whole(written: dict[str, Any], key: str, least: int, where: object) -> int:
    """The whole number under ``key`` of a sweep, ``least`` if there is none. Raises InputError below ``least``."""
    value = written.get(key, least)
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise InputError(f"sweep.{key}", got=repr(value)[:60], expected=f"a whole number from {least}", where=where)
    return int(value)


def _set_camera_seed(config: dict[str, Any], values: dict[str, Any], number: int | None) -> None:
    """Set ``camera.seed`` of an item, derived from the config's seed and the item's values, unless a value sets it.

    ``number``: of the draw, None if nothing is random.
    """
    camera = config.setdefault("camera", {})
    base = camera.get("seed", 0) if isinstance(camera, dict) else None
    if isinstance(base, int) and base >= 0 and not any(key in ("camera", "camera.seed") for key in values):
        camera["seed"] = derived_seed(base, without_place(values), number)


# ---- names ---------------------------------------------------------------------------------------------------------


def _names(name: str, sweep: _Sweep) -> list[str]:
    """A name for each item, made of ``name`` and its values; or of a number, if such names are long or not unique."""
    short = _short_keys(list(sweep.lists))
    labels = [[_label(value, i) for i, value in enumerate(values)] for values in sweep.lists.values()]
    parts = [[f"{key}_{label}" for label in row] for key, row in zip(short, labels, strict=True)]
    if sweep.drawn:
        parts.append([f"{number:05d}" for number in range(sweep.count)])
    names = ["-".join((name, *own)) for own in itertools.product(*parts)]
    if len(set(names)) < sweep.total or max(map(len, names)) > LONGEST_NAME:
        names = [f"{name}-{number:05d}" for number in range(sweep.total)]
    return names


def _short_keys(keys: list[str]) -> list[str]:
    """For each dotted key its last word, or the whole key if another one has the same last word."""
    last = [key.split(".")[-1] for key in keys]
    return [_plain(word if last.count(word) == 1 else key) for word, key in zip(last, keys, strict=True)]


def _label(value: Any, number: int) -> str:
    """A value as part of a name: itself if it is a word, number or file, otherwise its ``number`` in the list."""
    if isinstance(value, PathAsWritten):
        return _plain("-".join(part for part in value.label.split("/") if part.strip(".")))
    return _plain(str(value)) if isinstance(value, str | int | float) else str(number)


def _plain(text: str) -> str:
    """``text`` with characters that are allowed in names only."""
    return re.sub(r"[^A-Za-z0-9._]+", "-", text).strip("-") or "x"
