"""A ball in a calibration picture: where it is, and the normals of its sphere.

A ball in full view shows its sphere up to its silhouette. A ball pressed into a sheet of gel shows it within the
contact circle only (M. K. Johnson and E. H. Adelson, "Retrographic sensing for the measurement of surface texture and
shape", CVPR 2009); ``recover.rig.calibrate`` finds that circle from the colours.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from huesphere.configs.errors import InputError

SMALLEST_RADIUS = 8.0  # pixels: a smaller ball has too few pixels to tell nine numbers from noise
ROUND = 0.03  # of the radius: largest RMS distance of a silhouette from its circle for it to be that of a ball


@dataclass(frozen=True)
class Ball:
    """A sphere in a picture, in parallel projection."""

    x: float  # of its centre: pixels from the picture's left edge, the middle of the first pixel being 0
    y: float  # of its centre: pixels from the top, downward
    radius: float  # of the sphere, pixels
    mm: float | None = None  # of the sphere's radius, millimetres; None: not known

    @property
    def mm_per_px(self) -> float | None:
        return None if self.mm is None else self.mm / self.radius

    def normals(self, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        """(normals (H, W, 3) of the sphere, distance (H, W) from its centre over its radius); NaN beyond radius 1."""
        rows, columns = np.mgrid[: shape[0], : shape[1]]
        x, y = (columns - self.x) / self.radius, (self.y - rows) / self.radius
        distance = np.hypot(x, y)
        with np.errstate(invalid="ignore"):
            return np.dstack([x, y, np.sqrt(1 - distance**2)]), distance


def check_ball(ball: Ball, shape: tuple[int, int], where: object) -> None:
    """Raise InputError for a ball that is too small, or whose centre is not in the picture (H, W)."""
    got = f"{ball.x:g},{ball.y:g},{ball.radius:g}"
    if not (0 <= ball.x <= shape[1] - 1 and 0 <= ball.y <= shape[0] - 1):
        expected = f"a centre within the picture of {shape[1]}×{shape[0]} pixels"
        raise InputError("--ball outside the picture", got=got, expected=expected, where=where)
    if not ball.radius >= SMALLEST_RADIUS:
        expected = f"a radius of {SMALLEST_RADIUS:g} pixels or more"
        raise InputError("--ball that is too small", got=got, expected=expected, where=where)
    if ball.radius > 2 * max(shape):
        expected = "a radius of at most twice the picture's longer side"
        raise InputError("--ball that is too large", got=got, expected=expected, where=where)


def find_ball(rgb: np.ndarray, mask: np.ndarray, where: object) -> Ball:
    """The ball in full view in a picture (H, W, 3), linear light: the circle of its silhouette.

    The silhouette is that of the ``mask`` (H, W), or where that is the whole picture, of the largest region brighter
    than Otsu's threshold of the brightness. Raises InputError where it is not round or touches the picture's border.
    """
    remedy = "a round silhouette on a dark background; give --ball X,Y,R or --mask"
    inside = mask
    if mask.all():
        from skimage.filters import threshold_otsu

        brightness = np.sqrt(np.maximum(np.nan_to_num(rgb).mean(axis=-1), 0))
        inside = brightness > threshold_otsu(brightness) if np.ptp(brightness) > 0 else np.zeros(mask.shape, bool)
    label, count = ndimage.label(ndimage.binary_fill_holes(inside))
    if not count:
        raise InputError("no ball was found", got="a picture without a bright region", expected=remedy, where=where)
    largest = label == 1 + int(np.argmax(np.bincount(label.ravel())[1:]))
    rows, columns = np.nonzero(largest & ~ndimage.binary_erosion(largest, border_value=1))
    if largest[[0, -1]].any() or largest[:, [0, -1]].any() or len(rows) < 8:
        raise InputError("no ball was found", got="a region at the picture's border", expected=remedy, where=where)
    x, y, radius, rms = _circle(columns.astype(float), rows.astype(float))
    if rms > ROUND * radius:
        got = f"a silhouette that is off its circle by {rms / radius:.0%} of its radius"
        raise InputError("no ball was found", got=got, expected=remedy, where=where)
    return Ball(x, y, radius + 0.5)  # the silhouette passes half a pixel outside the middle of the outermost pixels


def _circle(x: np.ndarray, y: np.ndarray) -> tuple[float, float, float, float]:
    """(centre x, y, radius, RMS distance) of the circle through points: x² + y² = 2 x a + 2 y b + c (Kåsa 1976)."""
    centre = np.array([x.mean(), y.mean()])
    u, v = x - centre[0], y - centre[1]
    a, b, c = np.linalg.lstsq(np.stack([2 * u, 2 * v, np.ones_like(u)], axis=1), u**2 + v**2, rcond=None)[0]
    radius = float(np.sqrt(c + a**2 + b**2))
    distance = np.hypot(u - a, v - b) - radius
    return float(a + centre[0]), float(b + centre[1]), radius, float(np.sqrt(np.mean(distance**2)))
