"""The object of a picture that has no mask, where its background is dark or plain: what differs from the border.

The colour of the border is taken for that of the background if most of the border has it. What differs from it is the
object if it is one piece, and if few pixels are near the limit: a background with a gradient, or a surface that fills
the picture, leaves no such gap, and then nothing is claimed.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_erosion, binary_fill_holes
from skimage.filters import gaussian
from skimage.measure import block_reduce, label

# Sizes of work and of what is looked at.
MOST_PIXELS = 1_000_000  # a larger picture is reduced by whole pixels before it is looked at
LEAST_SIDE_PX = 16  # a smaller picture has too little border to judge by
BORDER_SHARE = 1 / 50  # width of the border, as a share of the shorter side; at least one pixel
BLUR_PX = 0.7  # standard deviation of the Gaussian against single noisy pixels
WHITE_PERCENTILE = 99.5  # of all samples: what counts as full brightness, so that a few highlights do not

# Thresholds of differences, in square roots of linear light, about as eyes weigh it, with full brightness 1. They are
# bounds of what is still believed, not best values: where one is not kept, nothing is claimed.
LEAST_DIFFERENCE = 0.06  # from the background's colour, by which a pixel is the object
MOST_SPREAD = 0.03  # median difference, over the border, from its own median colour
SPREADS = 4.0  # the least difference is at least so many of these medians
DARK = 0.12  # brightest channel up to which a background is called dark; only a word for the user
NEAR = 1.4  # factor: a difference within it of the limit, up or down, is near the limit

# Shares of pixels.
MOST_OF_BORDER = 0.35  # of the border, which the object may cover
LEAST_OF_PICTURE, MOST_OF_PICTURE = 0.01, 0.9  # of the picture, which an object may have
ONE_PIECE = 0.85  # of the pixels that differ, which the largest piece has at least
MOST_NEAR = 0.1  # of the object, which may be near the limit


@dataclass(frozen=True)
class FoundObject:
    """What was found in a picture without a mask."""

    mask: np.ndarray | None  # (H, W) bool; None: not sure, and the whole picture is to be taken
    said: str  # one line for the user


def find_object(rgb: np.ndarray) -> FoundObject:
    """Find the object in a picture (H, W, 3) of linear light; see the module's header.

    Holes in the object are filled, since they are more often shadows than openings, and the outermost pixels, which mix
    object and background, are left out.
    """
    height, width = rgb.shape[:2]
    by = int(np.ceil(np.sqrt(height * width / MOST_PIXELS)))
    values = np.nan_to_num(np.asarray(rgb, np.float32), nan=0.0, posinf=0.0, neginf=0.0)
    if by > 1:
        values = block_reduce(values, (by, by, 1), np.mean)
    if min(values.shape[:2]) < LEAST_SIDE_PX:
        return _unsure("the picture is too small to see a background in it")
    white = float(np.percentile(values, WHITE_PERCENTILE))
    if not white > 0:
        return _unsure("the picture is dark all over")
    seen = gaussian(np.sqrt(np.clip(values / white, 0.0, 1.0)), sigma=BLUR_PX, channel_axis=2)
    edge = np.ones(seen.shape[:2], bool)
    strip = max(1, int(BORDER_SHARE * min(edge.shape)))
    edge[strip:-strip, strip:-strip] = False
    ground = np.median(seen[edge], axis=0)
    away = np.linalg.norm(seen - ground, axis=2)
    spread = float(np.median(away[edge]))
    if spread > MOST_SPREAD:
        return _unsure("the border of the picture is not of one colour")
    limit = max(LEAST_DIFFERENCE, SPREADS * spread)
    inside, why = _one_piece(away, limit, edge)
    if inside is None:
        return _unsure(why)
    full = np.repeat(np.repeat(inside, by, axis=0), by, axis=1)[:height, :width]
    kind = "dark" if ground.max() <= DARK else "plain"
    return FoundObject(
        full,
        f"object found: {full.mean():.0%} of the picture, all that differs from its {kind} background "
        "(if that is wrong: --mask or --region)",
    )


def _one_piece(away: np.ndarray, limit: float, edge: np.ndarray) -> tuple[np.ndarray | None, str]:
    """(the object, "") or (None, why it is not sure) by differences (H, W) from the background and their limit."""
    differs = away > limit
    if not differs.any():
        return None, "nothing differs from its border"
    pieces = label(differs)
    sizes = np.bincount(pieces.ravel())
    sizes[0] = 0
    piece = pieces == sizes.argmax()
    if piece.sum() < ONE_PIECE * differs.sum():
        return None, "what differs from its border is in several pieces"
    if piece[edge].mean() > MOST_OF_BORDER:
        return None, "what differs from its border reaches far along it"
    near = (away > limit / NEAR) & (away < limit * NEAR)
    if near.sum() > MOST_NEAR * piece.sum():
        return None, "there is no clear step between object and background"
    filled = binary_fill_holes(piece)
    inside = binary_erosion(filled, border_value=1)
    if not LEAST_OF_PICTURE <= inside.mean() <= MOST_OF_PICTURE:
        return None, f"what differs from its border is {inside.mean():.0%} of it"
    return inside, ""


def _unsure(why: str) -> FoundObject:
    return FoundObject(
        None, f"the whole picture is taken for the object: {why}; to name the object: --mask or --region"
    )
