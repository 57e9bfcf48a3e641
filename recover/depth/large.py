"""Depth of large pictures: the depth of blocks of pixels first, then what single pixels add to it.

The equations are those of ``recover.depth.integration``. Their solution on means over blocks holds all but what varies
from pixel to pixel; the rest, which no distant pixel has a part in, takes a few dozen steps of conjugate gradients
(M. R. Hestenes and E. Stiefel, 1952) that start from the interpolated depth of the blocks. Memory is some 60 bytes a
pixel, and time is proportional to the pixels.
"""

from dataclasses import dataclass

import numba
import numpy as np
from scipy import ndimage

from huesphere.recover.geometry.reduction import Reduction, filled

MOST_STEPS = 60  # of conjugate gradients
SMALL_RESIDUAL = 1e-3  # of that of the interpolated depth, at which they end
LEAST_KNOWN = 0.25  # share of a block's pixels whose slopes are known, for its own to be


@dataclass(frozen=True)
class Slopes:
    """Slopes of a picture or of its blocks: p = ∂z/∂x, q = ∂z/∂y (y up), where ``known``; the object is ``mask``."""

    p: np.ndarray  # (H, W)
    q: np.ndarray
    known: np.ndarray
    mask: np.ndarray


def slopes_of_blocks(slopes: Slopes, by: Reduction) -> Slopes:
    """Means of the known slopes over blocks."""
    count = by.blockwise(slopes.known)
    p, q = (by.blockwise(np.where(slopes.known, s, 0.0)) / np.maximum(count, 1) for s in (slopes.p, slopes.q))
    mask = by.on_object(slopes.mask)
    return Slopes(p, q, mask & (count >= LEAST_KNOWN * by.factor**2), mask)


def refined(slopes: Slopes, of_blocks: np.ndarray, by: Reduction) -> np.ndarray:
    """Depth (H, W), pixels, 0 off the mask, from that ``of_blocks`` (h, w), in blocks, NaN off the object.

    Between two pixels without known slopes the interpolated depth of the blocks keeps its own slope.
    """
    mask = slopes.mask
    coarse = filled(of_blocks, np.isfinite(of_blocks))[..., None].astype(np.float32) * by.factor
    z = np.where(mask, by.linear(coarse, slice(None))[..., 0], 0)
    right, up = mask[:, :-1] & mask[:, 1:], mask[:-1] & mask[1:]
    steps = (
        np.where(right, _missing(z[:, :-1], z[:, 1:], slopes.p[:, :-1], slopes.p[:, 1:], *_ends(slopes.known, 1)), 0),
        np.where(up, _missing(z[1:], z[:-1], slopes.q[1:], slopes.q[:-1], *_ends(slopes.known, 0)[::-1]), 0),
    )
    added = _descend(_divergence(*steps), right, up)
    return z + added  # type: ignore[no-any-return]


def _ends(known: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
    return (known[:, :-1], known[:, 1:]) if axis else (known[:-1], known[1:])


def _missing(
    z: np.ndarray, z_next: np.ndarray, s: np.ndarray, s_next: np.ndarray, known: np.ndarray, known_next: np.ndarray
) -> np.ndarray:
    """Mean of the known slopes at the ends of pairs of pixels, less the step ``z_next`` − ``z``; 0 if none is known.

    All arrays have one value for each pair and the same shape, as the result has. ``z``, ``z_next``: depths in pixels.
    ``s``, ``s_next``: slopes along the pair, positive if ``z`` grows toward the next pixel; used where ``known`` and
    ``known_next``.
    """
    ends = known.astype(np.float32) + known_next
    mean = (np.where(known, s, 0) + np.where(known_next, s_next, 0)) / np.maximum(ends, 1)
    return np.where(ends > 0, mean - (z_next - z), 0).astype(np.float32)


def _divergence(right: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Dᵀ of steps to the right (H, W − 1) and up (H − 1, W), D being the differences that they are steps of: (H, W)."""
    out = np.zeros((up.shape[0] + 1, up.shape[1]), np.float32)
    out[:, 1:] += right
    out[:, :-1] -= right
    out[:-1] += up
    out[1:] -= up
    return out


def _descend(wanted: np.ndarray, right: np.ndarray, up: np.ndarray) -> np.ndarray:
    """x (H, W) with DᵀD x ≈ ``wanted``, D over the pairs of pixels ``right`` and ``up``, by conjugate gradients."""
    x, residual = np.zeros_like(wanted), wanted.copy()
    along, applied, square = residual.copy(), np.empty_like(wanted), float(np.vdot(residual, residual).real)
    enough = SMALL_RESIDUAL**2 * square
    for _ in range(MOST_STEPS):
        if square <= enough or square == 0.0:
            break
        length = np.float32(square / max(_apply(along, right, up, applied), 1e-300))
        before, square = square, _advance(x, residual, along, applied, length)
        _turn(along, residual, np.float32(square / before))
    return x


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _apply(x: np.ndarray, right: np.ndarray, up: np.ndarray, out: np.ndarray) -> float:
    """Write DᵀD x to ``out`` (H, W); returns xᵀDᵀD x."""
    height, width = x.shape
    total = 0.0
    for i in range(height):
        for j in range(width):
            here, value = x[i, j], np.float32(0)
            if j > 0 and right[i, j - 1]:
                value += here - x[i, j - 1]
            if j + 1 < width and right[i, j]:
                value += here - x[i, j + 1]
            if i > 0 and up[i - 1, j]:
                value += here - x[i - 1, j]
            if i + 1 < height and up[i, j]:
                value += here - x[i + 1, j]
            out[i, j] = value
            total += here * value
    return total


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _advance(x: np.ndarray, residual: np.ndarray, along: np.ndarray, applied: np.ndarray, length: np.float32) -> float:
    """Go so far along; ``x`` and ``residual`` change in place. Returns the square of the new residual."""
    total = 0.0
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            x[i, j] += length * along[i, j]
            left = residual[i, j] - length * applied[i, j]
            residual[i, j] = left
            total += left * left
    return total


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _turn(along: np.ndarray, residual: np.ndarray, share: np.float32) -> None:
    """The next conjugate direction, in place: the residual and a ``share`` of the one before."""
    for i in range(along.shape[0]):
        for j in range(along.shape[1]):
            along[i, j] = residual[i, j] + share * along[i, j]


def with_mean_zero(z: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """``z`` (H, W) less its mean over each connected component of the ``mask`` (4-neighbours), NaN off it."""
    component = ndimage.label(mask)[0]
    size, total = np.bincount(component.ravel()), np.bincount(component.ravel(), z.ravel())
    return np.where(mask, z - (total / np.maximum(size, 1))[component], np.nan)
