"""Any picture as an observation in linear light: read as its file says, corrected, turned upright, cut, and masked.

What a file says of itself is obeyed: how its samples are encoded, which way up it is, which pixels it covers. What it
does not say is taken as is usual for its kind, and said in one line; `--encoding` overrules both.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.recover.io.decoding import Decoded, decode
from huesphere.recover.io.files import read_stored
from huesphere.recover.io.frames import Frame, correct
from huesphere.recover.io.levels import Levels
from huesphere.recover.io.mask import object_in, read_mask, varies
from huesphere.recover.io.orientation import TURNED, is_turned, upright
from huesphere.recover.io.stored import ReadOptions, Stored
from huesphere.render.dataset import CameraInfo, KnownLights, Observation

Region = tuple[int, int, int, int]

__all__ = ["PictureRead", "ReadOptions", "open_picture", "read_mask", "read_picture"]


@dataclass(frozen=True)
class PictureRead:
    """A picture that was read, and what is known of how its samples were encoded."""

    observation: Observation  # in linear light
    how: str  # one line: how the file was read, what was obeyed and what was guessed
    encoded: str  # how the samples were encoded: "linear", "sRGB", "gamma 2.2" …
    guessed: bool  # that they were is a guess between linear and sRGB, which are both common
    certain: bool  # nothing else is possible: raw data of a sensor, or a picture of this project
    unmasked: bool = False  # neither the user nor the file says where the object is


def read_picture(
    path: Path,
    *,
    region: Region | None = None,
    mask: Path | None = None,
    encoding: str = "auto",
    options: ReadOptions = ReadOptions(),  # noqa: B008 (frozen)
) -> tuple[Observation, str]:
    """(observation in linear light, one line on how it was read) of the picture at ``path``; see `open_picture`."""
    read = open_picture(path, region=region, mask=mask, encoding=encoding, options=options)
    return read.observation, read.how


def open_picture(
    path: Path,
    *,
    region: Region | None = None,
    mask: Path | None = None,
    encoding: str = "auto",
    options: ReadOptions = ReadOptions(),  # noqa: B008 (frozen)
) -> PictureRead:
    """The picture at ``path`` in linear light, upright, with its object.

    ``region`` (x0, y0, x1, y1) in pixels of the upright picture from the top left, x1, y1 exclusive, cuts the picture,
    or of one in perspective the mask alone, for its rays meet behind the middle of the whole. ``mask``: a picture of
    the whole's size that says where the object is; without it the object is where the file's own mask or alpha says;
    without these, everywhere. ``encoding``: "auto" obeys the file. ``options``: which part of a file, dark and flat
    frames, levels. Raises InputError.
    """
    if not path.is_file():
        raise InputError("no such picture", where=path)
    stored = read_stored(path, options)
    words: list[str] = []
    unmasked = mask is None and region is None and stored.observation is None and not _says_where(stored)
    if stored.observation is not None:
        observation, guessed, encoded = _own(stored.observation, encoding, options, path), False, "linear"
        words.append("an observation of a run folder, with what is known of its camera")
    else:
        observation, guessed, encoded = _decoded(stored, path, encoding, options, words, masked=mask is not None)
    if mask is not None:
        inside, said = read_mask(mask, observation.mask.shape)
        observation = replace(observation, mask=inside)
        words.append(said)
    if region is not None:
        observation = _cut_out(observation, region, path)
    if observation.mask.any() and not np.isfinite(observation.rgb[observation.mask]).any():
        raise InputError("a picture without a finite value on the object", where=path)
    return PictureRead(observation, f"{path.name}: {'; '.join(words)}", encoded, guessed, stored.certain, unmasked)


def _decoded(
    stored: Stored, path: Path, encoding: str, options: ReadOptions, words: list[str], *, masked: bool
) -> tuple[Observation, bool, str]:
    """(the observation, whether its encoding is a guess, its name) of samples from elsewhere.

    What was done is added to ``words``. If ``masked``, the user gives a mask, and the file's own is not looked at.
    """
    channels = stored.values.shape[2] if stored.values.ndim == 3 else 1
    if channels != (4 if stored.inks else 3):
        got = "a grey picture, one channel" if channels == 1 else f"an array of shape {stored.values.shape}"
        raise InputError("a colour picture", got=got, expected="three channels", where=path)
    if stored.values.dtype.kind != "f" and stored.full_scale is None:
        got, expected = str(stored.values.dtype), "uint8, uint16 or float"
        raise InputError("samples of a kind that is not read", got=got, expected=expected, where=path)
    _check(stored, encoding, options, path)
    decoded = decode(stored, encoding=encoding, white_level=options.white_level)
    words += [*decoded.words, *stored.remarks]
    inside = np.ones(stored.values.shape[:2], bool) if masked else _own_mask(stored, path, words)
    light, saturation = decoded.light, decoded.saturation
    if options.dark is not None or options.flat is not None:
        dark, flat = (_frame(frame, options, encoding, decoded.levels) for frame in (options.dark, options.flat))
        corrected = correct(light, decoded.clipped, dark, flat)
        light, saturation = corrected.light, corrected.saturation
        words += corrected.words
    if is_turned(stored.orientation):
        words.append(f"{TURNED[stored.orientation]} to stand upright, as its orientation tag says")
    camera = CameraInfo(
        bits=None if decoded.levels is None else decoded.levels.bits,
        saturation=saturation,
        stored_as="linear" if decoded.name == "linear" else "srgb",
        known=False,
        chromaticities=stored.chromaticities,
    )
    rgb = np.ascontiguousarray(upright(light, stored.orientation), np.float32)
    mask = np.ascontiguousarray(upright(inside, stored.orientation))
    return Observation(rgb, mask, camera), decoded.guessed, decoded.name


def _check(stored: Stored, encoding: str, options: ReadOptions, path: Path) -> None:
    """Raise InputError for what the user says and the file's samples cannot mean."""
    if stored.certain and encoding == "srgb":
        raise InputError("--encoding", got=encoding, expected="linear, which a sensor's samples are", where=path)
    if stored.inks and encoding != "auto":
        raise InputError("--encoding is for pictures of light", got="one of inks (CMYK)", where=path)
    if options.white_level is None or stored.certain:
        return
    if stored.inks:
        raise InputError("--white-level is for pictures of light", got="one of inks (CMYK)", where=path)
    if stored.full_scale is not None and options.white_level > stored.full_scale:
        got, expected = f"{options.white_level:g}", f"at most {stored.full_scale:g}, the file's full scale"
        raise InputError("--white-level", got=got, expected=expected, where=path)


def _frame(path: Path | None, options: ReadOptions, encoding: str, like: Levels | None) -> Frame | None:
    """A dark or flat frame in linear light, read as the picture is, with the levels of its samples."""
    if path is None:
        return None
    if not path.is_file():
        raise InputError("no such frame", where=path)
    stored = read_stored(path, options)
    if stored.inks or stored.values.ndim != 3 or stored.values.shape[2] != 3:
        raise InputError("a frame in colour", got=f"an array of shape {stored.values.shape}", where=path)
    decoded: Decoded = decode(stored, encoding=encoding, white_level=options.white_level, like=like)
    return Frame(decoded.light, decoded.clipped, path)


def _own_mask(stored: Stored, path: Path, words: list[str]) -> np.ndarray:
    """Where the object is by the file's own mask or alpha; everywhere, if it has neither that says anything."""
    everywhere = np.ones(stored.values.shape[:2], bool)
    if stored.mask is not None:
        if stored.mask.shape != everywhere.shape:
            got, expected = str(stored.mask.shape), str(everywhere.shape)
            raise InputError("mask and picture differ in size", got=got, expected=expected, where=path)
        inside, rule = object_in(stored.mask, None, path)
        words.append(f"object where {stored.mask_name} is {rule}, {int(inside.sum())} px")
        return inside
    if stored.alpha is None:
        return everywhere
    inside = np.asarray(stored.alpha > 0.5)
    if varies(stored.alpha) and inside.any():
        words.append(f"object where alpha is over a half, {int(inside.sum())} px")
        return inside
    if not inside.all():
        words.append("alpha is nowhere over a half, and not used")
    return everywhere


def _says_where(stored: Stored) -> bool:
    """Whether a file has a mask or an alpha channel, whatever it says; one that is opaque all over says nothing."""
    return stored.mask is not None or (stored.alpha is not None and not bool(np.all(stored.alpha >= 1)))


def _own(observation: Observation, encoding: str, options: ReadOptions, path: Path) -> Observation:
    """The observation of a run folder, of which nothing is left to be said. Raises InputError for options."""
    if encoding == "srgb":
        raise InputError("--encoding", got=encoding, expected="auto: the file says how it is encoded", where=path)
    for name in ("dark", "flat", "white_level", "part", "layer"):
        if getattr(options, name) is not None:
            option = f"--{name.replace('_', '-')}"
            raise InputError(f"{option} is for pictures of cameras", got="an observation of a run folder", where=path)
    return observation


def _cut_out(observation: Observation, region: Region, path: Path) -> Observation:
    """The region of an observation; of one in perspective the whole, with its mask cut."""
    if observation.camera.projection == "perspective":
        x0, y0, _, _ = region
        kept = _cut(observation.mask, region, path)
        inside = np.zeros_like(observation.mask)
        inside[y0 : y0 + kept.shape[0], x0 : x0 + kept.shape[1]] = kept
        return replace(observation, mask=inside)
    rgb, inside = (np.ascontiguousarray(_cut(image, region, path)) for image in (observation.rgb, observation.mask))
    lights = observation.lights
    lights = None if lights is None else _seen_from_middle(lights, observation.rgb.shape, region)
    return replace(observation, rgb=rgb, mask=inside, lights=lights)


def _cut(image: np.ndarray, region: Region, path: Path) -> np.ndarray:
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


def _seen_from_middle(lights: KnownLights, shape: tuple[int, ...], region: Region) -> KnownLights:
    """The places of lights from the middle of a region of a picture of ``shape``."""
    x0, y0, x1, y1 = region
    shift = ((x0 + x1 - shape[1]) / 2, (shape[0] - y0 - y1) / 2, 0.0)
    return lights._replace(positions=lights.positions - shift)
