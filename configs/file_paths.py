"""File names in configs: what they are relative to, ``~`` and ``$VARIABLE``, and what is the same wherever files lie.

A path is relative to the folder of the config that it is written in, or on the command line to the current folder. The
same config and files give the same data wherever they lie: names and seeds are made of the path as it was written and
of the file's contents, never of the absolute path.
"""

import functools
import hashlib
import json
import os
import re
from collections.abc import Callable, Mapping
from pathlib import Path, PurePath
from typing import Any

from huesphere.configs.errors import InputError
from huesphere.configs.regular_file import opened

KEYS = ("path", "csv")  # the only keys of a config whose values are file names
RECORD = "item.json"  # beside the config.yaml of an item; has the sha256 of the files that the config names
MOST_RECORD_BYTES = 4_000_000
MOST_FILES = 4096  # of a folder whose contents are compared
MOST_FOLDERS = 12  # folders above a config in which a file that has moved is looked for, and names of its path


class PathAsWritten(str):
    """A file name as it is written in a config, with its ``absolute`` path."""

    absolute: str

    def __new__(cls, written: str, absolute: str = "") -> "PathAsWritten":
        path = super().__new__(cls, written)
        path.absolute = absolute
        return path

    def __getnewargs__(self) -> tuple[str, str]:  # type: ignore[override]
        return str(self), self.absolute

    @property
    def label(self) -> str:
        """The path without what depends on a place: as it is written, or the file's name if that is absolute."""
        path = PurePath(os.path.normpath(str(self)))
        return path.name if path.is_absolute() else path.as_posix()

    @property
    def identity(self) -> list[str]:
        """``label`` and the sha256 of the contents, which are the same wherever the file lies."""
        return ["file", self.label, digest_of_file(self.absolute) or ""]


def is_file_key(key: object) -> bool:
    """Whether the values of a key of a config, dotted or not, are file names."""
    return str(key).rpartition(".")[2] in KEYS


def mark_paths(node: Any, folder: Path, digests: Mapping[str, str] | None = None) -> None:
    """Replace each file name in ``node``, part of a config, by a PathAsWritten, in place; also those in a sweep.

    ``folder`` is what relative ones are relative to. ``digests`` has the sha256 of files by their name as written: one
    that is not there is looked for near ``folder``, and taken if its contents are the same. Raises InputError for a
    variable that is not set.
    """
    if isinstance(node, dict):
        for key, value in node.items():
            if is_file_key(key):
                node[key] = _marked(value, folder, digests or {})
            else:
                mark_paths(value, folder, digests)
    elif isinstance(node, list):
        for value in node:
            mark_paths(value, folder, digests)


def _marked(value: Any, folder: Path, digests: Mapping[str, str]) -> Any:
    if isinstance(value, PathAsWritten):
        return value
    if isinstance(value, str) and "\0" not in value:
        place = absolute_path(value, folder)
        if value in digests and not (place.is_file() or place.is_dir()):
            place = _found_again(value, folder, digests[value]) or place
        return PathAsWritten(value, str(place))
    if isinstance(value, list):
        return [_marked(one, folder, digests) for one in value]
    return {key: _marked(one, folder, digests) for key, one in value.items()} if isinstance(value, dict) else value


def absolute_path(written: str, folder: Path = Path()) -> Path:
    """The absolute path of a file, relative to ``folder`` and ``expanded``. Links are followed but for the file's own.

    So a file keeps the name by which the user knows it. Raises InputError as ``expanded`` does.
    """
    place = folder / expanded(_for_the_system(written), folder)
    return place.resolve() if place.name in ("", "..") else place.parent.resolve() / place.name


def _for_the_system(written: str) -> str:
    """``written`` as Python has names of files, also where the system's encoding has no such letters (locale C)."""
    try:
        os.fsencode(written)
    except UnicodeEncodeError:
        return os.fsdecode(written.encode("utf-8", "surrogatepass"))
    return written


def make_absolute(node: Any) -> Any:
    """``node`` with an absolute path in place of every PathAsWritten."""
    return _with_paths(node, lambda path: path.absolute)


def without_place(node: Any) -> Any:
    """``node`` with its ``identity`` in place of every PathAsWritten: a function of content alone."""
    return _with_paths(node, lambda path: path.identity)


def _with_paths(node: Any, value_of: Callable[[PathAsWritten], Any]) -> Any:
    """``node`` with ``value_of`` every PathAsWritten in its place."""
    if isinstance(node, PathAsWritten):
        return value_of(node)
    if isinstance(node, dict):
        return {key: _with_paths(value, value_of) for key, value in node.items()}
    if isinstance(node, list | tuple):
        return [_with_paths(value, value_of) for value in node]
    return node


def expanded(written: str, folder: Path = Path()) -> str:
    """``written`` with a leading ``~`` or ``~user`` and each ``$VARIABLE`` or ``${VARIABLE}`` replaced.

    A file that is called just that, relative to ``folder``, is meant as it is. Raises InputError for a variable that is
    not set and for a user who is not known.
    """
    if (not written.startswith("~") and "$" not in written) or _exists(folder / written):
        return written
    home = os.path.expanduser(written)
    if home.startswith("~"):
        raise InputError("no home folder of this user", got=written.split("/")[0], where=written)
    missing = [
        one or two for one, two in re.findall(r"\$(?:(\w+)|\{([^}]*)\})", home) if (one or two) not in os.environ
    ]
    if missing:
        raise InputError(
            f"the variable {missing[0]} is not set", expected="a path, or its name without $", where=written
        )
    return os.path.expandvars(home)


def _exists(path: Path) -> bool:
    try:
        return os.path.lexists(path)
    except ValueError:  # a null character
        return False


# ---- contents --------------------------------------------------------------------------------------------------------


def digest_of_file(path: str | Path) -> str | None:
    """The sha256 of a file, in hexadecimal; None if there is no such file or it cannot be read.

    That of a folder is computed from the names and sha256 of the files in it, without folders in the folder.
    """
    try:
        status = os.stat(path)
        if os.path.isdir(path):
            return _digest_of_folder(Path(path))
        if not os.path.isfile(path):
            return None
        return _digest(str(path), status.st_mtime_ns, status.st_size)
    except (OSError, ValueError, InputError):
        return None


def _digest_of_folder(folder: Path) -> str | None:
    """sha256 of a line for each file of ``folder``, its name and its sha256; None if there are too many files."""
    names = sorted(entry.name for entry in os.scandir(folder) if entry.is_file() and not entry.name.startswith("."))
    if len(names) > MOST_FILES:
        return None
    lines = (f"{name} {digest_of_file(folder / name)}\n" for name in names)
    return hashlib.sha256("".join(lines).encode("utf-8", "surrogateescape")).hexdigest()


@functools.lru_cache(maxsize=4096)
def _digest(path: str, _modified: int, _size: int) -> str:
    """sha256 of a file; time and size are arguments so that the cache holds only while the file does not change."""
    with opened(Path(path)) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def recorded_digests(config: Path) -> dict[str, str]:
    """sha256 of the files that an item's ``config`` names, by their name as written there; {} if it is no item's."""
    path = config.with_name(RECORD)
    try:
        if not path.is_file() or path.stat().st_size > MOST_RECORD_BYTES:
            return {}
        inputs = json.loads(path.read_text(encoding="utf-8"))["inputs"]
        return {str(name): str(digest) for name, digest in inputs.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return {}


def _found_again(written: str, folder: Path, digest: str) -> Path | None:
    """The file of these contents, where a run folder, or all that it was made from, has moved.

    The last names of the path (the file, its folder …) are looked for in ``folder`` and the folders above it.
    """
    names = [name for name in PurePath(written).parts if name not in ("..", "/")][-MOST_FOLDERS:]
    for above in list(folder.resolve().parents)[:MOST_FOLDERS]:
        for first in range(len(names)):
            place = above.joinpath(*names[first:])
            if digest_of_file(place) == digest:
                return place
    return None


def portable_path(path: str, folder: Path, near: Path) -> str:
    """How a file is written in a config that is to lie in ``folder``: relative to it if the file is below ``near``.

    So a project that moves as a whole stays whole; a file from elsewhere keeps its absolute path.
    """
    absolute, root = os.path.abspath(path), os.path.abspath(near)
    if root == os.sep or os.path.commonpath([absolute, root]) != root:
        return absolute
    return PurePath(os.path.relpath(absolute, folder)).as_posix()
