"""Which pixels may take part, their colours in linear units, and how much of a picture's weakest colour is signal."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from huesphere.recover.geometry.rays import rays
from huesphere.recover.pixels.noise import LAPLACIAN
from huesphere.recover.problem import Problem
from huesphere.recover.reasons import Reason
from huesphere.recover.robust_scale import mad_scale
from huesphere.recover.status import RecoveryFailure
from huesphere.render.dataset import Observation

FEWEST_PIXELS = 50
MOST_LOST = 0.5  # share of the object's pixels that may be clipped or not finite
DARK = 1e-3  # of the object's brightest percent: below, no light reaches the pixel and its colour has no direction


@dataclass(frozen=True)
class Pixels:
    """What of an observation is fit for use."""

    rgb: np.ndarray  # (H, W, 3) float64, picture units; 0 where not usable
    usable: np.ndarray  # (H, W) bool
    mask: np.ndarray  # (H, W) bool, the object
    dark: np.ndarray  # (H, W) bool, too dark to have a colour
    lost: np.ndarray  # (H, W) uint8, codes of ``recover.reasons``: why a pixel of the object is not usable; else 0
    counts: dict[str, int]  # object pixels, and those lost as "not finite", "saturated", "dark"


def usable_pixels(observation: Observation) -> Pixels:
    """The object's pixels that are finite, not clipped and not black. The observation is in linear light.

    Raises RecoveryFailure: too-few-pixels, not-finite, saturated.
    """
    camera, mask = observation.camera, observation.mask
    light = observation.rgb
    total = int(mask.sum())
    if total < FEWEST_PIXELS:
        raise RecoveryFailure("too-few-pixels", f"the object has {total} pixels")
    finite = np.isfinite(light).all(axis=-1)
    with np.errstate(invalid="ignore"):
        clipped = finite & ((light >= camera.saturation).any(axis=-1) if camera.saturation is not None else False)
    lost = int((mask & ~finite).sum())
    if lost > MOST_LOST * total:
        raise RecoveryFailure("not-finite", f"{lost} of {total} pixels are NaN or infinite")
    rgb = np.where(finite[..., None], light, 0.0).astype(np.float64)
    brightness = rgb.max(axis=-1)
    dark = finite & (brightness <= DARK * np.quantile(brightness[mask], 0.99))
    usable = mask & finite & ~clipped & ~dark
    counts = {
        "object": total,
        "not finite": lost,
        "saturated": int((mask & clipped).sum()),
        "dark": int((mask & dark).sum()),
        "usable": int(usable.sum()),
    }
    if counts["saturated"] > MOST_LOST * total:
        raise RecoveryFailure("saturated", f"{counts['saturated']} of {total} pixels are clipped")
    if counts["usable"] < FEWEST_PIXELS:
        raise RecoveryFailure("too-few-pixels", f"{counts['usable']} of {total} pixels are usable")
    dark = mask & dark & ~clipped
    why = np.zeros(mask.shape, np.uint8)
    for code, where in ((Reason.DARK, dark), (Reason.SATURATED, mask & clipped), (Reason.NOT_FINITE, mask & ~finite)):
        why[where] = code
    return Pixels(np.where(usable[..., None], rgb, 0.0), usable, mask, dark, why, counts)


def problem_of(pixels: Pixels, observation: Observation, noise: float = 0.0) -> Problem:
    """The picture as stages see it, before any indirect light was removed; ``noise`` of a channel, picture units."""
    ray = rays(observation.camera, pixels.mask.shape)
    return Problem(pixels.rgb, pixels.usable, pixels.mask, pixels.dark, ray, noise, np.zeros_like(pixels.rgb))


def colour_signal(rgb: np.ndarray, inside: np.ndarray, *, window: int = 1) -> tuple[float, float]:
    """(of the strongest variation, of the weakest colour): signal over noise among the pixels ``inside`` (H, W).

    If the colours lie in a plane, the direction across it holds nothing but noise, different in each pixel; if
    not, it holds an image, which is smooth. So the ratio of its size to its fine grain is about 1 in the first case and
    larger in the second, whatever the noise and the units. The same for the colours less their mean: about 1
    where the surface is flat. NaN without pixels whose eight neighbours are inside.

    With a ``window`` all this is of means over squares of so many pixels: their noise is so many times less, and an
    image that drowns in each pixel stands out of it.
    """
    variation, *_, weakest = _signals(rgb, inside, window)
    return variation, weakest


def spans_a_plane(rgb: np.ndarray, inside: np.ndarray, least: float, *, window: int = 1) -> bool:
    """Whether two directions of the colours hold over ``least`` times their noise; arguments as ``colour_signal``."""
    return _signals(rgb, inside, window)[1] >= least


def _signals(rgb: np.ndarray, inside: np.ndarray, window: int) -> tuple[float, float, float]:
    """Signal over noise: of the strongest variation, of the second strongest colour, of the weakest colour."""
    colours = rgb[inside]
    if window > 1:
        full = ndimage.uniform_filter(inside.astype(float), window) > 0.999
        if full.sum() >= FEWEST_PIXELS:
            colours = ndimage.uniform_filter(np.where(inside[..., None], rgb, 0.0), (window, window, 0))[full]
        else:
            window = 1
    mean = colours.mean(axis=0)
    about_black = np.linalg.eigh(colours.T @ colours / len(colours))
    about_mean = np.linalg.eigh(np.cov(colours.T, bias=True))
    whole = ndimage.binary_erosion(inside, np.ones((3, 3)))

    def ratio(variance: float, direction: np.ndarray) -> float:
        if not variance > (1e-7 * np.linalg.norm(mean)) ** 2:  # single precision holds no more
            return 0.0
        if not whole.any():
            return float("nan")
        grain = ndimage.convolve(np.where(inside, rgb @ direction, 0.0), LAPLACIAN)[whole]
        return float(np.sqrt(variance) * window / max(mad_scale(grain), 1e-300))

    of_colours = [ratio(about_black[0][k], about_black[1][:, k]) for k in (1, 0)]
    return ratio(about_mean[0][2], about_mean[1][:, 2]), of_colours[0], of_colours[1]
