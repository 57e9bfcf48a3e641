"""From a camera's linear picture to the files that a photographer gets: the raw file, and the developed picture.

Recovery reads neither: its observation is the linear picture. Developing is white balance, colour matrix, tone curve
and 8-bit coding, in this order.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

from huesphere.configs.schema import Camera
from huesphere.render.sensor import FILTERS, clips, mosaic
from huesphere.scenes.cameras import observer
from huesphere.scenes.encoding import encode_srgb
from huesphere.scenes.spectra import emission

# CIE XYZ to linear sRGB, IEC 61966-2-1
XYZ_TO_SRGB = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])
CONTRAST = 0.5  # share of the smoothstep 3y² − 2y³ in the film-like tone curve
BRIGHT = 99.9  # percentile of the samples that developing does not let exceed full scale
DENOMINATOR = 10_000  # of the fractions in a DNG file


# ---- the developed picture -----------------------------------------------------------------------------------------


def developed(picture: np.ndarray, camera: Camera, sensitivity: np.ndarray) -> np.ndarray:
    """The 8-bit picture (H, W, 3) for eyes, of a linear ``picture`` (H, W, 3) with full scale 1.

    ``sensitivity`` (wavelengths, 3) is that of the camera. A pixel with a clipped sample is limited to full scale in
    all channels after white balance, so that it has no false colour. A picture that is too bright after white balance
    is darkened until its percentile BRIGHT is at full scale.
    """
    gains = white_balance_gains(picture, camera, sensitivity)
    clipped = (picture >= 1.0).any(axis=-1, keepdims=True) & clips(camera)
    balanced = np.where(clipped, np.minimum(picture * gains, 1.0), picture * gains)
    balanced = balanced / max(1.0, float(np.percentile(balanced, BRIGHT)))
    linear = balanced @ colour_matrix(camera, sensitivity, gains).T
    return np.round(255 * tone_curve(np.clip(linear, 0.0, 1.0), camera.tone_curve)).astype(np.uint8)


def white_balance_gains(picture: np.ndarray, camera: Camera, sensitivity: np.ndarray) -> np.ndarray:
    """Factors (3,) of red, green and blue: those of the config where it gives three numbers, and ones for "none".

    Otherwise the channel that is amplified least has 1. "daylight" makes a white surface under D65 grey, "grey world"
    the mean of the ``picture`` (H, W, 3); where a channel of that mean is 0, it is as "daylight".
    """
    if camera.white_balance == "none":
        return np.ones(3)
    if not isinstance(camera.white_balance, str):
        return np.array(camera.white_balance)
    neutral = emission("D65") @ sensitivity
    if camera.white_balance == "grey world":
        mean = np.clip(picture, 0.0, 1.0).reshape(-1, 3).mean(axis=0)
        neutral = mean if mean.min() > 0 else neutral
    return np.asarray(neutral.max() / neutral)


def colour_matrix(camera: Camera, sensitivity: np.ndarray, gains: np.ndarray) -> np.ndarray:
    """The matrix (3, 3) from balanced camera colours to linear sRGB; it leaves grey grey.

    "fitted": least squares over wavelengths from the camera's sensitivities to the curves of sRGB. It is exact only for
    a camera that sees as the observer does.
    """
    if camera.colour_matrix == "none":
        return np.eye(3)
    if not isinstance(camera.colour_matrix, str):
        return np.array(camera.colour_matrix)
    matrix = np.linalg.lstsq(sensitivity * gains, observer() @ XYZ_TO_SRGB.T, rcond=None)[0].T
    return np.asarray(matrix / matrix.sum(axis=1, keepdims=True))


def tone_curve(linear: np.ndarray, name: str) -> np.ndarray:
    """Display values of linear ones (any shape), both from 0 to 1: "none", "srgb", or "film" with more contrast."""
    if name == "none":
        return linear
    encoded = encode_srgb(linear)
    if name == "film":
        encoded = (1 - CONTRAST) * encoded + CONTRAST * encoded**2 * (3 - 2 * encoded)
    return np.asarray(encoded)


def write_developed(folder: Path, picture: np.ndarray, camera: Camera, sensitivity: np.ndarray) -> None:
    """Write ``developed`` into ``folder``: developed.jpg of the config's quality, or developed.png without one."""
    from PIL import Image

    image = Image.fromarray(developed(picture, camera, sensitivity))
    if camera.jpeg_quality is None:
        image.save(folder / "developed.png")
    else:
        image.save(folder / "developed.jpg", quality=camera.jpeg_quality)


# ---- the raw file --------------------------------------------------------------------------------------------------


def write_raw(path: Path, samples: np.ndarray, camera: Camera, sensitivity: np.ndarray) -> None:
    """Write a DNG file (Adobe, version 1.4) of the sensor's ``samples`` (H, W, 3) above black, full scale 1.

    16-bit samples with the camera's black level, one colour for each pixel behind a filter array, otherwise three. A
    camera without ``bits`` is stored with 16. Tags: filter pattern, levels, colour matrix from XYZ, neutral colour
    under D65, and the noise as JSON in the description.
    """
    import tifffile

    white = 2 ** min(camera.bits or 16, 16) - 1
    digital = (camera.black_level + (1 - camera.black_level) * samples) * white
    data = np.clip(np.round(digital), 0, white).astype(np.uint16)
    black = round(camera.black_level * white)
    to_camera = np.linalg.inv(np.linalg.lstsq(sensitivity, observer(), rcond=None)[0].T)
    neutral = emission("D65") @ sensitivity
    scale = np.array([0.9505, 1.0, 1.0890]) @ to_camera.T  # of D65 white
    tags: list[tuple[int | str, int | str, int | None, Any]] = [
        (50706, "B", 4, bytes([1, 4, 0, 0])),  # DNGVersion
        (50707, "B", 4, bytes([1, 1, 0, 0])),  # DNGBackwardVersion
        (50708, "s", 0, "huesphere synthetic camera"),  # UniqueCameraModel
        (50717, "I", 1, white),  # WhiteLevel
        (50721, "2i", 9, _fractions(to_camera.ravel() / scale.max())),  # ColorMatrix1
        (50728, "2I", 3, _fractions(neutral / neutral.max())),  # AsShotNeutral
        (50778, "H", 1, 21),  # CalibrationIlluminant1: D65
    ]
    if camera.filter_array is not None:
        data = mosaic(data, camera.filter_array)
        pattern = bytes(FILTERS.index(letter) for letter in camera.filter_array)
        tags += [(33421, "H", 2, (2, 2)), (33422, "B", 4, pattern), (50714, "I", 1, black)]
    else:
        tags += [(50714, "I", 3, (black, black, black))]
    facts = {key: getattr(camera, key) for key in ("read_noise", "full_well", "bits", "black_level", "exposure")}
    tifffile.imwrite(
        path,
        data,
        photometric=32803 if camera.filter_array is not None else 34892,  # CFA, LinearRaw
        planarconfig=None if camera.filter_array is not None else "contig",
        description=json.dumps({"huesphere": facts}),
        software="huesphere",
        metadata=None,
        extratags=[(*tag, True) for tag in tags],
    )


def _fractions(values: np.ndarray) -> tuple[int, ...]:
    """``values`` (n,) as n numerators, each followed by its denominator."""
    return tuple(int(part) for value in values for part in (round(float(value) * DENOMINATOR), DENOMINATOR))
