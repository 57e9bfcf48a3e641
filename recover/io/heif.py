"""HEIC and AVIF files, as phones write them: all bits of their samples, upright, with their transfer function."""

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.recover.io.axes import check_size
from huesphere.recover.io.icc import profile_name, profile_transfer
from huesphere.recover.io.raster import of_code_points, orientation_of, with_alpha
from huesphere.recover.io.stored import Stored, Transfer
from huesphere.recover.io.transfer import srgb

HEIC, AVIF = (".heic", ".heif", ".hif"), (".avif",)
INSTALL = "pip install 'huesphere[photo]'"


def read_heic(path: Path) -> Stored:
    """The primary picture of a HEIC file. Its own turns are applied by the decoder, so none is left to be done."""
    try:
        import pillow_heif
    except ImportError:
        expected = f"the package pillow-heif, which reads it: {INSTALL}"
        raise InputError("a HEIC picture", got=path.suffix, expected=expected, where=path) from None
    file = pillow_heif.open_heif(path, convert_hdr_to_8bit=False)
    check_size(8 * file.size[0] * file.size[1], path)
    values = np.asarray(file)
    bits = 8
    if values.dtype == np.uint16:  # moved up to 16 bits by the decoder
        bits = int(file.info.get("bit_depth", 16))
        values = values >> (16 - bits)
    words = file.info.get("nclx_profile") or {}
    code = int(words.get("transfer_characteristics", 2))
    transfer, remarks = _transfer(file.info.get("icc_profile"), code)
    return replace(with_alpha(values, bits), transfer=transfer, remarks=tuple(remarks))


def read_avif(path: Path) -> Stored:
    """The picture of an AVIF file. Pillow tells what is said of it; its samples of over 8 bits need imagecodecs."""
    from PIL import Image

    data = path.read_bytes()
    with Image.open(path) as picture:
        check_size(8 * picture.size[0] * picture.size[1], path)
        orientation = orientation_of(picture.getexif())
        profile = picture.info.get("icc_profile")
        eight_bits = np.asarray(picture.convert("RGBA" if "A" in picture.getbands() else "RGB"))
    transfer, remarks = _transfer(profile, _code_point(data))
    values, bits = eight_bits, 8
    try:
        import imagecodecs

        decoded = np.asarray(imagecodecs.avif_decode(data))
    except ImportError:
        remarks.append("its first 8 bits, for want of the package imagecodecs")
    else:
        if decoded.dtype == np.uint16 and decoded.ndim == 3:
            values, bits = decoded, _depth(data)
    stored = with_alpha(values, bits)
    return replace(stored, orientation=orientation, transfer=transfer, remarks=tuple(remarks))


def _transfer(profile: bytes | None, code: int) -> tuple[Transfer, list[str]]:
    """The transfer function by a colour profile, or by a code point of ITU-T H.273, or sRGB; and what is not obeyed."""
    remarks = []
    if profile:
        found = profile_transfer(profile, 3)
        if found is not None:
            return found, []
        remarks.append(f"its colour profile {profile_name(profile)!r} is not obeyed")
    found = of_code_points(code, True, 8, "its colour box nclx")  # decoders widen a narrow range themselves
    return found or srgb("its kind of file"), remarks


def _depth(data: bytes) -> int:
    """Bits of a sample by the box ``av1C`` of an AVIF file of over 8 bits (AV1 in ISO base media files, 2.3.3)."""
    at = data.find(b"av1C", 0, 1 << 16)
    return 12 if 0 <= at < len(data) - 6 and data[at + 6] & 0x20 else 10


def _code_point(data: bytes) -> int:
    """The transfer function in the box ``colr`` of kind ``nclx`` near the beginning of a file; 2 says nothing."""
    at = data.find(b"colrnclx", 0, 1 << 16)
    return 2 if at < 0 or at + 14 > len(data) else int(struct.unpack_from(">HHH", data, at + 8)[1])
