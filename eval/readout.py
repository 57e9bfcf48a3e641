"""Packs the numbers of an image as text, for the read-out of pixels on the HTML page.

A megabyte of float32 for each result would make the page too large. So each number is packed in two bytes with the
digits that the page shows: components with a fixed number of decimals, angles with four significant digits. Of these
codes the differences from pixel to pixel are taken in raster order; all high bytes and then all low bytes are
compressed by zlib and written in base64. templates/page.js unpacks them, in functions of the same names.
"""

import base64
import zlib
from dataclasses import dataclass

import numpy as np

NOT_A_NUMBER = -32768  # code of NaN in ``pack_fixed``
TOO_SMALL = 65535  # code of angles below 10^SMALLEST_DECADE in ``pack_degrees``
SMALLEST_DECADE = -4
TO_FOUR_DIGITS = np.array([1e7, 1e6, 1e5, 1e4, 1e3, 1e2, 1e1])  # 10^(3−e), from the smallest decade up


@dataclass(frozen=True)
class Fixed:
    """Packed numbers of an image (H, W, K)."""

    text: str
    decimals: int  # the packed integers are the numbers times 10^decimals


def pack_fixed(image: np.ndarray, decimals: int) -> Fixed:
    """Pack numbers (H, W, K) rounded to ``decimals``, or to fewer if the largest would not fit into 16 bits."""
    values = np.moveaxis(image, -1, 0).astype(np.float64, order="C")  # one component after the other
    unknown = ~np.isfinite(values)
    values[unknown] = 0.0
    largest = max(float(values.max(initial=0.0)), -float(values.min(initial=0.0)))
    while decimals > 0 and largest * 10**decimals > 32767:
        decimals -= 1
    values *= 10**decimals
    code = np.rint(values, out=values).clip(-32767, 32767, out=values).astype(np.int16)
    code[unknown] = NOT_A_NUMBER
    return Fixed(_packed(code.view(np.uint16)), decimals)


def pack_degrees(image: np.ndarray) -> str:
    """Pack angles (H, W) in degrees with four significant digits.

    An angle is written as m · 10^(e−3) with 1000 ≤ m ≤ 9999 and −4 ≤ e ≤ 2. Its code is 9000 (e + 4) + m − 999; 0 is
    the code of NaN.
    """
    code = np.zeros(image.size, dtype=np.uint16)
    known = np.flatnonzero(np.isfinite(image))
    code[known] = _degrees_code(image.ravel()[known].astype(np.float64))
    return _packed(code)


def pack_codes(image: np.ndarray) -> str:
    """Pack whole numbers (H, W) from 0 to 65535, such as the codes of ``recover.reasons``."""
    return _packed(image.astype(np.uint16))


def _degrees_code(v: np.ndarray) -> np.ndarray:
    """The codes of ``pack_degrees`` for finite angles (N,)."""
    small = v < 10.0**SMALLEST_DECADE
    v = np.where(small, 1.0, v)
    e = np.floor(np.log10(v)).astype(np.intp)
    m = np.rint(v * TO_FOUR_DIGITS[e - SMALLEST_DECADE]).astype(np.intp)
    e, m = np.where(m >= 10000, e + 1, e), np.where(m >= 10000, 1000, m)
    return np.where(small, TOO_SMALL, 9000 * (e - SMALLEST_DECADE) + m - 999).astype(np.uint16)


def _packed(code: np.ndarray) -> str:
    """Return uint16 codes of any shape as base64 of zlib of (all high bytes, all low bytes) of raster differences."""
    code = code.ravel()
    difference = code.copy()
    difference[1:] -= code[:-1]  # modulo 65536, as is the sum by which the page unpacks them
    planes = difference.astype("<u2").view(np.uint8).reshape(-1, 2).T[::-1]
    return base64.b64encode(zlib.compress(planes.tobytes(), 3)).decode("ascii")
