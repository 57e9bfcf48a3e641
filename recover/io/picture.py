"""Any picture as an observation: PNG and JPEG of 8 or 16 bits, TIFF, OpenEXR, NumPy arrays; region and mask.

Nothing is known of the camera of such a picture: display formats are taken to be sRGB and are decoded, float formats to
be linear. Both are said aloud, and both can be overruled.
"""

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.picture_size import require_size
from huesphere.render.dataset import CameraInfo, KnownLights, Observation, linear_light, read_observation
from huesphere.render.exr import read_exr

READABLE = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr", ".npy", ".npz")
ENCODINGS = ("auto", "srgb", "linear")


def read_picture(
    path: Path, *, region: tuple[int, int, int, int] | None = None, mask: Path | None = None, encoding: str = "auto"
) -> tuple[Observation, str]:
    """(observation in linear light, one line on how it was read) of the picture at ``path``.

    ``region`` (x0, y0, x1, y1) in pixels from the top left, x1, y1 exclusive, cuts the picture, or
    of one in perspective the mask alone, for its rays meet behind the middle of the whole; ``mask`` is a picture of the
    whole's size, the object where it is over half bright. Without a mask all is object. Raises InputError.
    """
    if not path.is_file():
        raise InputError("no such picture", where=path)
    if path.suffix.lower() not in READABLE:
        raise InputError(
            "a kind of picture that is not read", got=path.suffix, expected=", ".join(READABLE), where=path
        )
    values, bits, own_mask, camera = _samples(path)
    _require_pixels(values, path)
    lights = read_observation(path).lights if camera is not None else None
    if values.ndim != 3 or values.shape[2] < 3:
        raise InputError(
            "a colour picture", got=f"an array of shape {values.shape}", expected="three channels", where=path
        )
    values = values[..., :3]
    inside = own_mask if own_mask is not None else np.ones(values.shape[:2], bool)
    if inside.shape != values.shape[:2]:
        raise InputError(
            "mask and picture differ in size", got=str(inside.shape), expected=str(values.shape[:2]), where=path
        )
    if mask is not None:
        inside = read_mask(mask, values.shape[:2])
    if camera is None:
        encoded = "srgb" if bits else "linear"
        how = f"{bits}-bit, taken as sRGB and decoded" if bits else "floating point, taken as linear"
        if encoding != "auto":
            encoded, how = encoding, f"taken as {encoding}, as --encoding says"
        camera = CameraInfo(encoding=encoded, bits=bits, saturation=1.0 if bits else None, known=False)
    else:
        how = "an observation of a run folder, with what is known of its camera"
    if region is not None:
        if camera.projection == "perspective":
            x0, y0, _, _ = region
            kept = _cut(inside, region, path)
            inside = np.zeros_like(inside)
            inside[y0 : y0 + kept.shape[0], x0 : x0 + kept.shape[1]] = kept
        else:
            whole = values.shape
            values, inside = (_cut(image, region, path) for image in (values, inside))
            lights = None if lights is None else _seen_from_middle(lights, whole, region)
    if inside.any() and not np.isfinite(values[inside]).any():
        raise InputError("a picture without a finite value on the object", where=path)
    decoded = linear_light(Observation(values, np.ascontiguousarray(inside), camera, lights))  # in the file's precision
    return replace(decoded, rgb=np.ascontiguousarray(decoded.rgb, np.float32)), f"{path.name}: {how}"


def read_mask(path: Path, shape: tuple[int, int]) -> np.ndarray:
    """The mask (H, W) in a picture: True where the first channel is over half of full scale. Raises InputError."""
    if not path.is_file():
        raise InputError("no such mask", where=path)
    values, _, own, _ = _samples(path)
    _require_pixels(values, path)
    image = own if own is not None and values.ndim != 2 else (values if values.ndim == 2 else values[..., 0])
    if image.shape != shape:
        raise InputError("mask and picture differ in size", got=str(image.shape), expected=str(shape), where=path)
    return np.asarray(image > 0.5)


def _require_pixels(values: np.ndarray, path: Path) -> None:
    """Raise InputError for an array without samples, and for one that is no picture."""
    if values.ndim not in (2, 3) or 0 in values.shape:
        got = f"an array of shape {values.shape}"
        raise InputError("not a picture", got=got, expected="rows of pixels", where=path)


def _cut(image: np.ndarray, region: tuple[int, int, int, int], path: Path) -> np.ndarray:
    x0, y0, x1, y1 = region
    height, width = image.shape[:2]
    if not (0 <= x0 < x1 <= width and 0 <= y0 < y1 <= height):
        raise InputError(
            "--region",
            got=f"{x0},{y0},{x1},{y1}",
            expected=f"0 ≤ X0 < X1 ≤ {width}, 0 ≤ Y0 < Y1 ≤ {height}",
            where=path,
        )
    return image[y0:y1, x0:x1]


def _seen_from_middle(lights: KnownLights, shape: tuple[int, ...], region: tuple[int, int, int, int]) -> KnownLights:
    """The places of lights from the middle of a region of a picture of ``shape``."""
    x0, y0, x1, y1 = region
    shift = ((x0 + x1 - shape[1]) / 2, (shape[0] - y0 - y1) / 2, 0.0)
    return lights._replace(positions=lights.positions - shift)


def _samples(path: Path) -> tuple[np.ndarray, int | None, np.ndarray | None, CameraInfo | None]:
    """(values with full scale 1, bits or None if floating point, mask if the file has one, camera if it is ours)."""
    suffix = path.suffix.lower()
    try:
        require_size(path)
        if suffix == ".exr":
            return _exr(path)
        if suffix in (".npy", ".npz"):
            return _arrays(path)
        if suffix in (".tif", ".tiff"):
            import tifffile

            logging.getLogger("tifffile").setLevel(logging.CRITICAL)  # what it cannot read is told below
            return _scaled(tifffile.imread(path), path)
        return _scaled(_display_picture(path), path)
    except InputError:
        raise
    except Exception as error:  # readers of pictures raise types of their own
        raise InputError(
            "not a readable picture", got=f"{type(error).__name__}: {str(error)[:80]}", where=path
        ) from None


def _exr(path: Path) -> tuple[np.ndarray, int | None, np.ndarray | None, CameraInfo | None]:
    channels, header = read_exr(path)
    if "camera" in header:
        ours = read_observation(path)
        return ours.rgb, None, ours.mask, ours.camera
    names = [next((n for n in (c, c.lower(), f"rgb.{c}", f"RGB.{c}") if n in channels), None) for c in "RGB"]
    if None in names:
        only = next(iter(channels.values()))
        if len(channels) == 1:
            return only, None, None, None
        raise InputError("no channels R, G, B", got=f"channels {', '.join(sorted(channels)[:12])}", where=path)
    mask = channels["mask"] > 0.5 if "mask" in channels else None
    return np.stack([channels[str(n)] for n in names], axis=-1), None, mask, None


def _arrays(path: Path) -> tuple[np.ndarray, int | None, np.ndarray | None, CameraInfo | None]:
    loaded = np.load(path, allow_pickle=False)
    if isinstance(loaded, np.ndarray):
        return _scaled(loaded, path)
    with loaded as file:
        name = next((n for n in ("rgb", "image", "picture", "mask") if n in file), None)
        if name is None:
            raise InputError("no array 'rgb'", got=f"arrays {', '.join(file.files)}", where=path)
        values, bits, _, _ = _scaled(file[name], path)
        return values, bits, file["mask"] > 0.5 if "mask" in file else None, None


def _scaled(values: np.ndarray, path: Path) -> tuple[np.ndarray, int | None, np.ndarray | None, CameraInfo | None]:
    if values.dtype == bool:
        return values.astype(np.float32), None, None, None
    if values.dtype in (np.uint8, np.uint16):
        bits = 8 * values.dtype.itemsize
        return values / (2**bits - 1), bits, None, None
    if values.dtype.kind == "f":
        return values, None, None, None
    raise InputError(
        "samples of a kind that is not read", got=str(values.dtype), expected="uint8, uint16 or float", where=path
    )


def _display_picture(path: Path) -> np.ndarray:
    """PNG or JPEG as uint8 or uint16.

    Pillow has no RGB image of 16 bits: it keeps the high byte of each sample and drops the low one without a word. Its
    decoder can as well be asked for the samples' second bytes, so such a picture is decoded twice.
    """
    from PIL import Image, ImageOps

    with Image.open(path) as picture:
        if (
            picture.format == "PNG"
            and picture.tile
            and str(picture.tile[0].args).endswith(";16B")
            and picture.mode.startswith("RGB")
        ):
            high = np.asarray(picture)
            with Image.open(path) as again:
                again.tile = [tile._replace(args=str(tile.args).replace(";16B", ";16L")) for tile in again.tile]
                low = np.asarray(again)
            return (high.astype(np.uint16) << 8 | low)[..., :3]
        if picture.mode.startswith("I"):
            return np.asarray(picture).astype(np.uint16)
        if picture.mode == "L":
            return np.asarray(picture)
        return np.asarray(ImageOps.exif_transpose(picture).convert("RGB"))  # as the photographer held the camera
