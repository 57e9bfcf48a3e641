"""The convex/concave ambiguity: n and its twin diag(−1, −1, 1) n are equally integrable; the silhouette decides.

At the silhouette of a solid the surface turns away from the camera, outward. So the image part of the normal, (n1, n2),
points down the slope of the blurred mask in the right solution and up the slope in the twin. In perspective only one of
the two solutions is integrable; where that is clear it decides before the silhouette does.
"""

from dataclasses import dataclass

import numpy as np

from huesphere.recover.cues.parameters import CUES
from huesphere.recover.cues.silhouette import outward


@dataclass(frozen=True)
class TwinChoice:
    """Which of the two solutions is to be taken, and how clear the evidence is."""

    flipped: bool  # the normals given are to be replaced by their twin
    margin: float  # 0 (no evidence) … 1 (all normals agree)
    evidence: str  # "silhouette", "perspective", or "none: taken as convex" where the picture shows no silhouette


def choose_twin(normals: np.ndarray, valid: np.ndarray, mask: np.ndarray, *, ratio: float = 1.0) -> TwinChoice:
    """Whether ``normals`` (H, W, 3), known where ``valid`` (H, W), should be replaced by their twin.

    ``mask`` (H, W): the object. ``ratio``: curl, or residual, of the twin over that of ``normals``; from
    ``perspective_ratio`` on they are kept without asking the silhouette. Each pixel votes with the part of its normal
    that points down the slope of the blurred mask: steep pixels count and flat ones do not, pixels near the border
    count more than those far from it, and a pixel midway between two borders hardly counts. The blur is broad because
    the valid pixels need not touch the border. The edge of the picture is no silhouette: where the mask fills the
    picture the normals are compared with the direction away from the middle of the valid pixels, so that a bump is
    preferred to a dent, with margin 0.
    """
    if ratio > CUES.perspective_ratio:
        return TwinChoice(False, 1 - 1 / ratio, "perspective")
    row, column = np.mgrid[: mask.shape[0], : mask.shape[1]]
    if mask.all():
        middle_row, middle_column = row[valid].mean(), column[valid].mean()
        from_middle = np.stack([column - middle_column, middle_row - row], axis=-1)[valid]
        vote = float(np.sum(normals[valid][:, :2] * from_middle))
        return TwinChoice(bool(vote < 0), 0.0, "none: taken as convex")
    margin = outward_margin(normals, valid, mask)
    return TwinChoice(margin < 0, abs(margin), "silhouette")


def outward_margin(normals: np.ndarray, valid: np.ndarray, mask: np.ndarray) -> float:
    """The balance of the votes of ``choose_twin``: −1 (all normals lean inward) … 1 (all lean outward)."""
    downhill = outward(mask, CUES.vote_blur * np.sqrt(mask.sum()))[valid]
    votes = np.sum(normals[valid][:, :2] * downhill, axis=-1)
    return float(votes.sum() / max(np.abs(votes).sum(), 1e-300))
