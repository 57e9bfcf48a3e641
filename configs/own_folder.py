"""Keeps what is written and deleted inside the folder that the user named: no part of a path below it may be a link."""

import contextlib
import os
import re
import secrets
import shutil
import socket
import stat
import time
from collections.abc import Iterator
from pathlib import Path

from huesphere.configs.errors import InputError

PARTIAL = ".partial"  # the ending of all temporary names
FORGOTTEN = 86_400.0  # seconds after which the temporary files of another machine count as abandoned
# A temporary name: a dot, the name that is to be replaced, host, process id, random digits, PARTIAL
_TEMPORARY = re.compile(r"(?P<head>\..*)\.(?P<pid>\d+)(\.[0-9a-f]{16})?\.partial", re.DOTALL)


def inside(folder: Path, *parts: str) -> Path:
    """The path ``folder``/part/part …, of which no part below ``folder`` is a link. The path need not exist.

    ``folder`` itself may be a link: the user named it. A part may hold several names, such as "config/transport".
    Raises InputError for a link, and for parts that would lead out of ``folder``.
    """
    path = folder
    for part in parts:
        names = part.split("/")
        if any(name in ("", ".", "..") or "\0" in name or len(os.fsencode(name)) > 255 for name in names):
            raise InputError("a path that leads out of the folder", got=repr(part)[:60], where=folder)
        for name in names:
            path = path / name
            if path.is_symlink():
                raise InputError("a link, which is not followed: it leads out of the folder", where=path)
    return path


def made_folder(folder: Path, *parts: str) -> Path:
    """``inside`` as a folder that exists. Raises InputError too where something else than a folder is in the way."""
    path = inside(folder, *parts)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise InputError("not a folder", expected="a folder to write into", where=path) from None
    return path


def temporary_name(path: Path) -> Path:
    """A path beside ``path`` that nobody can foretell, for a file or folder that is to replace it."""
    owner = f"{socket.gethostname()}.{os.getpid()}"
    kept = path.name.encode()[:100].decode(errors="ignore")
    return path.with_name(f".{kept}.{owner}.{secrets.token_hex(8)}{PARTIAL}")


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A new, empty file to write within the block; it replaces ``path`` at the end if no error is raised.

    So ``path`` never holds a part of a file, and a link at ``path`` is replaced rather than followed. Raises InputError
    where ``path`` is a folder, before anything is written.
    """
    if path.is_dir() and not path.is_symlink():
        raise InputError("a folder", expected="a file, or nothing, where a file is to be written", where=path)
    partial = temporary_name(path)
    os.close(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0), 0o666))
    try:
        yield partial
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file as a whole (`replacing`)."""
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8", errors="replace")  # file names may hold bytes that are no text


def remove_tree(path: Path) -> None:
    """Delete a folder with all in it, or a file. Links in it are deleted, and never what they lead to."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def folders_in(folder: Path) -> Iterator[Path]:
    """The folders in ``folder``, sorted by name, without links and without those whose name begins with a dot."""
    with contextlib.suppress(OSError):
        names = sorted(e.name for e in os.scandir(folder) if e.name[:1] != "." and e.is_dir(follow_symlinks=False))
        yield from (folder / name for name in names)


def remove_abandoned(folder: Path) -> None:
    """Delete temporary files and folders in ``folder`` (not below it) whose process no longer runs."""
    with contextlib.suppress(OSError):
        for entry in list(os.scandir(folder)):
            match = _TEMPORARY.fullmatch(entry.name)
            if match is None:
                continue
            ours = match["head"].endswith(f".{socket.gethostname()}")
            with contextlib.suppress(OSError):
                age = time.time() - entry.stat(follow_symlinks=False).st_mtime
                if not _runs(int(match["pid"])) if ours else age > FORGOTTEN:
                    remove_tree(Path(entry.path))


def _runs(pid: int) -> bool:
    """Whether a process of this machine with that id is running."""
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        return True
    with contextlib.suppress(OSError, IndexError):  # on Linux: a zombie, dead but not yet waited for
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return True


def is_private(folder: Path) -> bool:
    """Whether ``folder`` is a folder of this user that nobody else can write to. True on systems without user ids."""
    try:
        status = os.stat(folder, follow_symlinks=False)
    except OSError:
        return False
    if not hasattr(os, "geteuid"):
        return stat.S_ISDIR(status.st_mode)
    return stat.S_ISDIR(status.st_mode) and status.st_uid == os.geteuid() and not status.st_mode & 0o022
