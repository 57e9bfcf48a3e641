"""Files that a config names, shapes and spectra: an item is made again when one of them has changed."""

import functools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from huesphere.configs.schema import RunConfig
from huesphere.render.manifest import sha256_of


def digests_of_inputs(config: RunConfig) -> dict[str, str]:
    """Path and sha256 of each file that ``config`` names; those that cannot be read are left out."""
    found = {}
    for name in _paths(config.model_dump(mode="json")):
        path = Path(name)
        if path.is_file():
            status = path.stat()
            found[name] = _digest(path, status.st_mtime_ns, status.st_size)
    return found


@functools.lru_cache(maxsize=1024)
def _digest(path: Path, _modified: int, _size: int) -> str:
    return sha256_of(path)


def _paths(node: Any) -> Iterator[str]:
    if isinstance(node, dict):
        for key, value in node.items():
            if key in ("path", "csv") and isinstance(value, str):
                yield value
            else:
                yield from _paths(value)
    elif isinstance(node, list):
        for value in node:
            yield from _paths(value)
