"""Which reader reads which file: by the ending of its name."""

import warnings
from pathlib import Path

from huesphere.configs.errors import InputError
from huesphere.configs.picture_size import require_size
from huesphere.recover.io import camera_raw, heif
from huesphere.recover.io.camera_raw import read_camera_raw
from huesphere.recover.io.exr_picture import read_exr_picture
from huesphere.recover.io.heif import read_avif, read_heic
from huesphere.recover.io.numpy_file import read_arrays
from huesphere.recover.io.raster import read_raster
from huesphere.recover.io.stored import ReadOptions, Stored
from huesphere.recover.io.tiff import is_mosaic, read_tiff

TIFF, RASTER = (".tif", ".tiff"), (".png", ".jpg", ".jpeg", ".webp", ".bmp")
TIFF_BEGINS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
READABLE = (*RASTER, *TIFF, ".exr", ".npy", ".npz", *heif.HEIC, *heif.AVIF, *camera_raw.SUFFIXES)


def read_stored(path: Path, options: ReadOptions) -> Stored:
    """The samples of a picture file as stored, with what the file says of them.

    Raises InputError for a file that cannot be read, and for an option that its kind of file does not know.
    """
    suffix = path.suffix.lower()
    if suffix not in READABLE:
        raise InputError(
            "a kind of picture that is not read", got=path.suffix, expected=", ".join(READABLE), where=path
        )
    try:
        require_size(path)
        stored = _read(path, suffix, options)
        if 0 in stored.values.shape:
            got = f"an array of shape {stored.values.shape}"
            raise InputError("not a picture", got=got, expected="rows of pixels", where=path)
        return stored
    except InputError:
        raise
    except MemoryError:
        raise InputError("a picture too large for the memory", where=path) from None
    except Exception as error:  # readers of pictures raise types of their own
        raise InputError(
            "not a readable picture", got=f"{type(error).__name__}: {str(error)[:80]}", where=path
        ) from None


def _read(path: Path, suffix: str, options: ReadOptions) -> Stored:
    """The samples of a file with that ending. Errors of the readers pass through, their warnings do not."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if suffix in TIFF and not _begins(path).startswith(TIFF_BEGINS):
            suffix = RASTER[0]  # of another kind than its name says: Pillow finds out
        raw = suffix in camera_raw.SUFFIXES or (suffix in TIFF and is_mosaic(path))
        _check_options(options, path, raw=raw, parts=suffix in (".exr", *TIFF), layers=suffix == ".exr")
        if raw:
            return read_camera_raw(path, options)
        if suffix == ".exr":
            return read_exr_picture(path, options)
        if suffix in (".npy", ".npz"):
            return read_arrays(path)
        if suffix in TIFF:
            return read_tiff(path, options.part)
        if suffix in heif.HEIC:
            return read_heic(path)
        return read_avif(path) if suffix in heif.AVIF else read_raster(path)


def _begins(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(4)


def _check_options(options: ReadOptions, path: Path, *, raw: bool, parts: bool, layers: bool) -> None:
    """Raise InputError for an option that means nothing for this kind of file."""
    if options.part is not None and (raw or not parts):
        raise InputError("--part is for OpenEXR and TIFF files of several pictures", got=path.suffix, where=path)
    if options.layer is not None and not layers:
        raise InputError("--layer is for OpenEXR files", got=path.suffix, where=path)
    if options.half_size and not raw:
        raise InputError("--half-size is for cameras' own (raw) files", got=path.suffix, where=path)
    if options.white_balance != "none" and not raw:
        raise InputError("--white-balance is for cameras' own (raw) files", got=path.suffix, where=path)
