"""manifest.json: which items a run folder holds, what became of them, and the sha256 of each of their files."""

import hashlib
import importlib.metadata
import json
import os
import platform
from pathlib import Path
from typing import Any

from configs.errors import InputError
from render.dataset import FORMAT_VERSION

PACKAGES = ("huesphere", "mitsuba", "drjit", "colour-science", "numpy", "scipy", "OpenEXR")


def read_manifest(run: Path) -> dict[str, Any]:
    """The manifest of ``run``. Raises InputError if there is none or it is damaged."""
    path = run / "manifest.json"
    if not run.is_dir():
        raise InputError("no such run folder", where=run)
    if not path.is_file():
        raise InputError("not a run folder: it has no manifest.json (made by `render --config …`)", where=run)
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
        if manifest["format_version"] != FORMAT_VERSION:
            raise InputError("format_version", got=manifest["format_version"], expected=str(FORMAT_VERSION), where=path)
        for item in manifest["items"]:
            item_folder(run, item["id"])
            _ = item["status"], item["files"]
    except InputError:
        raise
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError("a damaged manifest", got=f"{type(error).__name__}: {error}", where=path) from None
    return manifest


def item_folder(run: Path, item_id: str) -> Path:
    """The folder of an item. Raises InputError for an id that would lead out of the run folder."""
    folder = (run / item_id).resolve()
    if not folder.is_relative_to(run.resolve()) or folder == run.resolve():
        raise InputError("an item id that leads out of the run folder", got=item_id, where=run / "manifest.json")
    return run / item_id


def empty_manifest() -> dict[str, Any]:
    return {"format_version": FORMAT_VERSION, "versions": _versions(), "items": []}


def put_item(run: Path, manifest: dict[str, Any], item: dict[str, Any]) -> None:
    """Add or replace ``item`` in the manifest and write it: all of it or nothing."""
    others = [old for old in manifest["items"] if old["id"] != item["id"]]
    manifest["items"] = sorted([*others, item], key=lambda entry: entry["id"])
    partial = run / ".manifest.json.partial"
    partial.write_text(json.dumps(manifest, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    os.replace(partial, run / "manifest.json")


def describe_files(run: Path, folder: Path) -> list[dict[str, str]]:
    """Path (relative to the run) and sha256 of each file of an item; its estimates are no part of it."""
    files = sorted(path for path in folder.iterdir() if path.is_file() and not path.name.startswith("."))
    return [
        {"path": path.relative_to(run).as_posix(), "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
        for path in files
    ]


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found
