"""Numbers of a picture's pixels packed as text, so that the page's read-out shows what the EXR holds.

A page cannot carry a megabyte of float32 for each result. It carries each number as it will be shown: components to a
fixed number of decimals, angles to four significant digits, two bytes each; as differences along the raster, high bytes
apart from low ones, deflated, in base64. The page undoes it in templates/page.js, functions of the same names.
"""

import base64
import zlib
from dataclasses import dataclass

import numpy as np

NOT_A_NUMBER = -32768  # in fixed-point code
TOO_SMALL = 65535  # in degrees' code: below 0.0001
SMALLEST_DECADE = -4


@dataclass(frozen=True)
class Fixed:
    """(H, W, K) numbers to ``decimals`` decimals."""

    text: str
    decimals: int


def pack_fixed(image: np.ndarray, decimals: int) -> Fixed:
    """Pack (H, W, K) numbers rounded to ``decimals``, or to as many as leave the largest below 3.2767 · 10^k."""
    largest = float(np.nanmax(np.abs(image), initial=0.0, where=np.isfinite(image)))
    while decimals > 0 and largest * 10**decimals > 32767:
        decimals -= 1
    known = np.isfinite(image)
    scaled = np.rint(np.where(known, image, 0.0).astype(np.float64) * 10**decimals).clip(-32767, 32767)
    code = np.where(known, scaled, NOT_A_NUMBER).astype(np.int16)
    return Fixed(_packed(np.moveaxis(code, -1, 0).view(np.uint16)), decimals)


def pack_degrees(image: np.ndarray) -> str:
    """Pack (H, W) angles to four significant digits.

    With v = m · 10^(e−3), 1000 ≤ m ≤ 9999 and −4 ≤ e ≤ 2, the code is 9000 (e + 4) + m − 999; 0 stands for NaN.
    """
    v = np.where(np.isfinite(image), image, 1.0).astype(np.float64)
    small = v < 10.0**SMALLEST_DECADE
    v = np.where(small, 1.0, v)
    e = np.floor(np.log10(v))
    m = np.rint(v / 10.0 ** (e - 3))
    e, m = np.where(m >= 10000, e + 1, e), np.where(m >= 10000, 1000, m)
    code = 9000 * (e - SMALLEST_DECADE) + m - 999
    code = np.where(small, TOO_SMALL, code)
    return _packed(np.where(np.isfinite(image), code, 0).astype(np.uint16))


def _packed(code: np.ndarray) -> str:
    """Return uint16 codes of any shape as base64 of zlib of (all high bytes, all low bytes) of raster differences."""
    difference = np.diff(code.ravel(), prepend=np.uint16(0)).astype(np.uint16)  # wraps around, and so does its undoing
    planes = np.stack([difference >> 8, difference & 255]).astype(np.uint8)
    return base64.b64encode(zlib.compress(planes.tobytes(), 3)).decode("ascii")
