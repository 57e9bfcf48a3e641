"""The manifest of a run folder, manifest.json: its items with their status, and the sha256 of each of their files.

Each item's folder also has its own entry in a file item.json, its *record*, which appears together with the item's
other files. The manifest collects the entries. If it is missing, or incomplete because a run was killed, the missing
entries are read from the records.
"""

import contextlib
import hashlib
import importlib.metadata
import json
import os
import platform
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from huesphere.configs.errors import InputError
from huesphere.render.exr import FORMAT_VERSION

PACKAGES = ("huesphere", "mitsuba", "drjit", "colour-science", "numpy", "scipy", "OpenEXR")
RECORD = "item.json"


def read_manifest(run: Path) -> dict[str, Any]:
    """The manifest of ``run``, completed by the records of items. Raises InputError if ``run`` is not a run folder."""
    if not run.is_dir():
        raise InputError("no such run folder", where=run)
    manifest = _collected(run)
    if not manifest["items"] and not (run / "manifest.json").is_file():
        raise InputError("not a run folder: it has no manifest.json (made by `render --config …`)", where=run)
    return manifest


def _collected(run: Path) -> dict[str, Any]:
    """The manifest on disk, with the records of items that are missing in it or were written later."""
    path = run / "manifest.json"
    if path.is_file():
        manifest, written = _parsed(run, path), path.stat().st_mtime_ns
    else:
        manifest, written = empty_manifest(), -1
    return _with(manifest, _records(run, {str(item["id"]) for item in manifest["items"]}, written))


def _parsed(run: Path, path: Path) -> dict[str, Any]:
    """The manifest in the file ``path``. Raises InputError if it is damaged or has another format version."""
    try:
        manifest: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if manifest["format_version"] != FORMAT_VERSION:
            raise InputError("format_version", got=manifest["format_version"], expected=str(FORMAT_VERSION), where=path)
        for item in manifest["items"]:
            _check_entry(run, item)
    except InputError:
        raise
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(
            "a damaged manifest",
            got=f"{type(error).__name__}: {error}; without it, it is made of the items",
            where=path,
        ) from None
    return manifest


def _check_entry(run: Path, item: Any) -> None:
    """Raise InputError, KeyError or TypeError for an entry that is incomplete or points outside the run folder."""
    item_folder(run, item["id"])
    if not isinstance(item["status"], str) or not isinstance(item["files"], list):
        raise TypeError(f"item {item['id']}")
    for file in item["files"]:
        item_folder(run, file["path"])
        _ = file["sha256"]


def item_folder(run: Path, item_id: str) -> Path:
    """The folder of an item. Raises InputError for an id that would lead out of the run folder."""
    if not isinstance(item_id, str) or "\0" in item_id or max(map(len, item_id.encode().split(b"/"))) > 255:
        raise InputError("an item id that is no path", got=repr(item_id)[:60], where=run / "manifest.json")
    folder = (run / item_id).resolve()
    if not folder.is_relative_to(run.resolve()) or folder == run.resolve():
        raise InputError("an item id that leads out of the run folder", got=item_id, where=run / "manifest.json")
    return run / item_id


def empty_manifest() -> dict[str, Any]:
    """A manifest without items, with the versions of the programs in use."""
    return {"format_version": FORMAT_VERSION, "versions": _versions(), "items": []}


# ---- records -------------------------------------------------------------------------------------------------------


def read_record(run: Path, item_id: str) -> dict[str, Any] | None:
    """The record in the folder of an item; None if it is missing or damaged."""
    try:
        record: dict[str, Any] = json.loads((run / item_id / RECORD).read_text(encoding="utf-8"))
        _check_entry(run, record)
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    return record if record["id"] == item_id else None


def write_record(folder: Path, entry: dict[str, Any]) -> None:
    """Write ``entry`` as the record of the item in ``folder``."""
    (folder / RECORD).write_text(_json(entry), encoding="utf-8")


def _records(run: Path, known: set[str], written: int) -> list[dict[str, Any]]:
    """Records of items that are not ``known``, or were written after ``written``, the time stamp of the manifest."""
    found = []
    for path in run.glob(f"[!.]*/[!.]*/{RECORD}"):
        item_id = path.parent.relative_to(run).as_posix()
        if item_id not in known or path.stat().st_mtime_ns > written:
            record = read_record(run, item_id)
            found += [record] if record is not None else []
    return found


# ---- writing -------------------------------------------------------------------------------------------------------


def put_items(run: Path, entries: Iterable[dict[str, Any]]) -> None:
    """Add or replace ``entries`` in the manifest on disk; entries that other processes have added are kept."""
    with _alone(run):
        manifest = _with(_collected(run), entries)
        if not manifest["items"]:
            return
        partial = run / f".manifest.json.{os.getpid()}.partial"
        try:
            partial.write_text(_json(manifest), encoding="utf-8")
            os.replace(partial, run / "manifest.json")
        finally:
            partial.unlink(missing_ok=True)


def _with(manifest: dict[str, Any], entries: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """``manifest`` with ``entries`` added, or put in the place of those with the same id; in order of ids."""
    by_id = {item["id"]: item for item in manifest["items"]} | {entry["id"]: entry for entry in entries}
    return {**manifest, "items": [by_id[key] for key in sorted(by_id)]}


@contextlib.contextmanager
def _alone(run: Path) -> Iterator[None]:
    """Lock the manifest against other processes within the block; without effect on systems without file locks."""
    try:
        import fcntl
    except ImportError:
        yield
        return
    folder = os.open(run, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):
            fcntl.flock(folder, fcntl.LOCK_EX)
        yield
    finally:
        os.close(folder)


def _json(data: dict[str, Any]) -> str:
    return json.dumps(data, indent=1, sort_keys=True) + "\n"  # in ASCII: a file name may hold bytes that are no text


def describe_files(folder: Path, prefix: str) -> list[dict[str, str | int]]:
    """Path (``prefix``/name), sha256 and size in bytes of each file of an item except its record."""
    files = sorted(path for path in folder.iterdir() if path.is_file() and not path.name.startswith("."))
    return [
        {"path": f"{prefix}/{path.name}", "sha256": sha256_of(path), "bytes": path.stat().st_size}
        for path in files
        if path.name != RECORD
    ]


def sha256_of(path: Path) -> str:
    """The sha256 of a file, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _versions() -> dict[str, str]:
    """Versions of Python and of the installed PACKAGES."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found
