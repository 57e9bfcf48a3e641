"""Plans what is to be rendered: groups of configs with the same geometry, without the items that are on disk.

The bytes of an item depend on its config and on all configs of its group, whether their items are on disk or not. So
the files do not depend on the order of the work, on its division among processes, or on interruptions.
"""

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from huesphere.configs.errors import InputError
from huesphere.configs.schema import RunConfig
from huesphere.render.dataset import TRANSPORTS
from huesphere.render.inputs import content_text
from huesphere.render.item import entry_there, item_id, require_files
from huesphere.render.manifest import empty_manifest, item_folder, read_manifest
from huesphere.render.relighting import geometry_of


@dataclass(frozen=True)
class Shard:
    """Part ``number``, from 1, of a run that is divided into ``count`` parts."""

    number: int
    count: int

    def holds(self, geometry: str) -> bool:
        """Whether the configs of a geometry, as ``geometry_of`` names it, are in this part."""
        return number_of_part(geometry, self.count) == self.number - 1


def number_of_part(geometry: str, count: int) -> int:
    """Which of ``count`` parts, from 0, holds a geometry; if m divides n, part k of n lies in part k mod m of m."""
    return int.from_bytes(hashlib.sha256(geometry.encode()).digest()[:8], "big") % count


def parse_shard(text: str) -> Shard:
    """The part that a text such as "2/8" (the second of eight) names. Raises InputError."""
    number, _, count = text.partition("/")
    if not (number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
        raise InputError("--shard", got=text, expected="I/N with 1 ≤ I ≤ N")
    return Shard(int(number), int(count))


@dataclass(frozen=True)
class Group:
    """Configs that share one trace, sorted, and the transports of each that are to be made."""

    configs: tuple[RunConfig, ...]
    todo: tuple[tuple[str, ...], ...]

    @property
    def reach(self) -> str:
        """The highest level of transport that any of the configs has."""
        return next(t for t in reversed(TRANSPORTS) if any(t in config.render.transport for config in self.configs))

    @property
    def items(self) -> tuple[tuple[RunConfig, str], ...]:
        """(config, transport) of the items to be made."""
        return tuple((config, t) for config, todo in zip(self.configs, self.todo, strict=True) for t in todo)


@dataclass(frozen=True)
class Plan:
    """The work of a command, and the items that are on disk already."""

    groups: tuple[Group, ...]  # groups with items to be made
    ids: tuple[str, ...]  # ids of all items of the configs in this shard
    there: tuple[dict[str, Any], ...]  # entries of the items that are done already
    failed: tuple[dict[str, Any], ...]  # entries of items that failed before and are not tried again


def make_plan(
    configs: Sequence[RunConfig],
    run: Path,
    *,
    overwrite: bool,
    retry_failed: bool,
    shard: Shard | None,
    left_out: Sequence[str] = (),
) -> Plan:
    """Find the items of ``configs`` that are not yet in ``run``, and divide them into groups. Writes nothing.

    ``left_out``: files that are not wanted of the items. Raises InputError for items that another config made or that
    lack a file that is wanted, unless ``overwrite``, and for links in the place of a folder.
    """
    manifest = read_manifest(run) if os.path.lexists(run / "manifest.json") else empty_manifest()
    alike: dict[str, list[RunConfig]] = {}
    for config in configs:
        alike.setdefault(geometry_of(config), []).append(config)
    if shard is not None:
        alike = {geometry: members for geometry, members in alike.items() if shard.holds(geometry)}
    groups: list[Group] = []
    ids: list[str] = []
    there: list[dict[str, Any]] = []
    failed: list[dict[str, Any]] = []
    for members in alike.values():
        todo: list[tuple[str, ...]] = []
        for config in (in_order := sorted(members, key=content_text)):
            missing = []
            for transport in (t for t in TRANSPORTS if t in config.render.transport):
                ids.append(item_id(config, transport))
                item_folder(run, ids[-1])
                entry = None if overwrite else entry_there(run, manifest, config, transport)
                if entry is None or (entry["status"] == "failed" and retry_failed):
                    missing.append(transport)
                else:
                    require_files(run, entry, left_out)
                    (there if entry["status"] == "done" else failed).append(entry)
            todo.append(tuple(missing))
        if any(todo):
            groups.append(Group(tuple(in_order), tuple(todo)))
    return Plan(tuple(groups), tuple(ids), tuple(there), tuple(failed))
