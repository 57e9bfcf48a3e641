"""Verifies the files of a run folder: compares each with the sha256 in the manifest."""

from collections.abc import Iterator
from pathlib import Path

from huesphere.render.manifest import item_folder, read_manifest, sha256_of


def verified(run: Path) -> Iterator[tuple[str, str | None]]:
    """Yield (path in the run, fault or None) for each file in the manifest.

    Raises InputError for a damaged manifest, and for one that names files outside the run folder.
    """
    for item in read_manifest(run)["items"]:
        for file in item["files"]:
            yield file["path"], _fault(item_folder(run, file["path"]), file["sha256"])


def _fault(path: Path, sha256: str) -> str | None:
    try:
        return None if sha256_of(path) == sha256 else "not the file that was written: its sha256 differs"
    except FileNotFoundError:
        return "missing"
    except OSError as error:
        return f"cannot be read: {error.strerror}"
