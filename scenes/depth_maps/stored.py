"""What a depth map file holds, before it is decided which samples are surface and which way depth grows."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class StoredDepth:
    """The samples of a file, and what the file itself says of them."""

    samples: np.ndarray  # (H, W), row 0 at the top, of the type in which they are stored
    mask: np.ndarray | None = None  # (H, W) bool, where there is surface, if the file says so
    no_data: tuple[float, ...] = ()  # values that the file declares to be no data
    spacing: float | None = None  # distance of neighbouring samples in the unit of the depth, if the file states it
    # Whether values grow away from the camera, as in a renderer's Z; they are taken for depth along the camera's axis
    is_distance: bool = False
    said: tuple[str, ...] = ()  # remarks for the log about how the file was read
