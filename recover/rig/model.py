"""The calibration of a rig, F(x) as a polynomial of position, and its file rig.json.

ρ(x) = F(x) n (report Eq. 6) with the matrix a function of the pixel's position, because lights are near. Where a
reference picture of the empty rig is divided out, ρ is the quotient of the two pictures in linear light, whose large
variation over the picture cancels. Position u = (x, y): pixels from the picture's middle over its half width, y up.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.own_folder import write_text
from huesphere.configs.regular_file import ESTIMATE_BYTES, read_text

FORMAT_VERSION = 1  # of rig.json
EXPONENTS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))  # of x and y, of the terms of F(x) in their order
TERMS = {0: 1, 1: 3, 2: 6}  # how many of them a constant, linear and quadratic F(x) has
ENCODINGS = ("linear", "srgb")


@dataclass(frozen=True)
class RigModel:
    """F(x) of a rig with what is known of its errors. Camera frame; ρ in linear light, or the quotient of two."""

    coefficients: np.ndarray  # (T, 3, 3): F(x, y) = Σ_t coefficients[t] x^a y^b, (a, b) = EXPONENTS[t]
    size: tuple[int, int]  # width, height of the camera's pictures, pixels
    divided: bool  # the picture is divided by a reference picture of the empty rig
    leave_one_out_deg: float  # median angular error on balls (one ball: sectors) that F was not fitted to
    error_deg: tuple[float, float]  # (a, b): RMS error √(a² + (b · tilt)²), degrees, tilt from the view axis
    noise: float  # standard deviation of a channel of ρ, as the calibration pictures show it
    spread: float  # 95th percentile of |log |F⁻¹ρ|| over the calibration's pixels: variation of brightness
    markers: bool  # the surface carries dark markers, which are to be interpolated
    encoding: str  # of the samples of the calibration pictures: "linear" or "srgb"
    date: str  # ISO 8601
    mm_per_px: float | None = None  # from the radius of a ball in millimetres
    balls: int = 1  # that it was fitted to
    places: tuple[tuple[float, float, float], ...] = ()  # x, y and radius of each of them, as of ``positions``

    @property
    def order(self) -> int:
        """0, 1 or 2: constant, linear or quadratic in position."""
        return {count: order for order, count in TERMS.items()}[len(self.coefficients)]

    def matrices(self) -> np.ndarray:
        """F (H, W, 3, 3) at every pixel."""
        return matrices_at(self.coefficients, positions(self.size))


def positions(size: tuple[int, int]) -> np.ndarray:
    """(H, W, 2) x right and y up of pixels of a picture of (width, height), from its middle over its half width."""
    width, height = size
    x = (np.arange(width) - (width - 1) / 2) / (width / 2)
    y = ((height - 1) / 2 - np.arange(height)) / (width / 2)
    return np.stack(np.meshgrid(x, y), axis=-1)


def terms(position: np.ndarray, count: int) -> np.ndarray:
    """(..., T) the first ``count`` terms x^a y^b of a polynomial at positions (..., 2)."""
    x, y = position[..., 0], position[..., 1]
    return np.stack([x**a * y**b for a, b in EXPONENTS[:count]], axis=-1)


def matrices_at(coefficients: np.ndarray, position: np.ndarray) -> np.ndarray:
    """F (..., 3, 3) at positions (..., 2)."""
    return np.einsum("...t,tij->...ij", terms(position, len(coefficients)), coefficients)


def write_rig(path: Path, rig: RigModel) -> None:
    """Write rig.json."""
    record = {
        "format_version": FORMAT_VERSION,
        "F": {"exponents": [list(e) for e in EXPONENTS[: len(rig.coefficients)]], "terms": rig.coefficients.tolist()},
        "size": list(rig.size),
        "divides_reference": rig.divided,
        "leave_one_out_deg": rig.leave_one_out_deg,
        "error_deg": list(rig.error_deg),
        "noise": rig.noise,
        "brightness_spread": rig.spread,
        "markers": rig.markers,
        "encoding": rig.encoding,
        "date": rig.date,
        "mm_per_px": rig.mm_per_px,
        "balls": rig.balls,
        "places": [list(place) for place in rig.places],
    }
    write_text(path, json.dumps(record, indent=1) + "\n")


def read_rig(path: Path) -> RigModel:
    """Read rig.json. Raises InputError where it is missing, of another format version, or damaged."""
    if not path.is_file():
        raise InputError("no such rig", where=path)
    try:
        record = json.loads(read_text(path, most=ESTIMATE_BYTES))
        version = record["format_version"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        got = f"{type(error).__name__}: {error}"
        raise InputError("not a rig", got=got, expected="a file made by recover --calibrate", where=path) from None
    if version != FORMAT_VERSION:
        raise InputError("format_version of a rig", got=version, expected=str(FORMAT_VERSION), where=path)
    try:
        return _rig_of(record)
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise InputError("a damaged rig", got=f"{type(error).__name__}: {error}", where=path) from None


def _rig_of(record: dict[str, Any]) -> RigModel:
    """The rig of its JSON. Raises ValueError, KeyError or TypeError."""
    coefficients = np.asarray(record["F"]["terms"], float)
    exponents = tuple(tuple(e) for e in record["F"]["exponents"])
    count = len(exponents)
    if count not in TERMS.values() or exponents != EXPONENTS[:count] or coefficients.shape != (count, 3, 3):
        raise ValueError(f"F of shape {coefficients.shape} with exponents {exponents}")
    width, height = (int(n) for n in record["size"])
    numbers = {n: float(record[n]) for n in ("leave_one_out_deg", "noise", "brightness_spread")}
    a, b = (float(v) for v in record["error_deg"])
    mm = record["mm_per_px"]
    places = tuple((float(x), float(y), float(r)) for x, y, r in record["places"])
    if not (np.isfinite(places).all() and all(r > 0 for _, _, r in places)):
        raise ValueError("places of balls that are not finite, or without a radius")
    every = [*numbers.values(), a, b, *([] if mm is None else [float(mm)])]
    if not (np.isfinite(coefficients).all() and all(math.isfinite(v) and v >= 0 for v in every)):
        raise ValueError("numbers that are negative or not finite")
    if not (0 < width <= 1 << 16 and 0 < height <= 1 << 16):
        raise ValueError(f"a size of {width}×{height} pixels")
    if record["encoding"] not in ENCODINGS:
        raise ValueError(f"encoding {record['encoding']!r}")
    return RigModel(
        coefficients=coefficients,
        size=(width, height),
        divided=bool(record["divides_reference"]),
        leave_one_out_deg=numbers["leave_one_out_deg"],
        error_deg=(a, b),
        noise=numbers["noise"],
        spread=numbers["brightness_spread"],
        markers=bool(record["markers"]),
        encoding=str(record["encoding"]),
        date=str(record["date"]),
        mm_per_px=None if mm is None else float(mm),
        balls=int(record["balls"]),
        places=places,
    )
