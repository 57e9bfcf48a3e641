"""Opens and reads files that others may have put in place: regular files of bounded size, through no link if asked.

A pipe would make the reader wait for ever, a device would give bytes without end, and in a run folder a link would lead
out of it. So a file is opened only if it is a regular one, and its size is known before a byte is read.
"""

import contextlib
import os
import stat
from collections.abc import Iterator
from io import BufferedReader
from pathlib import Path

from huesphere.configs.errors import InputError

MiB = 2**20
CONFIG_BYTES = 4 * MiB  # of a config
RECORD_BYTES = 8 * MiB  # of the record of one item
MANIFEST_BYTES = 256 * MiB  # of a manifest; that of a hundred thousand items has 100 MB
ESTIMATE_BYTES = 64 * MiB  # of the JSON of one estimate
TABLE_BYTES = 16 * MiB  # of a spectral table
PICTURE_BYTES = 4096 * MiB  # of a picture, and of any other file whose checksum is computed


def check_regular(path: Path, *, most: int = PICTURE_BYTES, follow: bool = True) -> os.stat_result:
    """The status of the regular file at ``path``, which has at most ``most`` bytes.

    ``follow``: whether ``path`` itself may be a link. Raises InputError for a link that may not be followed, for
    anything but a regular file, and for one that is too large; OSError if there is no such file.
    """
    try:
        status = os.stat(path, follow_symlinks=follow)
    except ValueError as error:  # a path with a null character
        raise InputError(f"no path: {error}", where=str(path)) from None
    _require(status, path, most)
    return status


def _require(status: os.stat_result, path: Path, most: int) -> None:
    if stat.S_ISLNK(status.st_mode):
        raise InputError("a link, which is not followed", expected="a regular file", where=path)
    if not stat.S_ISREG(status.st_mode):
        raise InputError("not a file", got=_kind(status.st_mode), expected="a regular file", where=path)
    if status.st_size > most:
        raise InputError("too large a file", got=_size(status.st_size), expected=f"at most {_size(most)}", where=path)


@contextlib.contextmanager
def opened(path: Path, *, most: int = PICTURE_BYTES, follow: bool = True) -> Iterator[BufferedReader]:
    """The file at ``path``, open for reading within the block. Arguments and errors are those of `check_regular`."""
    check_regular(path, most=most, follow=follow)
    flags = os.O_RDONLY | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_NONBLOCK", 0)
    flags |= getattr(os, "O_BINARY", 0) | (0 if follow else getattr(os, "O_NOFOLLOW", 0))
    with os.fdopen(os.open(path, flags), "rb") as file:
        _require(os.fstat(file.fileno()), path, most)  # it may have been replaced since it was checked
        yield file


def read_bytes(path: Path, *, most: int, follow: bool = True) -> bytes:
    """The contents of the file at ``path``. Arguments and errors are those of `check_regular`."""
    with opened(path, most=most, follow=follow) as file:
        data = file.read(most + 1)  # some files of the system say that they are empty
    if len(data) > most:
        raise InputError("too large a file", expected=f"at most {_size(most)}", where=path)
    return data


def read_text(path: Path, *, most: int, follow: bool = True, encoding: str = "utf-8") -> str:
    """The text in the file at ``path``, with lines that end in a line feed.

    Arguments and errors are those of `check_regular`; raises UnicodeDecodeError too.
    """
    text = read_bytes(path, most=most, follow=follow).decode(encoding)
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _kind(mode: int) -> str:
    kinds = (
        (stat.S_ISDIR, "a folder"),
        (stat.S_ISFIFO, "a named pipe"),
        (stat.S_ISSOCK, "a socket"),
        (stat.S_ISCHR, "a device"),
        (stat.S_ISBLK, "a device"),
    )
    return next((name for test, name in kinds if test(mode)), "something else")


def _size(number: int) -> str:
    """A number of bytes as people read it."""
    for unit, name in ((2**30, "GiB"), (2**20, "MiB"), (2**10, "KiB")):
        if number >= unit:
            return f"{number / unit:.3g} {name}"
    return f"{number} bytes"
