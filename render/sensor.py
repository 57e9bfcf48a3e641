"""The camera from its lens to its linear picture: optics, filter array, noise, clipping, quantisation, encoding."""

import numpy as np
from scipy import ndimage

from huesphere.configs.errors import InputError
from huesphere.configs.quiet import silence
from huesphere.configs.schema import Camera
from huesphere.render.dataset import CameraInfo
from huesphere.scenes.encoding import encode_srgb
from huesphere.scenes.view import View

BRIGHT_PERCENTILE, BRIGHT_LEVEL = 99.9, 0.9  # automatic exposure puts this percentile of the object at this level
FILTERS = "RGB"
BORDER = 8  # pixels, an even number, by which a picture is continued before demosaicing
FOOTPRINTS = {"bilinear": 3, "Malvar 2004": 5, "Menon 2007": 11}  # pixels across, from which a colour is interpolated


def exposure_gain(colour: np.ndarray, camera: Camera) -> float:
    """Factor from camera units to full scale 1, for object colours (n, 3) or (3, n)."""
    if camera.exposure != "auto":
        return float(camera.exposure)
    bright = float(np.percentile(colour, BRIGHT_PERCENTILE)) if colour.size else 0.0
    return BRIGHT_LEVEL / bright if bright > 0 else 1.0


def expose(image: np.ndarray, camera: Camera) -> np.ndarray:
    """The picture (H, W, 3) float32 that the camera takes of ``image``, full scale 1; noise from ``camera.seed``.

    What ``read_out`` gives, demosaiced where there is a filter array. Encoding "srgb" gives display-encoded values,
    with 8 bits by default. With all keys at their defaults the camera is ideal: it changes and clips nothing.
    """
    return linear_picture(read_out(image, camera), camera)


def linear_picture(samples: np.ndarray, camera: Camera) -> np.ndarray:
    """The picture (H, W, 3) float32 of the sensor's ``samples`` (H, W, 3): see ``expose``.

    Behind a filter array each pixel's missing colours are interpolated. A pixel that is interpolated from a clipped
    sample counts as clipped itself: its colours are raised to full scale.
    """
    picture = samples
    if camera.filter_array is not None:
        seen = mosaic(samples, camera.filter_array)
        picture = demosaiced(seen, camera.filter_array, camera.demosaicing)
        if clips(camera):
            clipped = ndimage.maximum_filter(seen >= 1.0, size=FOOTPRINTS[camera.demosaicing])
            picture[clipped] = np.maximum(picture[clipped], 1.0)
    if camera.encoding == "srgb":
        picture = _quantise(encode_srgb(np.clip(picture, 0.0, 1.0)), camera.bits or 8)
    return picture.astype(np.float32)


def read_out(image: np.ndarray, camera: Camera) -> np.ndarray:
    """The sensor's samples (H, W, 3) float64 of ``image``, full scale 1, above the black level.

    Point spread and vignetting of the lens; the pixels' gains; photon noise, read noise and the pixels' offsets; black
    level, clipping, quantisation, in this order. The black level is subtracted at the end, so that values may be
    negative by noise as far as the black level allows. A filter array is left to ``mosaic``: a pixel has three samples
    here, with noise of their own.
    """
    rng = np.random.default_rng(camera.seed)
    picture = through_lens(image.astype(np.float64), camera)
    gains, offsets = pixel_patterns(picture.shape, camera)
    if camera.response_spread > 0:
        picture = picture * gains
    if camera.full_well is not None:
        picture = rng.poisson(np.maximum(picture, 0.0) * camera.full_well) / camera.full_well
    if camera.read_noise > 0:
        picture = picture + rng.normal(0.0, camera.read_noise, picture.shape)
    if camera.dark_spread > 0:
        picture = picture + offsets
    if clips(camera):
        black = camera.black_level
        picture = np.clip(black + (1 - black) * picture, 0.0, 1.0)
        if camera.bits is not None and camera.encoding == "linear":
            picture = _quantise(picture, camera.bits)
        picture = (picture - black) / (1 - black)
    return np.asarray(picture)


def through_lens(image: np.ndarray, camera: Camera) -> np.ndarray:
    """``image`` (H, W, 3) after the lens: a Gaussian point spread, then the fall of light toward the corners.

    Light falls as cos⁴ of the angle to the axis: (1 + k r²)⁻² at the distance r from the picture's middle, 1 in the
    corners; k such that the corners lose the share ``vignetting``. Outside, the image goes on as at its border.
    """
    if camera.blur > 0:
        image = ndimage.gaussian_filter(image, (camera.blur, camera.blur, 0), mode="nearest")
    if camera.vignetting > 0:
        height, width = image.shape[:2]
        y, x = np.mgrid[:height, :width] + 0.5
        square = ((x - width / 2) ** 2 + (y - height / 2) ** 2) / ((width / 2) ** 2 + (height / 2) ** 2)
        fall = (1 - camera.vignetting) ** -0.5 - 1
        image = image / (1 + fall * square[..., None]) ** 2
    return image


def pixel_patterns(shape: tuple[int, ...], camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """(gain, offset) of each of the sensor's samples (H, W, 3), which are the same in all pictures it takes."""
    rng = np.random.default_rng([camera.pattern_seed, 0xF1])
    gains = np.maximum(rng.normal(1.0, camera.response_spread, shape), 0.0)
    return gains, rng.normal(0.0, camera.dark_spread, shape)


def mosaic(samples: np.ndarray, pattern: str) -> np.ndarray:
    """The one sample of each pixel (H, W) that its filter passes, of three (H, W, 3); ``pattern`` such as "RGGB"."""
    seen = np.empty(samples.shape[:2], samples.dtype)
    for number, letter in enumerate(pattern):
        at = np.s_[number // 2 :: 2, number % 2 :: 2]
        seen[at] = samples[..., FILTERS.index(letter)][at]
    return seen


def demosaiced(seen: np.ndarray, pattern: str, method: str) -> np.ndarray:
    """Three colours (H, W, 3) of each pixel from the samples (H, W) behind a filter array.

    Bilinear, or by gradients: H. S. Malvar, L. He, R. Cutler (ICASSP 2004); D. Menon, S. Andriani, G. Calvagno (IEEE
    Trans. Image Processing 16, 2007). Raises InputError without the package colour-demosaicing.
    """
    try:
        with silence():
            import colour_demosaicing as package
    except ImportError:
        hint = "the package colour-demosaicing: pip install 'huesphere[camera]'"
        raise InputError("camera.filter_array", expected=hint, got="no such package") from None
    functions = {
        "bilinear": package.demosaicing_CFA_Bayer_bilinear,
        "Malvar 2004": package.demosaicing_CFA_Bayer_Malvar2004,
        "Menon 2007": package.demosaicing_CFA_Bayer_Menon2007,
    }
    # Mirrored about the outermost samples, beyond the border the pattern goes on; the package repeats these samples.
    padded = np.pad(seen, BORDER, mode="reflect")
    return np.asarray(functions[method](padded, pattern)[BORDER:-BORDER, BORDER:-BORDER], dtype=np.float64)


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
        # Offsets of the pixels are noise to whoever does not know them; their gains are not a part of this model.
        read_noise=float(np.hypot(camera.read_noise, camera.dark_spread)),
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
