"""Writes picture files that say something of themselves: PNG chunks, colour profiles, raw mosaics, OpenEXR parts."""

import struct
import zlib
from fractions import Fraction
from pathlib import Path

import numpy as np
import OpenEXR
import tifffile


def smooth(height: int = 24, width: int = 32, low: float = 0.05, high: float = 0.9) -> np.ndarray:
    """A picture (H, W, 3) in linear light without symmetry: no turn or exchange of channels leaves it as it is."""
    y, x = np.mgrid[:height, :width] / np.array([height, width])[:, None, None]
    image = np.stack([0.7 * x + 0.3 * y, 0.2 + 0.6 * y * x, 0.9 - 0.5 * x - 0.3 * y**2], axis=-1)
    return low + (high - low) * image


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png_with(path: Path, samples: np.ndarray, *chunks: tuple[bytes, bytes]) -> None:
    """A PNG of uint8 or uint16 samples (H, W[, C]) with chunks between its header and its data."""
    height, width = samples.shape[:2]
    channels = 1 if samples.ndim == 2 else samples.shape[2]
    size = samples.dtype.itemsize
    rows = samples.astype(samples.dtype.newbyteorder(">")).view(np.uint8).reshape(height, -1)
    data = zlib.compress(b"".join(b"\0" + row.tobytes() for row in rows))
    head = struct.pack(">IIBBBBB", width, height, 8 * size, {1: 0, 2: 4, 3: 2, 4: 6}[channels], 0, 0, 0)
    between = b"".join(chunk(kind, content) for kind, content in chunks)
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + between + chunk(b"IDAT", data) + chunk(b"IEND", b""))


def exif_turned(orientation: int) -> bytes:
    """An Exif block with nothing but an orientation."""
    return b"MM\0*" + struct.pack(">IHHHIHHI", 8, 1, 0x0112, 3, 1, orientation, 0, 0)


def profile(curves: list[bytes], name: str = "Test") -> bytes:
    """An ICC profile of matrix and three curves."""
    text = name.encode() + b"\0"
    tags = {
        b"desc": b"desc\0\0\0\0" + struct.pack(">I", len(text)) + text + bytes(12 + 67),
        b"wtpt": b"XYZ \0\0\0\0" + struct.pack(">3i", 63190, 65536, 54061),
        b"rXYZ": b"XYZ \0\0\0\0" + struct.pack(">3i", 28576, 14580, 912),
        b"gXYZ": b"XYZ \0\0\0\0" + struct.pack(">3i", 25239, 46981, 6362),
        b"bXYZ": b"XYZ \0\0\0\0" + struct.pack(">3i", 9376, 3975, 46790),
        **dict(zip((b"rTRC", b"gTRC", b"bTRC"), curves)),
    }
    head, body = struct.pack(">I", len(tags)), b""
    start = 128 + 4 + 12 * len(tags)
    for tag, data in tags.items():
        data = data + bytes(-len(data) % 4)
        head += struct.pack(">4sII", tag, start + len(body), len(data))
        body += data
    size = start + len(body)
    about = struct.pack(">I4sI4s4s4s", size, b"lcms", 0x02400000, b"mntr", b"RGB ", b"XYZ ")
    about += struct.pack(">6H4s", 2026, 1, 1, 0, 0, 0, b"acsp") + bytes(28) + struct.pack(">3i", 63190, 65536, 54061)
    return about + bytes(128 - len(about)) + head + body


def gamma_curve(exponent: float) -> bytes:
    return b"curv\0\0\0\0" + struct.pack(">IH", 1, round(256 * exponent))


def table_curve(light: np.ndarray) -> bytes:
    return b"curv\0\0\0\0" + struct.pack(">I", len(light)) + np.round(65535 * light).astype(">u2").tobytes()


def parametric_curve(kind: int, *values: float) -> bytes:
    return (
        b"para\0\0\0\0"
        + struct.pack(">HH", kind, 0)
        + struct.pack(f">{len(values)}i", *(round(65536 * v) for v in values))
    )


def mosaic(light: np.ndarray, *, black: int = 64, white: int = 4095) -> np.ndarray:
    """What a sensor with the colour filters R G / G B sees of a picture (H, W, 3), full scale 1."""
    stored = np.round(black + light * (white - black)).clip(0, white).astype(np.uint16)
    seen = stored[..., 1].copy()
    seen[0::2, 0::2], seen[1::2, 1::2] = stored[0::2, 0::2, 0], stored[1::2, 1::2, 2]
    return seen


def write_dng(
    path: Path,
    samples: np.ndarray,
    *,
    black: int = 64,
    white: int = 4095,
    orientation: int = 1,
    neutral: tuple[float, float, float] = (0.5, 1.0, 0.625),
) -> None:
    """A DNG of an uncompressed mosaic; ``neutral``: the colour of white, from which a camera's balance follows."""
    fractions = [Fraction(v).limit_denominator(1000) for v in neutral]
    unit = sum(((int(v), 1) for v in np.eye(3).ravel()), ())
    tags = [
        (50706, "B", 4, (1, 4, 0, 0), True),  # DNGVersion
        (50707, "B", 4, (1, 1, 0, 0), True),
        (50708, "s", 0, "Test camera", True),
        (33421, "H", 2, (2, 2), True),  # the mosaic's cell
        (33422, "B", 4, (0, 1, 1, 2), True),
        (50710, "B", 3, (0, 1, 2), True),
        (50711, "H", 1, 1, True),
        (50714, "H", 1, black, True),
        (50717, "H", 1, white, True),
        (50721, "2i", 9, unit, True),  # ColorMatrix1
        (50778, "H", 1, 21, True),
        (50728, "2I", 3, sum(((f.numerator, f.denominator) for f in fractions), ()), True),  # AsShotNeutral
        (274, "H", 1, orientation, True),
    ]
    tifffile.imwrite(path, samples, photometric=32803, compression=None, extratags=tags, metadata=None)


def write_packed_tiff(path: Path, samples: np.ndarray, bits: int) -> None:
    """A TIFF of samples (H, W, 3) of 9 to 15 bits, packed without gaps, each row from a whole byte on."""
    height, width = samples.shape[:2]
    rows = (samples.reshape(height, -1, 1) >> np.arange(bits - 1, -1, -1)) & 1
    data = np.packbits(rows.reshape(height, -1).astype(np.uint8), axis=1).tobytes()
    entries = [(256, 4, 1, width), (257, 4, 1, height), (258, 3, 3, 8), (259, 3, 1, 1), (262, 3, 1, 2)]
    entries += [(273, 4, 1, 14), (277, 3, 1, 3), (278, 4, 1, height), (279, 4, 1, len(data)), (284, 3, 1, 1)]
    at = 14 + len(data) + len(data) % 2
    directory = struct.pack("<H", len(entries))
    for tag, kind, count, value in entries:
        directory += struct.pack("<HHII", tag, kind, count, value)
    head = struct.pack("<2sHI3H", b"II", 42, at, bits, bits, bits)
    path.write_bytes(head + data + bytes(len(data) % 2) + directory + bytes(4))


def exr_part(name: str, channels: dict[str, np.ndarray], **header: object) -> OpenEXR.Part:
    """A part of an OpenEXR file with channels (H, W)."""
    arrays = {key: np.ascontiguousarray(values, np.float32) for key, values in channels.items()}
    kind = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    return OpenEXR.Part({**kind, **header}, arrays, name)


def rgb_channels(image: np.ndarray, layer: str = "") -> dict[str, np.ndarray]:
    prefix = f"{layer}." if layer else ""
    return {f"{prefix}{c}": image[..., k] for k, c in enumerate("RGB")}
