"""Digests of the files that a config names (shapes, spectra), by which a change of one of them is noticed.

An item whose files have changed since it was rendered is not taken for finished (``render.item.entry_there``).
"""

import functools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from huesphere.configs.schema import RunConfig
from huesphere.render.manifest import sha256_of


def digests_of_inputs(config: RunConfig) -> dict[str, str]:
    """sha256 of each file that ``config`` names, by its path as in the config; files that do not exist are left out."""
    found = {}
    for name in _paths(config.model_dump(mode="json")):
        path = Path(name)
        if path.is_file():
            status = path.stat()
            found[name] = _digest(path, status.st_mtime_ns, status.st_size)
    return found


@functools.lru_cache(maxsize=1024)
def _digest(path: Path, _modified: int, _size: int) -> str:
    """sha256 of a file; time and size are arguments so that the cache holds only while the file does not change."""
    return sha256_of(path, follow=True)


def _paths(node: Any) -> Iterator[str]:
    """The values of all keys `path` and `csv` in a config, the only keys that name files."""
    if isinstance(node, dict):
        for key, value in node.items():
            if key in ("path", "csv") and isinstance(value, str):
                yield value
            else:
                yield from _paths(value)
    elif isinstance(node, list):
        for value in node:
            yield from _paths(value)
