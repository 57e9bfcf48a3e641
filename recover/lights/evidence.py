"""Whether pixels that a light explains by its absence show a light, or only colours that a wrong one happens to fit.

A light that is not there, or two that pass for one, may explain hundreds of pixels to within a narrow tolerance. What
its pixels lack is the surface: their normals have curl, they do not continue those of the pixels beside them that see
the light, or there are no such pixels, and their colours are spread over the tolerance instead of lying well within it.
Each is measured in units of what the pixels that see every light have, since a coarse mesh has curl everywhere.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from huesphere.recover.geometry.rays import of_relief
from huesphere.recover.lights.parameters import LIGHTS

LEAST_N3 = 0.12  # n_z of normals whose slopes take part in the curl: slopes grow without bound toward the rim
FEWEST_SQUARES = 20  # squares of 2×2 pixels whose median curl means something
FEWEST_PAIRS = 6  # pairs of pixels across a border whose median turn means something
NEAR_PX = 2  # pixels of a region and of the region beside it that are so near are a pair
DOUBTFUL_CURL = 3.0  # in units of the core's curl: at this curl a light counts half
DOUBTFUL_JUMP = 3.5  # turn across the border in units of that beside it: at this a light counts half
EXPECTED_BORDER = 2.0  # pairs over the root of the pixels: with a shorter border a light counts less
LEAST_CORE_CURL = 0.002  # the core is taken to have at least this curl
LEAST_JUMP_DEG = 0.4  # a smoother core is taken to turn by this between such pixels
CURL_UNMEASURED = 4.0  # in units of the core: what a region counts that is too small for its curl to be measured
EDGES = [(dy, dx) for dy in range(-NEAR_PX, NEAR_PX + 1) for dx in range(-NEAR_PX, NEAR_PX + 1) if (dy, dx) != (0, 0)]


@dataclass(frozen=True)
class Core:
    """What the pixels that see every light have by themselves."""

    curl: float  # relative curl of their slopes
    residual: float  # median distance of their colours to the ellipsoid, picture units
    ray: np.ndarray | None  # (H, W, 2) of a picture in perspective (``recover.geometry.rays``)
    noisy: bool  # slopes are averaged before a curl is taken


@dataclass(frozen=True)
class Support:
    """What speaks for a light: the pixels that miss it, and whether they join those beside them to one surface."""

    pixels: int
    curl: float  # relative curl of the slopes of the pixels
    curl_in_cores: float  # the same in units of the core's
    jump: float  # median turn across the border to the pixels that see the light, in units of the turn beside it
    pairs: float  # pairs of pixels across that border, over the root of the number of pixels
    sharp: float  # 0 … 1: 1 where the colours are as near as the core's, about 0.2 where they are spread evenly
    # The matrix of the pixels that miss the light has nearly rank 2, so that their colours lie nearly in a plane. A
    # wrong light that is a blend of two real ones often leaves such a matrix.
    flat: bool

    @property
    def score(self) -> float:
        """Pixels, less what speaks against them."""
        out = self.pixels / (1 + (self.curl_in_cores / DOUBTFUL_CURL) ** 2)
        out /= 1 + (self.jump / DOUBTFUL_JUMP) ** 4
        out *= min(1.0, self.pairs / EXPECTED_BORDER) * self.sharp**2
        return out * (LIGHTS.credit_of_flat if self.flat else 1.0)


def measure(
    normals: np.ndarray, own: np.ndarray, beside: np.ndarray, core: Core, *, sharp: float, flat: bool
) -> Support:
    """The evidence of the pixels ``own`` (H, W) for the light that they miss.

    ``beside`` (H, W) bool: the pixels that see this light, and otherwise the same lights as ``own``. ``normals``
    (H, W, 3): unit, camera frame, at the pixels of both. ``sharp`` and ``flat`` as in ``Support``.
    """
    curl = relative_curl(of_relief(normals, core.ray), own, smooth=core.noisy)
    # relative_curl returns exactly 1 where the region is too small to be measured.
    in_cores = CURL_UNMEASURED if curl == 1.0 else curl / max(core.curl, LEAST_CORE_CURL)
    jump, pairs = turn_across(normals, own, beside)
    count = int(own.sum())
    return Support(count, curl, in_cores, jump, pairs / np.sqrt(max(count, 1)), sharp, flat)


def sharpness(distance: np.ndarray, tolerance: float, residual: float) -> float:
    """How much nearer the distances (P,) are than the tolerance, as a share of how near the core's ``residual`` is."""
    room = np.log(tolerance / max(3 * residual, 1e-12 * tolerance))
    if room <= np.log(2.0) or not len(distance):
        return 1.0
    return float(np.clip(np.log(tolerance / np.maximum(distance, 1e-30)) / room, 0.0, 1.0).mean())


def turn_across(normals: np.ndarray, own: np.ndarray, beside: np.ndarray) -> tuple[float, int]:
    """(median turn of the normals across the border, in units of the turn among the pixels ``beside`` it; pairs).

    ``normals`` (H, W, 3) of the two regions ``own`` and ``beside`` (H, W). Infinite where there is no border.
    """
    rows, columns = np.nonzero(ndimage.binary_dilation(own, iterations=2 * NEAR_PX))
    if not len(rows):
        return np.inf, 0
    box = slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1)
    normals, own, beside = normals[box], own[box], beside[box]
    across, along = [], []
    for dy, dx in EDGES:
        here, there = _shifted(own.shape, dy, dx)
        pair = own[here] & beside[there]
        if pair.any():
            across.append(_angle(normals[here][pair], normals[there][pair]))
    border = beside & ndimage.binary_dilation(own, np.ones((3, 3)), iterations=NEAR_PX)
    for dy, dx in EDGES:
        here, there = _shifted(own.shape, dy, dx)
        pair = border[here] & beside[there]
        if pair.any():
            along.append(_angle(normals[here][pair], normals[there][pair]))
    if not across:
        return np.inf, 0
    turn = np.concatenate(across)
    if len(turn) < FEWEST_PAIRS:
        return np.inf, len(turn)
    usual = float(np.median(np.concatenate(along))) if along else 0.0
    return float(np.median(turn)) / max(usual, np.radians(LEAST_JUMP_DEG)), len(turn)


def _shifted(shape: tuple[int, ...], dy: int, dx: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Slices of an image and of the same image moved by (dy, dx), where both are in it."""
    h, w = shape
    here = slice(max(0, -dy), h - max(0, dy)), slice(max(0, -dx), w - max(0, dx))
    return here, (slice(max(0, dy), h - max(0, -dy)), slice(max(0, dx), w - max(0, -dx)))


def _angle(n: np.ndarray, m: np.ndarray) -> np.ndarray:
    """Angles (P,) between unit vectors (P, 3), radians."""
    return 2 * np.arcsin(np.clip(np.linalg.norm(n - m, axis=1) / 2, 0.0, 1.0))  # type: ignore[no-any-return]


def relative_curl(normals: np.ndarray, region: np.ndarray, *, smooth: bool = False) -> float:
    """How far slopes are from closing around squares of 2×2 pixels, over how much they vary there: the median.

    ``normals`` (H, W, 3), camera frame, within ``region`` (H, W). 0 on a surface, about 0.4 on vectors that have
    nothing to do with a surface, 1 where the region holds too few squares. ``smooth``: slopes are averaged over 3×3
    pixels first, against noise.
    """
    region = region & (normals[..., 2] > LEAST_N3)
    n3 = np.where(region, normals[..., 2], 1.0)
    p, q = (np.where(region, -normals[..., i] / n3, 0.0) for i in (0, 1))
    if smooth:
        region = ndimage.binary_erosion(region, np.ones((3, 3)))
        p, q = ndimage.uniform_filter(p, 3), ndimage.uniform_filter(q, 3)
    whole = region[:-1, :-1] & region[:-1, 1:] & region[1:, :-1] & region[1:, 1:]
    if whole.sum() < FEWEST_SQUARES:
        return 1.0
    i, j = np.nonzero(whole)
    # p and q at the corners of each square: top left, top right, bottom left, bottom right
    (p0, p1, p2, p3), (q0, q1, q2, q3) = (
        (image[i, j], image[i, j + 1], image[i + 1, j], image[i + 1, j + 1]) for image in (p, q)
    )
    loop = p0 + p1 - p2 - p3 - q1 - q3 + q0 + q2
    varied = sum(
        np.abs(b - a) + np.abs(d - c) + np.abs(c - a) + np.abs(d - b)
        for a, b, c, d in ((p0, p1, p2, p3), (q0, q1, q2, q3))
    )
    return float(np.median(np.abs(loop) / (varied + 1e-12)))
