"""The camera's sensor: exposure, photon noise, read noise, full well, quantisation, and display encoding."""

import numpy as np

from huesphere.configs.schema import Camera
from huesphere.render.dataset import CameraInfo
from huesphere.render.encoding import encode_srgb
from huesphere.scenes.view import View

BRIGHT_PERCENTILE, BRIGHT_LEVEL = 99.9, 0.9  # automatic exposure puts this percentile of the object at this level


def exposure_gain(colour: np.ndarray, camera: Camera) -> float:
    """Factor from camera units to full scale 1, for object colours (n, 3) or (3, n)."""
    if camera.exposure != "auto":
        return float(camera.exposure)
    bright = float(np.percentile(colour, BRIGHT_PERCENTILE)) if colour.size else 0.0
    return BRIGHT_LEVEL / bright if bright > 0 else 1.0


def expose(image: np.ndarray, camera: Camera) -> np.ndarray:
    """The picture (H, W, 3) float32 that the camera takes of ``image``, full scale 1; noise from ``camera.seed``.

    Photon noise, read noise, black level, clipping, quantisation, in this order. The black level is subtracted at the
    end, so that values may be negative by noise as far as the black level allows. A camera without full well, bits and
    display encoding is ideal and clips nothing. Encoding "srgb" gives display-encoded values, with 8 bits by default.
    """
    rng = np.random.default_rng(camera.seed)
    picture = image.astype(np.float64)
    if camera.full_well is not None:
        picture = rng.poisson(np.maximum(picture, 0.0) * camera.full_well) / camera.full_well
    if camera.read_noise > 0:
        picture = picture + rng.normal(0.0, camera.read_noise, picture.shape)
    if clips(camera):
        black = camera.black_level
        picture = np.clip(black + (1 - black) * picture, 0.0, 1.0)
        if camera.bits is not None and camera.encoding == "linear":
            picture = _quantise(picture, camera.bits)
        picture = (picture - black) / (1 - black)
    if camera.encoding == "srgb":
        picture = _quantise(encode_srgb(np.clip(picture, 0.0, 1.0)), camera.bits or 8)
    return picture.astype(np.float32)


def clips(camera: Camera) -> bool:
    """Whether the camera clips values at full scale."""
    return camera.bits is not None or camera.full_well is not None or camera.encoding == "srgb"


def _quantise(picture: np.ndarray, bits: int) -> np.ndarray:
    """``picture``, full scale 1, rounded to 2^bits levels."""
    levels = 2**bits - 1
    return np.round(picture * levels) / levels


def camera_info(camera: Camera, view: View | None = None) -> CameraInfo:
    """The facts of the camera that the picture's header holds for recovery."""
    return CameraInfo(
        projection=camera.projection,
        focal_px=view.focal_px if view else None,
        saturation=1.0 if clips(camera) else None,
        read_noise=camera.read_noise,
        full_well=camera.full_well,
        bits=(camera.bits or 8) if camera.encoding == "srgb" else camera.bits,
        encoding=camera.encoding,
    )


def preview(picture: np.ndarray, mask: np.ndarray, white: np.ndarray) -> np.ndarray:
    """An 8-bit sRGB picture (H, W, 3) for viewing. ``white`` (3,), the camera's colour of equal energy, is grey."""
    balanced = picture / (white / white.max())
    scale = np.percentile(balanced[mask], 99.8) if mask.any() else 1.0
    linear = np.clip(np.nan_to_num(balanced / max(scale, 1e-12)), 0, 1)
    linear[~mask & (linear.max(axis=-1) == 0)] = (
        0.012  # background: nearly black, so that dark pixels of the object show
    )
    return np.round(255 * encode_srgb(linear)).astype(np.uint8)
