"""Verifies a run folder: each file against the sha256 in the manifest, each item for its record and its files."""

import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from huesphere.configs.errors import InputError
from huesphere.configs.regular_file import check_regular
from huesphere.render.manifest import OPTIONAL_FILES, RECORD, damaged_items, item_folder, read_manifest, sha256_of

NEEDED = ("observation.exr", "truth.exr")  # files that every finished item has


def verified(run: Path) -> Iterator[tuple[str, str | None]]:
    """Yield (path in the run, fault or None) for each file in the manifest, and for each other thing that is damaged.

    Damaged are also an item's folder without a readable record, and a finished item of which the manifest lacks files.
    Raises InputError for a damaged manifest, for one that names files outside the run folder, and for a run folder
    that holds no items.
    """
    items = read_manifest(run)["items"]
    known = {item["id"] for item in items}
    for item_id, fault in damaged_items(run).items():
        if item_id not in known or os.path.lexists(run / item_id / RECORD):  # the manifest alone may describe an item
            yield f"{item_id}/{RECORD}", fault
    for item in items:
        names = {str(file["path"]).rpartition("/")[2] for file in item["files"]}
        missing = [name for name in NEEDED if name not in names]
        if item["status"] == "done" and missing:
            what = ", ".join(missing) if item["files"] else "any file"
            yield str(item["id"]), f"a finished item without {what} in the manifest"
        for file in item["files"]:
            yield file["path"], _fault(run, file)


def left_out(run: Path) -> dict[str, int]:
    """How many finished items were made without each of the files that `render` can leave out; only where some were."""
    items = [item for item in read_manifest(run)["items"] if item["status"] == "done"]
    counts = {name: sum(name in item.get("left_out", ()) for item in items) for name in OPTIONAL_FILES}
    return {name: count for name, count in counts.items() if count}


def _fault(run: Path, file: dict[str, Any]) -> str | None:
    """What is wrong with a file of the manifest, or None. It is read only if it has the size that it should have."""
    path = item_folder(run, file["path"])
    try:
        size = check_regular(path, most=sys.maxsize, follow=False).st_size
        if size == file.get("bytes", size) and sha256_of(path) == file["sha256"]:
            return None
        return "not the file that was written: its sha256 or size differs"
    except FileNotFoundError:
        return "missing"
    except InputError as error:
        return str(error).removeprefix(f"{path}: ")
    except OSError as error:
        return f"cannot be read: {error.strerror}"
