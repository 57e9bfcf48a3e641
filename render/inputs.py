"""The files that a config names (shapes, spectra): their contents, and how an item's config.yaml names them.

An item whose files have changed since it was rendered is not taken for finished (``render.item.entry_there``). Where
the files lie has no influence on what is rendered, nor on whether an item is taken for finished.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from huesphere.configs.file_paths import digest_of_file, is_file_key, portable_path, recorded_digests
from huesphere.configs.load import anchor_paths, read_yaml, validate
from huesphere.configs.own_folder import inside
from huesphere.configs.schema import RunConfig


def portable_config(config: RunConfig, run: Path, name: str) -> dict[str, Any]:
    """``config`` as the mapping that the config.yaml of the item ``name`` in ``run`` holds.

    Files that lie below the folder of the run folder are named relative to the item's folder, others absolutely.
    """
    run = run.resolve()
    return _with_files(config, lambda path: portable_path(path, run / name, run.parent))


def digests_of_inputs(config: RunConfig, run: Path, name: str) -> dict[str, str]:
    """sha256 of each file that ``config`` names, by its path in ``portable_config``; only those that exist."""
    absolute = file_names(config.model_dump(mode="json"))
    written = file_names(portable_config(config, run, name))
    digests = ((key, digest_of_file(path)) for (_, path), (_, key) in zip(absolute, written, strict=True))
    return {key: digest for key, digest in digests if digest is not None}


def read_item_config(folder: Path) -> RunConfig:
    """The config.yaml in an item's folder, with absolute paths. Raises InputError.

    Files that have moved together with the run folder are found (``configs.file_paths.mark_paths``).
    """
    path = inside(folder, "config.yaml")
    data, _ = read_yaml(path)
    return validate(anchor_paths(data, folder, recorded_digests(path)), where=path)


def content_of(config: RunConfig) -> dict[str, Any]:
    """``config`` as a mapping that is the same wherever its files lie: with the name and sha256 of each."""
    return _with_files(config, lambda path: [Path(path).name, digest_of_file(path) or path])


def content_text(config: RunConfig) -> str:
    """``content_of`` as text, by which configs are sorted."""
    return json.dumps(content_of(config))


def file_names(node: Any, place: str = "") -> Iterator[tuple[str, str]]:
    """(dotted key, value) of each file name in a config, in the order of the config."""
    if isinstance(node, dict):
        for key, value in node.items():
            dotted = f"{place}.{key}" if place else str(key)
            if is_file_key(key) and isinstance(value, str):
                yield dotted, value
            else:
                yield from file_names(value, dotted)
    elif isinstance(node, list):
        for number, value in enumerate(node):
            yield from file_names(value, f"{place}.{number}")


def _with_files(config: RunConfig, name_of: Any) -> dict[str, Any]:
    """``config`` as a mapping, with ``name_of`` each file name in place of the name."""

    def replaced(node: Any) -> Any:
        if isinstance(node, dict):
            return {
                key: name_of(value) if is_file_key(key) and isinstance(value, str) else replaced(value)
                for key, value in node.items()
            }
        return [replaced(value) for value in node] if isinstance(node, list) else node

    mapping: dict[str, Any] = replaced(config.model_dump(mode="json"))
    return mapping
