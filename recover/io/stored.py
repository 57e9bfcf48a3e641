"""What a picture file holds: its samples as stored, and what the file itself says of them."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from huesphere.render.dataset import Observation


@dataclass(frozen=True)
class ReadOptions:
    """What a user says of a picture file beyond its path: which part of it, frames to correct it by, its levels."""

    part: str | None = None  # of a file of several pictures: name, or number from 0
    layer: str | None = None  # of an OpenEXR part: the prefix of its channels, such as "ViewLayer.Combined"
    dark: Path | None = None  # a picture taken with the lens covered, which is subtracted
    flat: Path | None = None  # a picture of an evenly lit white surface, by which the picture is divided
    white_level: float | None = None  # stored value at and above which a sample is clipped
    half_size: bool = False  # raw files: each 2×2 cell of the mosaic is one pixel, and nothing is interpolated
    white_balance: str = "none"  # raw files: "none", or "camera" for the factors that the camera chose


@dataclass(frozen=True)
class Transfer:
    """A transfer function: how stored samples of full scale 1 become linear light of full scale 1."""

    name: str  # "linear", "sRGB", "gamma 2.2" …
    source: str  # who says so: "its gAMA", "its colour profile 'Adobe RGB (1998)'"
    decode: Callable[[np.ndarray], np.ndarray]  # (H, W, C) to (H, W, 3); C is 4 only for inks

    @property
    def linear(self) -> bool:
        """Whether the samples are linear as they stand."""
        return self.name == "linear"


@dataclass(frozen=True)
class Stored:
    """Samples of a picture file as they are stored, in the order in which the sensor or the program wrote them."""

    values: np.ndarray  # (H, W) or (H, W, C): whole numbers as stored, or floating point
    full_scale: float | None = None  # stored value of full scale; None: floating point, whose full scale is 1
    bits: int | None = None  # that whole numbers have; None: floating point
    alpha: np.ndarray | None = None  # (H, W) full scale 1, coverage
    premultiplied: bool = False  # colours are multiplied by alpha
    mask: np.ndarray | None = None  # (H, W) any kind of number: the object, if the file has a mask
    mask_name: str = "its mask"  # what the mask is, for the log
    orientation: int = 1  # Exif's number, 1 to 8: how the samples are to be turned to stand upright
    transfer: Transfer | None = None  # None: the file does not say how its samples are encoded
    ambiguous: bool = False  # such files are as often linear as display-encoded, and this one does not say which
    certain: bool = False  # nothing can be wrong about the transfer function: of raw files, and of this project's own
    inks: bool = False  # four channels of a print, not three of light; `transfer` turns them into light
    chromaticities: tuple[float, ...] | None = None  # CIE x, y of red, green, blue and white, if the file gives them
    remarks: tuple[str, ...] = ()  # what was found in the file and done with it, a few words each
    observation: Observation | None = None  # of a file that this project wrote: everything is known
