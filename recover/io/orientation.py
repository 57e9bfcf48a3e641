"""Turns stored samples upright, as the orientation that cameras and programs write beside them says."""

import numpy as np

TURNED = {  # Exif 2.32, tag 274: what has to be done to the stored samples
    2: "mirrored left to right",
    3: "turned by 180°",
    4: "mirrored top to bottom",
    5: "mirrored about the diagonal",
    6: "turned by 90° clockwise",
    7: "mirrored about the other diagonal",
    8: "turned by 90° counter-clockwise",
}


def upright(image: np.ndarray, orientation: int) -> np.ndarray:
    """``image`` (H, W) or (H, W, C) turned upright; sides change places for orientations 5 to 8, as Exif numbers them.

    Numbers outside 1 to 8 mean nothing and leave the image as it is.
    """
    if orientation in (5, 6, 7, 8):
        image = np.swapaxes(image, 0, 1)
    if orientation in (2, 3, 6, 7):
        image = image[:, ::-1]
    if orientation in (3, 4, 7, 8):
        image = image[::-1]
    return image


def is_turned(orientation: int) -> bool:
    """Whether the number asks for something to be done."""
    return orientation in TURNED
