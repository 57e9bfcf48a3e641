"""Reads and writes OpenEXR files with named float channels and a JSON header, the format of all pictures of a run."""

import errno
import json
import os
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

from huesphere.configs.errors import InputError
from huesphere.configs.own_folder import replacing
from huesphere.configs.picture_size import require_exr_size
from huesphere.configs.quiet import silence
from huesphere.configs.regular_file import opened

HEADER_KEY = "huesphere"
CHECKSUM = "crc32"  # key in the header of every picture that this project writes
# Errors of the operating system that mean that the file cannot be written there
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EACCES)
MANY_VALUES = 10_000_000  # in a file from which compression on several threads takes less time than to start them
FORMAT_VERSION = 1  # of a run folder: in the manifest and in the header of every picture


def write_exr(
    path: Path,
    channels: dict[str, np.ndarray],
    header: dict[str, Any] | None = None,
    *,
    chromaticities: tuple[float, ...] | None = None,
) -> None:
    """Write ``channels`` (arrays (H, W) by name, stored as float32) and a ``header`` that JSON can write.

    ``chromaticities``: CIE x, y of red, green, blue and white, for the attribute by which viewers show colours.

    The file is written under a temporary name and renamed, so that ``path`` never holds a part of it. Raises ValueError
    for channels of different shapes, OSError if the file cannot be written.
    """
    arrays = {name: np.ascontiguousarray(values, dtype=np.float32) for name, values in channels.items()}
    shapes = {a.shape for a in arrays.values()}
    if len(shapes) != 1 or len(next(iter(shapes))) != 2:
        raise ValueError(f"{path}: channels must be 2-D and of one shape, got {sorted(shapes)}")
    attributes: dict[str, Any] = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    if chromaticities is not None:
        attributes["chromaticities"] = tuple(float(v) for v in chromaticities)
    if header is not None:
        attributes[HEADER_KEY] = json.dumps(header | {CHECKSUM: _checksum(arrays)}, sort_keys=True)
    with replacing(path) as partial, _threads(sum(a.size for a in arrays.values())):
        try:
            OpenEXR.File(attributes, arrays).write(os.fsencode(partial))  # OpenEXR refuses text that is not Unicode
        except RuntimeError as error:  # OpenEXR has no error of its own for a full disk
            number = next((n for n in NO_ROOM if os.strerror(n) in str(error)), errno.EIO)
            raise OSError(number, os.strerror(number), str(path)) from None


@contextmanager
def _threads(values: int) -> Iterator[None]:
    """Let OpenEXR compress so many ``values`` on all processors, where they are many; the file is the same."""
    before = OpenEXR.global_thread_count()
    if values > MANY_VALUES:
        OpenEXR.set_global_thread_count(os.cpu_count() or 1)
    try:
        yield
    finally:
        OpenEXR.set_global_thread_count(before)


def read_exr(path: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Read (channels (H, W) by name, header) of an OpenEXR file; the header is {} if another program wrote the file.

    Raises InputError if the file is missing, is not a readable OpenEXR picture, or is too large.
    """
    with damage_told(path), open_exr(path) as file:
        channels = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
        header = json.loads(file.header().get(HEADER_KEY, "{}"))
    if not channels or any(c.ndim != 2 for c in channels.values()) or len({c.shape for c in channels.values()}) > 1:
        raise InputError("not a flat OpenEXR picture with 2-D channels of one size", where=path)
    if not isinstance(header, dict):
        raise InputError(f"the {HEADER_KEY!r} header is not an object", where=path)
    if header.pop(CHECKSUM, None) not in (None, _checksum(channels)):
        raise InputError("a damaged picture: its pixels are not those that were written", where=path)
    return channels, header


@contextmanager
def damage_told(path: Path) -> Iterator[None]:
    """Make an InputError of whatever OpenEXR raises for the file at ``path``; its errors have no class in common."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        text = str(error).replace(str(path), path.name)[:120] or type(error).__name__
        raise InputError("not a readable OpenEXR picture", got=text, where=path) from None


@contextmanager
def open_exr(path: Path) -> Iterator[Any]:
    """An `OpenEXR.File` with a channel for each name, read from ``path`` if its header declares no more than is read.

    Raises InputError as `read_exr` does, and whatever OpenEXR raises for a damaged file.
    """
    try:
        with opened(path) as file, silence():
            # The file that was checked, even if another one has its name by now
            same = f"/proc/self/fd/{file.fileno()}"
            name = same if os.path.exists(same) else os.fsencode(path)
            with OpenEXR.File(name, header_only=True) as head:
                require_exr_size(head, path)
            with OpenEXR.File(name, separate_channels=True) as picture:
                yield picture
    except FileNotFoundError:
        raise InputError("no such picture", where=path) from None
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror or error}", where=path) from None


def _checksum(channels: dict[str, np.ndarray]) -> int:
    """CRC-32 of the samples, with channels in the order of their names. OpenEXR has none for uncompressed data."""
    total = 0
    for name in sorted(channels):
        total = zlib.crc32(channels[name].tobytes(), zlib.crc32(name.encode(), total))
    return total
