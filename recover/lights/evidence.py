"""Whether pixels that a light explains by its absence show a light, or only colours that a wrong one happens to fit.

A light that does not exist, or two lights that are taken for one, may explain hundreds of pixels to within a narrow
tolerance. But the normals of these pixels are not those of a surface: the normals have curl, and they do not continue
the normals of adjacent pixels that see the light, or there are no such adjacent pixels. The colours are spread over the
tolerance instead of lying well within it. The curl is given in units of the curl of the pixels that see every light,
since a coarse mesh has curl everywhere; the turn across a border in units of the turn beside it.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from huesphere.recover.geometry.rays import of_relief
from huesphere.recover.lights.parameters import LIGHTS

LEAST_N3 = 0.12  # third component of (relief) normals from which slopes are used: they grow without bound at the rim
FEWEST_SQUARES = 20  # fewest squares of 2×2 pixels from which a median curl is computed
FEWEST_PAIRS = 6  # fewest pairs of pixels across a border from which a median turn is computed
NEAR_PX = 2  # pixels of two adjacent regions whose rows and columns differ by at most this are a pair
DOUBTFUL_CURL = 3.0  # in units of the core's curl: at this curl a light counts half
DOUBTFUL_JUMP = 3.5  # turn across the border in units of that beside it: at this a light counts half
EXPECTED_BORDER = 2.0  # pairs across the border over the root of the number of pixels: with fewer a light counts less
LEAST_CORE_CURL = 0.002  # the core is taken to have at least this curl
LEAST_JUMP_DEG = 0.4  # least turn, degrees, by which the turn across a border is divided
CURL_UNMEASURED = 4.0  # in units of the core's curl: the curl given to a region too small for it to be measured
EDGES = [(dy, dx) for dy in range(-NEAR_PX, NEAR_PX + 1) for dx in range(-NEAR_PX, NEAR_PX + 1) if (dy, dx) != (0, 0)]


@dataclass(frozen=True)
class Core:
    """Measures of the inliers, which are taken to see every light: the units of the measures of a light's pixels."""

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
    """Mean over pixels of ln(tolerance / distance) / ln(tolerance / 3 ``residual``), each limited to 0 … 1.

    ``distance`` (P,) of colours to the ellipsoid, ``tolerance`` and ``residual``, the core's median distance, in
    picture units. 0: at the tolerance; 1: as near the ellipsoid as three times ``residual``. 1, too, where the
    tolerance is at most six times ``residual``, so that the two are too close to tell.
    """
    room = np.log(tolerance / max(3 * residual, 1e-12 * tolerance))
    if room <= np.log(2.0) or not len(distance):
        return 1.0
    return float(np.clip(np.log(tolerance / np.maximum(distance, 1e-30)) / room, 0.0, 1.0).mean())


def turn_across(normals: np.ndarray, own: np.ndarray, beside: np.ndarray) -> tuple[float, int]:
    """(median turn of the normals across the border of two regions, in units of the turn beside it; number of pairs).

    ``normals`` (H, W, 3), unit, of the two regions ``own`` and ``beside`` (H, W). A turn is the angle between the
    normals of a pair of pixels; the unit is the median turn of pairs within ``beside`` near the border, at least
    LEAST_JUMP_DEG. The first result is infinite where there are fewer than FEWEST_PAIRS pairs across the border.
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
    """Slices of an image of ``shape``: of the pixels (y, x) with (y + dy, x + dx) in it too, and of the latter."""
    h, w = shape
    here = slice(max(0, -dy), h - max(0, dy)), slice(max(0, -dx), w - max(0, dx))
    return here, (slice(max(0, dy), h - max(0, -dy)), slice(max(0, dx), w - max(0, -dx)))


def _angle(n: np.ndarray, m: np.ndarray) -> np.ndarray:
    """Angles (P,) between unit vectors (P, 3), radians."""
    return 2 * np.arcsin(np.clip(np.linalg.norm(n - m, axis=1) / 2, 0.0, 1.0))  # type: ignore[no-any-return]


def relative_curl(normals: np.ndarray, region: np.ndarray, *, smooth: bool = False) -> float:
    """Median over squares of 2×2 pixels of the slopes' sum around a square, over their absolute differences.

    The divisor is the sum of the absolute differences of the slopes along the square's sides, so the result has no
    unit. ``normals`` (H, W, 3) within ``region`` (H, W): of the surface, or in perspective of its relief
    (``of_relief``); they need not be unit. 0 on a plane or a paraboloid and small on any smooth surface, 0.2 to 0.4 on
    vectors that are no normals of a surface, exactly 1 where the region holds fewer than FEWEST_SQUARES squares.
    ``smooth``: slopes are averaged over 3×3 pixels first, against noise.
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
