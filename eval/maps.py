"""Maps: values of pixels (normals, errors, masks, shading) as images (H, W, 3) of bytes.

The colours can be distinguished by colour-blind readers. Maps of the same kind have the same scale in every report;
values beyond an end of the scale have the colour of that end. Pixels off the object are white, and object pixels
without a value are grey.
"""

import base64
import io
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from huesphere.scenes.encoding import encode_srgb

OFF_OBJECT = np.array([255, 255, 255], dtype=np.uint8)
DECLINED = np.array([196, 196, 196], dtype=np.uint8)
NOT_SHADED = np.array([176, 190, 208], dtype=np.uint8)  # blue-grey: differs from every shade of grey
ACCEPTED_COLOUR = np.array([0, 114, 178], dtype=np.uint8)  # Okabe & Ito's blue
REJECTED_COLOUR = np.array([230, 159, 0], dtype=np.uint8)  # Okabe & Ito's orange
STRIPE_EVERY = 5  # distance of the stripes of hatched pixels, in widths of one


@dataclass(frozen=True)
class Scale:
    """A colour scale: a Matplotlib colour map between two limits, with the ticks of its colour bar."""

    label: str  # of the colour bar
    low: float
    high: float
    ticks: tuple[tuple[float, str], ...]  # (value, text)
    colours: str = "viridis"
    log: bool = True

    def position(self, value: np.ndarray | float) -> np.ndarray:
        """Return the place of ``value`` on the scale, 0 to 1; 0 or 1 for values beyond its ends."""
        with np.errstate(divide="ignore"):
            low, high, at = (np.log(v) if self.log else np.asarray(v) for v in (self.low, self.high, value))
        return np.clip((at - low) / (high - low), 0.0, 1.0)


ERROR_SCALE = Scale(
    "angular error, degrees",
    0.01,
    90.0,
    ((0.01, "0.01°"), (0.1, "0.1°"), (1.0, "1°"), (10.0, "10°"), (90.0, "90°")),
)
INTEGRABILITY_SCALE = Scale(
    "|p_y − q_x|, per pixel",
    1e-4,
    10.0,
    ((1e-4, "0.0001"), (1e-2, "0.01"), (1.0, "1"), (10.0, "10")),
    "magma",
)


def depth_scale(depth: np.ndarray) -> Scale:
    """Return the linear scale, in pixels toward the camera, from the farthest to the nearest of finite depths."""
    low, high = float(np.nanmin(depth)), float(np.nanmax(depth))
    high = max(high, low + 1e-6)
    ticks = tuple((low + t * (high - low), f"{t * (high - low):.0f}") for t in (0.0, 0.5, 1.0))
    return Scale("depth above the farthest point, pixels", low, high, ticks, "cividis", log=False)


def count_scale(most: int) -> Scale:
    """Return the linear scale for numbers of lights from 0 to ``most``."""
    step = max(1, -(-most // 6))
    ticks = tuple((float(n), str(n)) for n in range(0, most + 1, step))
    return Scale("lights seen", 0.0, float(max(most, 1)), ticks, "cividis", log=False)


@lru_cache(maxsize=8)
def palette(name: str) -> np.ndarray:
    """Return a matplotlib colour map as (256, 3) bytes."""
    import matplotlib

    return (matplotlib.colormaps[name](np.arange(256))[:, :3] * 255).round().astype(np.uint8)


def scalar_map(values: np.ndarray, mask: np.ndarray, scale: Scale) -> np.ndarray:
    """Return numbers (H, W) in the colours of ``scale``; grey where they are NaN on the object."""
    known = np.isfinite(values)
    index = (scale.position(np.where(known, values, scale.low)) * 255).round().astype(np.uint8)
    return _on_object(palette(scale.colours)[index], known, mask)


def normal_map(normals: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return (H, W, 3) normals as colours, (n + 1) / 2: red to the right, green upward, blue toward the camera."""
    known = np.isfinite(normals).all(axis=-1)
    colours = (np.nan_to_num(normals) * 127.5 + 127.5).clip(0, 255).round().astype(np.uint8)
    return _on_object(colours, known, mask)


def shading_map(shading: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return linear shading (H, W) from 0 to 1 as display-encoded grey; blue-grey where it is NaN on the object."""
    known = np.isfinite(shading)
    grey = np.repeat(display(shading)[..., None], 3, axis=-1)
    image = _on_object(grey, known, mask)
    image[mask & ~known] = NOT_SHADED
    return image


def acceptance_map(accepted: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return (H, W) bool as blue (accepted) and orange (rejected) on the object."""
    return _on_object(np.where(accepted[..., None], ACCEPTED_COLOUR, REJECTED_COLOUR), np.ones_like(mask), mask)


def hatched(image: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Return an image (H, W, 3) of bytes with diagonal stripes, black beside white, on the pixels ``where`` (H, W).

    The stripes are as wide on a large picture as on a small one once both are shown at the same size.
    """
    width = max(1, max(where.shape) // 192)
    row, column = np.indices(where.shape)
    stripe = (row + column) // width % STRIPE_EVERY
    out = image.copy()
    out[where & (stripe == 0)] = 0
    out[where & (stripe == 1)] = 255
    return out


def display(linear: np.ndarray) -> np.ndarray:
    """Return linear light, full scale 1, as display-encoded bytes (IEC 61966-2-1, "sRGB"); NaN is black."""
    light = np.clip(np.nan_to_num(linear.astype(np.float64)), 0.0, 1.0)
    return (encode_srgb(light) * 255).round().astype(np.uint8)


def bar(scale: Scale, *, height: int = 1) -> np.ndarray:
    """Return the colours of ``scale`` from low to high, (height, 256, 3) bytes."""
    return np.repeat(palette(scale.colours)[None], height, axis=0)


def shrink(image: np.ndarray, longest: int) -> np.ndarray:
    """Return every k-th pixel of an image so that no side is longer than ``longest``; values are not averaged."""
    step = thinning(image.shape, longest)
    return image[::step, ::step]


def thinning(shape: tuple[int, ...], longest: int) -> int:
    """Return the least k such that every k-th pixel of a shape (H, W, …) leaves no side longer than ``longest``."""
    return max(1, -(-max(shape[:2]) // longest))


def data_uri(image: np.ndarray, quality: int, *, clear: bool = False) -> str:
    """Return an image (H, W, 3) of bytes as a WebP data URI; WebP, because a page has a dozen images per result.

    ``clear``: make the white of OFF_OBJECT transparent, so that a map has no white ground on a dark page.
    """
    from PIL import Image

    buffer = io.BytesIO()
    if clear:
        seen = np.where((image == OFF_OBJECT).all(axis=-1), 0, 255).astype(np.uint8)
        image = np.concatenate([image, seen[..., None]], axis=-1) if not seen.all() else image
    Image.fromarray(image).save(buffer, "WEBP", quality=quality, method=1)
    return "data:image/webp;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")


def _on_object(colours: np.ndarray, known: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """``colours`` (H, W, 3), grey where they are not ``known`` (H, W) and white off the ``mask`` (H, W)."""
    image = colours.astype(np.uint8)
    image[~known] = DECLINED
    image[~mask] = OFF_OBJECT
    return image
