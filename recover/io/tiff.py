"""TIFF files, with what their tags say: axes, orientation, transfer function, alpha, inks, inversion, palettes."""

import logging
from pathlib import Path
from typing import Any

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.recover.io.axes import check_size, colours_last
from huesphere.recover.io.icc import profile_name, profile_transfer
from huesphere.recover.io.stored import Stored, Transfer
from huesphere.recover.io.transfer import power, srgb, table

ORIENTATION, MAXIMUM, TRANSFER_FUNCTION, SOFTWARE = 274, 281, 301, 305
EXIF, PROFILE, WHITE_LEVEL = 34665, 34675, 50717
MIN_IS_WHITE, PALETTE, SEPARATED, YCBCR, MOSAIC, LINEAR_RAW = 0, 3, 5, 6, 32803, 34892
READ = (MIN_IS_WHITE, 1, 2, PALETTE, 4, SEPARATED, YCBCR, LINEAR_RAW)
JPEG_KINDS = (6, 7, 34892, 33007)  # compressions whose decoder turns YCbCr into RGB
PREMULTIPLIED, STRAIGHT = 1, 2  # values of ExtraSamples that mean alpha; 0 says nothing of the channel
INSTALL = "pip install imagecodecs"


def is_mosaic(path: Path) -> bool:
    """Whether a TIFF file holds raw samples of a sensor's mosaic, which a raw converter has to read."""
    import tifffile

    with tifffile.TiffFile(path) as file:
        if len(file.pages) == 0:
            raise InputError("a TIFF without a picture", where=path)
        return _number(file.pages[0], "photometric") == MOSAIC


def read_tiff(path: Path, part: str | None) -> Stored:
    """The picture in a TIFF file; of several pictures the one that ``part`` names by its number. Raises InputError."""
    import tifffile

    logging.getLogger("tifffile").setLevel(logging.CRITICAL)  # what it cannot read is told by its exception
    with tifffile.TiffFile(path) as file:
        series = [s for s in file.series if not s.keyframe.is_reduced] or list(file.series)
        if part is None and len(series) > 1:
            largest = max(s.size for s in series)
            series = [s for s in series if s.size == largest]
        chosen = _chosen(series, part, path)
        page = chosen.keyframe
        photometric = _number(page, "photometric")
        if photometric not in READ:
            raise InputError("a kind of TIFF that is not read", got=f"photometric {_named(page)}", where=path)
        if photometric == YCBCR and int(page.compression) not in JPEG_KINDS:
            raise InputError("a kind of TIFF that is not read", got="uncompressed YCbCr", where=path)
        check_size(chosen.size * chosen.dtype.itemsize, path)
        try:
            values = chosen.asarray()
        except ValueError as error:
            if "imagecodecs" not in str(error):
                raise
            got = f"compression {getattr(page.compression, 'name', page.compression)}"
            expected = f"the package imagecodecs, which reads it: {INSTALL}"
            raise InputError("a compressed TIFF", got=got, expected=expected, where=path) from None
        if len(series) == 1 and _pictures_of(chosen) > 1:
            values = values.reshape(-1, *values.shape[-3:])[int(part or 0)]
            return _stored(values, page, photometric)
        return _stored(colours_last(values, chosen.axes, path), page, photometric)


def _chosen(series: list[Any], part: str | None, path: Path) -> Any:
    """The series of pages that is the picture."""
    if not series:
        raise InputError("a TIFF without a picture", where=path)
    count = len(series) if len(series) > 1 else _pictures_of(series[0])
    if part is not None:
        if not part.isdigit() or int(part) >= count:
            raise InputError("--part", got=part, expected=f"a number from 0 to {count - 1}", where=path)
        return series[int(part)] if len(series) > 1 else series[0]
    if count > 1:
        raise InputError(f"a file of {count} pictures", expected=f"--part, a number from 0 to {count - 1}", where=path)
    return series[0]


def _pictures_of(series: Any) -> int:
    """How many pictures in colour a series of equal pages holds, if their colours are the last axis; else 1."""
    if series.ndim > 3 and series.axes.endswith("YXS"):
        return int(np.prod(series.shape[:-3]))
    return 1


def _stored(values: np.ndarray, page: Any, photometric: int) -> Stored:
    """The samples, channels last, with what the tags of ``page`` say of them."""
    remarks: list[str] = []
    whole = values.dtype in (bool, np.uint8, np.uint16)
    bits = _bits(page, values) if whole else None
    full = None if bits is None else _full_scale(page, bits)
    if bits is not None and full is not None and full < 2.0**bits - 1:
        remarks.append(f"full scale {full:g}, as its tags say")
    if photometric == PALETTE and whole and values.ndim == 2 and page.colormap is not None:
        colours = np.moveaxis(np.asarray(page.colormap), 0, -1)
        if colours.max() > 255 and not (colours & 255).any():  # most programs move entries of 8 bits up
            colours = colours >> 8
        values, bits = colours[np.minimum(values, len(colours) - 1)], 16 if colours.max() > 255 else 8
        full = 2.0**bits - 1
    if photometric == MIN_IS_WHITE and whole and full is not None and not _of_bools(page, values):
        values = (full - values.astype(np.float64)).astype(values.dtype if values.dtype.kind == "u" else np.uint8)
        remarks.append("black and white exchanged, as its tags say")
    inks = photometric == SEPARATED
    colour_channels = 1 if values.ndim == 2 else {SEPARATED: 4}.get(photometric, 3 if values.shape[2] >= 3 else 1)
    alpha, premultiplied = _alpha(values, colour_channels, page, full, remarks)
    if values.ndim == 3:
        values = values[..., :colour_channels] if colour_channels > 1 else values[..., 0]
    transfer = _transfer(page, 4 if inks else 3, remarks)
    return Stored(
        values,
        full,
        bits,
        alpha=alpha,
        premultiplied=premultiplied,
        orientation=_orientation(page),
        transfer=transfer,
        ambiguous=transfer is None and bits is not None and bits > 8,
        inks=inks,
        remarks=tuple(remarks),
    )


def _of_bools(page: Any, values: np.ndarray) -> bool:
    """Whether tifffile wrote an array of bools: it tags them as inverted, and they are not."""
    return values.dtype == bool and str(_tag(page, SOFTWARE) or "").startswith("tifffile")


def _bits(page: Any, values: np.ndarray) -> int:
    """Bits that are used of each sample."""
    told = page.bitspersample
    told = told[0] if isinstance(told, tuple) else told
    return int(told) if isinstance(told, int) and 0 < told <= 16 else 8 * values.dtype.itemsize


def _full_scale(page: Any, bits: int) -> float:
    """The stored value of full scale: of the number of bits, or less where a tag gives a largest value."""
    full = 2.0**bits - 1
    for tag in (WHITE_LEVEL, MAXIMUM):
        value = _tag(page, tag)
        value = min(value) if isinstance(value, tuple) and value else value
        if isinstance(value, int) and bits > 8 and 255 < value < full:
            return float(value)
    return full


def _alpha(
    values: np.ndarray, colours: int, page: Any, full: float | None, remarks: list[str]
) -> tuple[np.ndarray | None, bool]:
    """(alpha of full scale 1, whether colours are multiplied by it) of the channels after those of colour."""
    extra = values.shape[2] - colours if values.ndim == 3 else 0
    kinds = [int(kind) for kind in page.extrasamples or ()]
    if extra <= 0:
        return None, False
    for k in range(min(extra, len(kinds))):
        if kinds[k] in (PREMULTIPLIED, STRAIGHT):
            return values[..., colours + k] / (full or 1.0), kinds[k] == PREMULTIPLIED
    remarks.append(f"{extra} further channel{'s' * (extra > 1)} not used, of which the file does not say what they are")
    return None, False


def _transfer(page: Any, channels: int, remarks: list[str]) -> Transfer | None:
    """The transfer function that the tags name; what they say and is not obeyed is added to ``remarks``."""
    profile = _tag(page, PROFILE)
    if isinstance(profile, bytes | tuple) and len(profile) > 0:
        profile = bytes(profile)
        found = profile_transfer(profile, channels)
        if found is not None:
            return found
        remarks.append(f"its colour profile {profile_name(profile)!r} is not obeyed")
    if channels == 4:
        return None
    entries = _tag(page, TRANSFER_FUNCTION)
    if isinstance(entries, tuple | np.ndarray) and len(entries) > 2:
        light = np.asarray(entries, float) / 65535
        count = len(light) // 3 if len(light) in (3 << 8, 3 << 16) else len(light)
        return table(light if count == len(light) else light.reshape(3, count).T, "its tag TransferFunction")
    exif = _tag(page, EXIF)
    if isinstance(exif, dict):
        if exif.get("ColorSpace") == 1:
            return srgb("its Exif")
        gamma = exif.get("Gamma")
        if isinstance(gamma, tuple) and len(gamma) == 2 and gamma[1]:
            return power(gamma[0] / gamma[1], "its Exif")
    return None


def _orientation(page: Any) -> int:
    number = _tag(page, ORIENTATION)
    return int(number) if isinstance(number, int) and 1 <= int(number) <= 8 else 1


def _tag(page: Any, code: int) -> Any:
    """The value of a tag; None where there is none, or none that can be read."""
    try:
        tag = page.tags.get(code)
        return None if tag is None else tag.value
    except Exception:  # tifffile reads values late, and raises what damaged ones provoke
        return None


def _number(page: Any, name: str) -> int:
    value = getattr(page, name)
    return -1 if value is None else int(value)


def _named(page: Any) -> str:
    return str(getattr(page.photometric, "name", page.photometric))
