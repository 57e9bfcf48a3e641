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
from huesphere.configs.own_folder import folders_in, inside, remove_abandoned, replacing
from huesphere.configs.regular_file import MANIFEST_BYTES, RECORD_BYTES, check_regular, opened, read_text
from huesphere.render.exr import FORMAT_VERSION

PACKAGES = ("huesphere", "mitsuba", "drjit", "colour-science", "numpy", "scipy", "OpenEXR")
RECORD = "item.json"
OF_ITEMS = (RECORD, "observation.exr", "truth.exr")  # files that show that a folder is an item's
OPTIONAL_FILES = {"layers.exr": "--no-layers", "preview.png": "--no-previews"}  # and how `render` leaves them out
TRANSPORTS = ("linear", "direct", "one-bounce", "full")


def read_manifest(run: Path) -> dict[str, Any]:
    """The manifest of ``run``, completed by the records of items. Raises InputError if ``run`` is not a run folder."""
    if not run.is_dir():
        raise InputError("no such run folder", where=run)
    manifest = _collected(run)
    if not manifest["items"] and not (run / "manifest.json").exists() and not _cut_records(run):
        raise InputError("not a run folder: it has no manifest.json (made by `render --config …`)", where=run)
    return manifest


def _collected(run: Path) -> dict[str, Any]:
    """The manifest on disk, with the records of items that are missing in it or were written later."""
    path = run / "manifest.json"
    try:
        written = check_regular(path, most=MANIFEST_BYTES, follow=False).st_mtime_ns
        manifest = _parsed(run, path)
    except FileNotFoundError:
        manifest, written = empty_manifest(), -1
    return _with(manifest, _records(run, {str(item["id"]) for item in manifest["items"]}, written))


def _parsed(run: Path, path: Path) -> dict[str, Any]:
    """The manifest in the file ``path``. Raises InputError if it is damaged or has another format version."""
    try:
        manifest: dict[str, Any] = json.loads(read_text(path, most=MANIFEST_BYTES, follow=False))
        if manifest["format_version"] != FORMAT_VERSION:
            raise InputError("format_version", got=manifest["format_version"], expected=str(FORMAT_VERSION), where=path)
        for item in manifest["items"]:
            _check_entry(run, item)
        if not isinstance(manifest["items"], list) or not isinstance(manifest.get("versions", {}), dict):
            raise TypeError("items is to be a list, versions an object")
    except (InputError, FileNotFoundError):
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
    """The folder of an item, or the path of one of its files. Raises InputError for an id that is no path in the run.

    Such are an id that would lead out of the run folder, and one with a link in it.
    """
    if not isinstance(item_id, str):
        raise InputError("an item id that is no path", got=repr(item_id)[:60], where=run / "manifest.json")
    if any(name in ("", ".", "..") for name in item_id.split("/")):
        raise InputError("an item id that leads out of the run folder", got=item_id, where=run / "manifest.json")
    try:
        return inside(run, item_id)
    except (UnicodeEncodeError, OSError):
        raise InputError("an item id that is no path", got=repr(item_id)[:60], where=run / "manifest.json") from None


def empty_manifest() -> dict[str, Any]:
    """A manifest without items, with the versions of the programs in use."""
    return {"format_version": FORMAT_VERSION, "versions": _versions(), "items": []}


# ---- records -------------------------------------------------------------------------------------------------------


def read_record(run: Path, item_id: str) -> dict[str, Any] | None:
    """The record in the folder of an item; None if it is missing or damaged."""
    try:
        path = inside(run, item_id, RECORD)
        record: dict[str, Any] = json.loads(read_text(path, most=RECORD_BYTES, follow=False))
        _check_entry(run, record)
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    return record if record["id"] == item_id else None


def write_record(folder: Path, entry: dict[str, Any]) -> None:
    """Write ``entry`` as the record of the item in ``folder``."""
    (folder / RECORD).write_text(_json(entry), encoding="utf-8")


def _records(run: Path, known: set[str], written: int) -> list[dict[str, Any]]:
    """Records of items that are not ``known``, or were written after ``written``, the time stamp of the manifest.

    Raises InputError for a link, pipe or device in the place of a record.
    """
    found = []
    for folder in item_folders(run):
        item_id = folder.relative_to(run).as_posix()
        with contextlib.suppress(FileNotFoundError):
            status = check_regular(folder / RECORD, most=RECORD_BYTES, follow=False)
            if item_id not in known or status.st_mtime_ns > written:
                record = read_record(run, item_id)
                found += [record] if record is not None else []
    return found


def item_folders(run: Path) -> Iterator[Path]:
    """The folders <run>/<config>/<transport>, whatever they hold; links are not followed."""
    for config in folders_in(run):
        yield from folders_in(config)


def remove_remains(run: Path) -> None:
    """Remove the temporary files and folders of processes that no longer run, in the folders of the run itself."""
    remove_abandoned(run)
    for config in folders_in(run):
        remove_abandoned(config)
        for item in folders_in(config):
            remove_abandoned(item)
            if not (item / "estimates").is_symlink():
                remove_abandoned(item / "estimates")


def damaged_items(run: Path) -> dict[str, str]:
    """What is wrong with the record of each item whose folder is in ``run`` without a readable one, by id.

    A folder counts as an item's if it has the name of a level of transport, or one of the files of an item.
    """
    found = {}
    for folder in item_folders(run):
        item_id = folder.relative_to(run).as_posix()
        if _holds_item(folder) and read_record(run, item_id) is None:
            missing = not os.path.lexists(folder / RECORD)
            found[item_id] = "missing: an item's folder without a record" if missing else "a damaged record of an item"
    return found


def _cut_records(run: Path) -> bool:
    """Whether there are records in ``run`` that cannot be read: it is a run folder then."""
    return any(os.path.lexists(run / item_id / RECORD) for item_id in damaged_items(run))


def require_all_items(run: Path) -> None:
    """Raise InputError if there are items in ``run`` that are not in the manifest and have no readable record."""
    known = {item["id"] for item in read_manifest(run)["items"]}
    lost = {item_id: fault for item_id, fault in damaged_items(run).items() if item_id not in known}
    for item_id, fault in lost.items():
        more = f" (and {len(lost) - 1} more)" if len(lost) > 1 else ""
        raise InputError(f"{fault}; it is left out{more}", where=run / item_id / RECORD)


def _holds_item(folder: Path) -> bool:
    return folder.name in TRANSPORTS or any(os.path.lexists(folder / name) for name in OF_ITEMS)


# ---- writing -------------------------------------------------------------------------------------------------------


def put_items(run: Path, entries: Iterable[dict[str, Any]]) -> None:
    """Add or replace ``entries`` in the manifest on disk; entries that other processes have added are kept."""
    with _alone(run):
        manifest = _with(_collected(run), entries)
        if not manifest["items"]:
            return
        with replacing(run / "manifest.json") as partial:
            partial.write_text(_json(manifest), encoding="utf-8")


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
    """The sha256 of a regular file, in hexadecimal. Raises InputError for anything else, a link too, and OSError."""
    with opened(path, follow=False) as file:
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
