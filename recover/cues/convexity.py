"""Convex or concave: n and diag(−1, −1, 1) n are equally integrable, and the object's outline tells them apart.

At the outline of a solid the surface turns away from the camera, outward. So the image part of the normal, (n1, n2),
points down the slope of the blurred mask on the object and up it on its twin. In perspective the twins are not alike,
and where the picture tells them apart that is heard first.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

REACH = 0.15  # of the square root of the object's area: deviation of the blur
TOLD = 1.3  # times less curl, or misfit, than the twin's has: the perspective tells


@dataclass(frozen=True)
class TwinChoice:
    """Which of the two was taken, and how clearly."""

    flipped: bool  # the normals given were replaced by their twin
    margin: float  # 0 (no evidence) … 1 (every normal near the border testifies the same)
    evidence: (
        str  # "silhouette", "perspective", or "none: taken as convex" where the picture has no border of the object
    )


def choose_twin(normals: np.ndarray, valid: np.ndarray, mask: np.ndarray, *, ratio: float = 1.0) -> TwinChoice:
    """Whether the ``normals`` (H, W, 3), known where ``valid`` (H, W), should be flipped, from the outline of ``mask``.

    ``ratio``: how many times less curl or misfit they have than their twin; where it is clear they stay.
    Each pixel votes with the part of its normal that points out of the outline, blurred: steep pixels count and flat
    ones do not, those near the border more than those far off, and a pixel between two borders hardly at all. The
    pixels that see every light may well be none of those next to the border: hence so broad a blur. The edge of the
    picture is no outline. Where the mask fills the picture, normals are compared with the direction
    away from its middle instead: a bump is taken before a dent, with margin 0.
    """
    if ratio > TOLD:
        return TwinChoice(False, 1 - 1 / ratio, "perspective")
    row, column = np.mgrid[: mask.shape[0], : mask.shape[1]]
    if mask.all():
        middle_row, middle_column = row[valid].mean(), column[valid].mean()
        outward = np.stack([column - middle_column, middle_row - row], axis=-1)[valid]
        vote = float(np.sum(normals[valid][:, :2] * outward))
        return TwinChoice(bool(vote < 0), 0.0, "none: taken as convex")
    broad = ndimage.gaussian_filter(mask.astype(float), REACH * np.sqrt(mask.sum()), mode="nearest")
    down, right = np.gradient(broad)
    votes = np.sum(normals[valid][:, :2] * np.stack([-right, down], axis=-1)[valid], axis=-1)
    margin = float(votes.sum() / max(np.abs(votes).sum(), 1e-300))
    return TwinChoice(margin < 0, abs(margin), "silhouette")
