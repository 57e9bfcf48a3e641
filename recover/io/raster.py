"""PNG, JPEG, WebP and BMP files, with what their chunks and tags say: orientation, transfer function, alpha, inks."""

import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.recover.io.icc import profile_name, profile_transfer
from huesphere.recover.io.stored import Stored, Transfer
from huesphere.recover.io.tiff import read_tiff
from huesphere.recover.io.transfer import h273, png_gamma, power, srgb

EXIF_IFD, INTEROPERABILITY_IFD = 0x8769, 0xA005
ORIENTATION, COLOUR_SPACE, GAMMA = 0x0112, 0xA001, 0xA500  # Exif 2.32
ADOBE_GAMMA = 563 / 256


def read_raster(path: Path) -> Stored:
    """A PNG, JPEG, WebP or BMP, or what Pillow finds in the file. Pillow's errors pass through."""
    from PIL import Image

    with Image.open(path) as picture:
        if picture.format == "TIFF":
            return read_tiff(path, None)
        stored = _samples(picture, path)
        orientation = orientation_of(picture.getexif())
        remarks = [] if getattr(picture, "n_frames", 1) == 1 or picture.format == "MPO" else ["the first of its frames"]
        transfer, said = _transfer(picture, path, 4 if stored.inks else 3)
        chromaticities = _chromaticities(picture.info.get("chromaticity"))
    return replace(
        stored,
        orientation=orientation,
        transfer=transfer,
        ambiguous=transfer is None and stored.bits == 16,
        chromaticities=chromaticities,
        remarks=(*remarks, *said),
    )


def orientation_of(exif: Any) -> int:
    """The orientation in Pillow's Exif record, 1 where there is none that means something."""
    number = exif.get(ORIENTATION, 1)
    return number if isinstance(number, int) and 1 <= number <= 8 else 1


def with_alpha(values: np.ndarray, bits: int) -> Stored:
    """Samples (H, W), or (H, W, C) whose last channel is alpha if C is 2 or 4."""
    full = 2.0**bits - 1
    if values.ndim == 3 and values.shape[2] in (2, 4):
        colours = values[..., 0] if values.shape[2] == 2 else values[..., :3]
        return Stored(colours, full, bits, alpha=values[..., -1] / full)
    return Stored(values, full, bits)


def _samples(picture: Any, path: Path) -> Stored:
    """The samples of an open picture as uint8 or uint16."""
    deep = colours_of_16_bits(picture, path)
    if deep is not None:
        return with_alpha(deep, 16)
    if picture.mode.startswith("I"):
        return with_alpha(np.asarray(picture).astype(np.uint16), 16)
    if picture.mode == "CMYK":
        return Stored(np.asarray(picture), 255.0, 8, inks=True)
    if picture.mode == "1":
        return with_alpha(np.asarray(picture.convert("L")), 8)
    if picture.mode in ("L", "LA"):
        return with_alpha(np.asarray(picture), 8)
    has_alpha = picture.mode in ("RGBA", "PA", "La", "RGBa") or "transparency" in picture.info
    return with_alpha(np.asarray(picture.convert("RGBA" if has_alpha else "RGB")), 8)


def colours_of_16_bits(picture: Any, path: Path) -> np.ndarray | None:
    """Samples (H, W, 3 or 4) uint16 of an open PNG of three or four channels of 16 bits; None for any other picture.

    Pillow has no RGB image of 16 bits: it keeps the high byte of each sample and drops the low one without a word. Its
    decoder can as well be asked for the samples' second bytes, so such a picture is decoded twice.
    """
    from PIL import Image

    if picture.format != "PNG" or not picture.tile or not str(picture.tile[0].args).endswith(";16B"):
        return None
    if not picture.mode.startswith("RGB"):
        return None
    high = np.asarray(picture)
    with Image.open(path) as again:
        again.tile = [tile._replace(args=str(tile.args).replace(";16B", ";16L")) for tile in again.tile]
        low = np.asarray(again)
    return high.astype(np.uint16) << 8 | low


def _transfer(picture: Any, path: Path, channels: int) -> tuple[Transfer | None, list[str]]:
    """(the transfer function that the file names, what it says and is not obeyed); in the order of PNG, 4.3."""
    info, remarks = picture.info, list[str]()
    if picture.format == "PNG" and channels == 3 and (words := _chunk(path, b"cICP")) is not None and len(words) == 4:
        found = of_code_points(words[1], bool(words[3]), 8 if picture.mode in ("L", "P") else 16, "its cICP")
        if found is not None:
            return found, remarks
        remarks.append(f"its cICP names transfer function {words[1]}, which is not obeyed")
    profile = info.get("icc_profile")
    if profile:
        found = profile_transfer(profile, channels)
        if found is not None:
            return found, remarks
        remarks.append(f"its colour profile {profile_name(profile)!r} is not obeyed")
    if channels == 4:
        return None, remarks
    if "srgb" in info:
        return srgb("its sRGB chunk"), remarks
    if "gamma" in info:
        found = png_gamma(float(info["gamma"]), _chromaticities(info.get("chromaticity")), "its gAMA")
        if found is not None:
            return found, remarks
        remarks.append(f"its gAMA of {float(info['gamma']):.4g} is not obeyed")
    return _of_exif(picture.getexif()), remarks


def of_code_points(code: int, full_range: bool, bits: int, source: str) -> Transfer | None:
    """The transfer function of ITU-T H.273; samples of narrow range run from 16 to 235 of 255."""
    found = h273(code, source)
    if found is None or full_range:
        return found
    decode, scale = found.decode, 2.0 ** (bits - 8)
    full = 2.0**bits - 1
    return Transfer(
        f"{found.name}, narrow range", source, lambda v: decode(np.clip((v * full / scale - 16) / 219, 0.0, 1.0))
    )


def _of_exif(exif: Any) -> Transfer | None:
    """What Exif says of the transfer function: sRGB, Adobe RGB, or a power."""
    inner = exif.get_ifd(EXIF_IFD)
    space = inner.get(COLOUR_SPACE)
    if space == 1:
        return srgb("its Exif")
    if space == 2 or exif.get_ifd(INTEROPERABILITY_IFD).get(1) == "R03":
        return power(ADOBE_GAMMA, "its Exif, Adobe RGB")
    gamma = inner.get(GAMMA)
    try:
        return None if gamma is None else power(float(gamma), "its Exif")
    except (TypeError, ValueError, ZeroDivisionError):
        return None


def _chromaticities(numbers: Any) -> tuple[float, ...] | None:
    """CIE x, y of red, green, blue and white (8 numbers); None where ``numbers`` are not eight.

    ``numbers``: a PNG's chunk cHRM as Pillow gives it, in which white stands first.
    """
    if not isinstance(numbers, tuple) or len(numbers) != 8:
        return None
    return (*(float(v) for v in numbers[2:]), float(numbers[0]), float(numbers[1]))


def _chunk(path: Path, wanted: bytes) -> bytes | None:
    """The data of a PNG's first chunk of that name, before its picture data; None if there is none."""
    with path.open("rb") as file:
        file.seek(8)
        while len(head := file.read(8)) == 8:
            length, name = struct.unpack(">I4s", head)
            if name == b"IDAT":
                return None
            if name == wanted:
                if length > 1 << 16:
                    raise InputError(f"a chunk {wanted.decode()} of {length} bytes", where=path)
                return file.read(length)
            file.seek(length + 4, 1)
    return None
