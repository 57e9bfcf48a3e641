"""From radiance to the numbers a camera writes: exposure, photon noise, read noise, full well, quantisation."""

import numpy as np

from configs.schema import Camera
from render.dataset import CameraInfo

BRIGHT_PERCENTILE, BRIGHT_LEVEL = 99.9, 0.9  # automatic exposure puts this percentile of the object at this level


def exposure_gain(colour: np.ndarray, camera: Camera) -> float:
    """Factor from camera units to full scale 1, for object colours (n, 3) or (3, n)."""
    if camera.exposure != "auto":
        return float(camera.exposure)
    bright = float(np.percentile(colour, BRIGHT_PERCENTILE)) if colour.size else 0.0
    return BRIGHT_LEVEL / bright if bright > 0 else 1.0


def expose(image: np.ndarray, camera: Camera) -> np.ndarray:
    """The picture (H, W, 3) float32 that the camera takes of ``image``, full scale 1; noise from ``camera.seed``.

    Without full well and bits the camera is ideal and clips nothing; else it clips to [0, 1].
    """
    rng = np.random.default_rng(camera.seed)
    picture = image.astype(np.float64)
    if camera.full_well is not None:
        picture = rng.poisson(np.maximum(picture, 0.0) * camera.full_well) / camera.full_well
    if camera.read_noise > 0:
        picture = picture + rng.normal(0.0, camera.read_noise, picture.shape)
    if clips(camera):
        picture = np.clip(picture, 0.0, 1.0)
    if camera.bits is not None:
        levels = 2**camera.bits - 1
        picture = np.round(picture * levels) / levels
    return picture.astype(np.float32)


def clips(camera: Camera) -> bool:
    return camera.bits is not None or camera.full_well is not None


def camera_info(camera: Camera) -> CameraInfo:
    """What goes into the picture's header for recovery to know."""
    return CameraInfo(
        projection=camera.projection,
        saturation=1.0 if clips(camera) else None,
        read_noise=camera.read_noise,
        full_well=camera.full_well,
        bits=camera.bits,
    )


def preview(picture: np.ndarray, mask: np.ndarray, white: np.ndarray) -> np.ndarray:
    """An 8-bit sRGB picture (H, W, 3) to look at; ``white`` (3,), the camera's colour of equal energy, is grey."""
    balanced = picture / (white / white.max())
    scale = np.percentile(balanced[mask], 99.8) if mask.any() else 1.0
    linear = np.clip(np.nan_to_num(balanced / max(scale, 1e-12)), 0, 1)
    linear[~mask & (linear.max(axis=-1) == 0)] = (
        0.012  # background: nearly black, so that dark pixels of the object show
    )
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)  # IEC 61966-2-1
    return np.round(255 * encoded).astype(np.uint8)
