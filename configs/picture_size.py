"""Refuses pictures, arrays and archives that would not fit in memory, by what their headers declare, before decoding.

A few kilobytes of a compressed file can stand for gigabytes of samples.
"""

import math
import os
import zipfile
from pathlib import Path
from typing import Any

from huesphere.configs.errors import InputError
from huesphere.configs.regular_file import check_regular, opened

MOST_SAMPLES = 150_000_000  # of a picture with all its channels: 50 million pixels of three; 1.2 GB in double precision
MOST_CHANNEL_SAMPLES = 2**28  # of an OpenEXR file, whose channels are many: layers of the largest picture rendered
MOST_UNPACKED = 8 * MOST_SAMPLES  # bytes of all arrays of an archive
MOST_ENTRIES = 10_000  # of an archive
TEXT_BYTES = 128 * 2**20  # of a table of numbers as text
OTHER_PICTURES = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".gif", ".heic", ".heif", ".avif")


def require_size(path: Path) -> None:
    """Raise InputError unless ``path`` is a regular file, and what its header declares can be held in memory.

    Of a file that is damaged, or of a kind that is not known here, only the size on disk is looked at: whoever decodes
    it tells what is wrong. Raises OSError if there is no such file.
    """
    check_regular(path)
    suffix = path.suffix.lower()
    try:
        if suffix == ".npy":
            _require_samples(_samples_of_array(path), path)
        elif suffix in (".npz", ".zip", ".3mf"):
            require_unpacked_size(path)
        elif suffix in (".tif", ".tiff"):
            _require_samples(_samples_of_tiff(path), path)
        elif suffix == ".exr":
            import OpenEXR

            from huesphere.configs.quiet import silence

            with silence(), OpenEXR.File(os.fsencode(path), header_only=True) as head:
                require_exr_size(head, path)
        elif suffix in OTHER_PICTURES:
            _require_samples(_samples_of_picture(path), path)
        else:
            check_regular(path, most=TEXT_BYTES)
    except InputError:
        raise
    except Exception:  # each reader has errors of its own for damaged files
        return


def require_exr_size(head: Any, path: Path) -> None:
    """Raise InputError if the parts of an `OpenEXR.File`, as their headers declare them, have too many samples."""
    samples = 0
    for part in head.parts:
        (x0, y0), (x1, y1) = ((int(c) for c in corner) for corner in part.header["dataWindow"])
        samples += max(0, x1 - x0 + 1) * max(0, y1 - y0 + 1) * max(1, len(part.header.get("channels", ())))
    _require_samples(samples, path, MOST_CHANNEL_SAMPLES)


def require_unpacked_size(path: Path) -> None:
    """Raise InputError if the entries of a ZIP archive, such as an .npz, are too many or too large together."""
    with opened(path) as file, zipfile.ZipFile(file) as archive:
        entries = archive.infolist()
    if len(entries) > MOST_ENTRIES:
        raise InputError("an archive of too many entries", got=str(len(entries)), where=path)
    unpacked = sum(entry.file_size for entry in entries)
    if unpacked > MOST_UNPACKED:
        raise InputError(
            "an archive that unpacks to too much", got=f"{unpacked:,} bytes", expected=f"{MOST_UNPACKED:,}", where=path
        )


def _require_samples(samples: int, path: Path, most: int = MOST_SAMPLES) -> None:
    if samples > most:
        raise InputError(
            "too large a picture", got=f"{samples:,} samples", expected=f"at most {most:,} in all channels", where=path
        )


def _samples_of_array(path: Path) -> int:
    from numpy.lib import format as npy

    with opened(path) as file:
        version = npy.read_magic(file)
        shape, _, _ = (npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0)(file)
    return math.prod(shape)


def _samples_of_tiff(path: Path) -> int:
    import logging

    import tifffile

    logging.getLogger("tifffile").setLevel(logging.CRITICAL)  # whoever decodes the file tells what is wrong
    with tifffile.TiffFile(path) as file:
        return math.prod(file.series[0].shape)


def _samples_of_picture(path: Path) -> int:
    import warnings

    from PIL import Image

    with opened(path) as file, warnings.catch_warnings():
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        try:
            with Image.open(file) as picture:
                return picture.width * picture.height * len(picture.getbands()) * getattr(picture, "n_frames", 1)
        except Image.DecompressionBombError:
            got, expected = "more pixels than Pillow opens", f"at most {MOST_SAMPLES:,} samples in all channels"
            raise InputError("too large a picture", got=got, expected=expected, where=path) from None
