"""OpenEXR files of any program: the part and the layer that are the picture, the display window, alpha, primaries.

A file has parts, each with channels named <layer>.<channel>. Three channels R, G, B of one layer of one part are a
candidate for the picture. Where there are several, the one whose name says colour is it; where none says so, the user
has to choose.
"""

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

from huesphere.configs.errors import InputError
from huesphere.configs.quiet import silence
from huesphere.recover.io.axes import check_size
from huesphere.recover.io.stored import ReadOptions, Stored
from huesphere.render.dataset import read_observation
from huesphere.render.exr import HEADER_KEY, damage_told

COLOUR_WORDS = ("rgba", "rgb", "c", "beauty", "combined", "color", "colour", "image", "picture", "default")
OTHER_WORDS = (  # of layers that are not the picture, though they may have channels R, G, B
    *("n", "normal", "normals", "depth", "z", "p", "position", "uv", "mist", "vector", "motion", "albedo"),
    *("diffcol", "glosscol", "transcol", "shadow", "ao", "emit", "env", "denoising"),
)
ALPHA = ("A", "a", "alpha", "Alpha")


@dataclass(frozen=True)
class Candidate:
    """Three channels that may be the picture, by their names."""

    part: int
    part_name: str
    layer: str  # "" for channels without a prefix
    channels: tuple[str, str, str]

    @property
    def name(self) -> str:
        """How messages call it."""
        return self.layer or self.part_name or "R, G, B"

    @property
    def words(self) -> tuple[str, ...]:
        """What its layer and its part are called, the last word of each, lower case."""
        return tuple(w.rsplit(".", 1)[-1].lower() for w in (self.layer, self.part_name) if w)


def read_exr_picture(path: Path, options: ReadOptions) -> Stored:
    """The picture in an OpenEXR file. Raises InputError if it cannot be read, or has several that may be meant."""
    parts, headers = _parts(path)
    if HEADER_KEY in headers[0] and "camera" in json.loads(headers[0][HEADER_KEY]):
        ours = read_observation(path)
        return Stored(ours.rgb, mask=ours.mask, observation=ours, certain=True)
    found = _candidates(parts, headers)
    if not found:
        only = [(k, name) for k, channels in enumerate(parts) for name in channels]
        if len(only) == 1 and options.part is None and options.layer is None:  # a mask
            k, name = only[0]
            return Stored(_in_display_window(parts[k][name], headers[k], path))
        listed = ", ".join(sorted(name for _, name in only)[:12])
        raise InputError("no channels R, G, B", got=f"channels {listed}", where=path)
    chosen = _chosen(found, headers, options, path)
    return _stored(chosen, len(parts), parts[chosen.part], headers[chosen.part], path)


def _parts(path: Path) -> tuple[list[dict[str, np.ndarray]], list[dict[str, Any]]]:
    """(channels (H, W) by name, header) of each part. Raises InputError."""
    with damage_told(path):
        with silence(), OpenEXR.File(os.fsencode(path), header_only=True) as file:
            for part in file.parts:
                check_size(4 * len(part.header["channels"]) * int(np.prod(_size(part.header["dataWindow"]))), path)
        with silence(), OpenEXR.File(os.fsencode(path), separate_channels=True) as file:
            headers = [dict(part.header) for part in file.parts]
            parts = [{n: np.array(c.pixels) for n, c in part.channels.items()} for part in file.parts]
            names = [part.name() for part in file.parts]
    for channels, header, name in zip(parts, headers, names):
        header["name"] = name
        if "deep" in str(header.get("type", "")):
            raise InputError("an OpenEXR file of deep pixels", expected="flat ones", where=path)
        size = _size(header["dataWindow"])
        for key in [key for key, image in channels.items() if image.shape != size]:  # subsampled chroma, for one
            del channels[key]
    if not any(parts):
        raise InputError("an OpenEXR file without channels of full size", where=path)
    return parts, headers


def _candidates(parts: list[dict[str, np.ndarray]], headers: list[dict[str, Any]]) -> list[Candidate]:
    found = []
    for k, channels in enumerate(parts):
        layers = dict.fromkeys(name.rpartition(".")[0] for name in channels)
        for layer in layers:
            own = {name.rpartition(".")[2].lower(): name for name in channels if name.rpartition(".")[0] == layer}
            for names in (("r", "g", "b"), ("red", "green", "blue")):
                if all(name in own for name in names):
                    trio = (own[names[0]], own[names[1]], own[names[2]])
                    found.append(Candidate(k, headers[k]["name"], layer, trio))
                    break
    return found


def _chosen(found: list[Candidate], headers: list[dict[str, Any]], options: ReadOptions, path: Path) -> Candidate:
    """The candidate that the user names, or that is the only one, or the only one whose name says colour."""
    part_names = [header["name"] or str(k) for k, header in enumerate(headers)]
    if options.part is not None:
        number = int(options.part) if options.part.isdigit() and options.part not in part_names else None
        found = [c for c in found if options.part == c.part_name or c.part == number]
        if not found:
            expected = f"a part with channels R, G, B; the file's parts are {', '.join(part_names[:12])}"
            raise InputError("--part", got=options.part, expected=expected, where=path)
    if options.layer is not None:
        layers = sorted({c.layer for c in found})
        exact = [c for c in found if c.layer == options.layer]
        found = exact or [c for c in found if c.layer.rsplit(".", 1)[-1].lower() == options.layer.lower()]
        if not found:
            expected = f"a layer with channels R, G, B: {', '.join(name or '(no prefix)' for name in layers[:12])}"
            raise InputError("--layer", got=options.layer, expected=expected, where=path)
    if len(found) == 1:
        return found[0]
    named = [c for c in found if c.words and all(w in COLOUR_WORDS for w in c.words)]
    plain = [c for c in found if not c.layer and not any(w in OTHER_WORDS for w in c.words)]
    coloured = [c for c in found if any(w in COLOUR_WORDS for w in c.words)]
    for candidates in (plain if len(headers) == 1 else named, named, plain, coloured):
        if len(candidates) == 1:
            return candidates[0]
    several_parts = len({c.part for c in found}) > 1
    what = f"{len(headers)} parts" if several_parts else f"{len(found)} layers"
    listed = dict.fromkeys(part_names if several_parts else (c.layer or "(no prefix)" for c in found))
    option = "--part" if several_parts else "--layer"
    raise InputError(f"{what} that may be the picture", got=", ".join(listed), expected=f"{option} NAME", where=path)


def _stored(
    chosen: Candidate, parts: int, channels: dict[str, np.ndarray], header: dict[str, Any], path: Path
) -> Stored:
    """The candidate's samples in the display window, with alpha or mask, and what was done in words."""
    colours = np.stack([_in_display_window(channels[name], header, path) for name in chosen.channels], axis=-1)
    prefix = f"{chosen.layer}." if chosen.layer else ""
    alpha = next((channels[prefix + name] for name in ALPHA if prefix + name in channels), None)
    mask = channels.get("mask")
    remarks, mask_name = [], "its mask"
    if parts > 1:
        remarks.append(f"part {chosen.part_name or chosen.part} of {parts}")
    if chosen.layer:
        remarks.append(f"layer {chosen.layer}")
    height, width = _size(header["dataWindow"])
    if _windows_differ(header):
        remarks.append(f"data window {width}×{height} in a display window {colours.shape[1]}×{colours.shape[0]}")
        if alpha is None and mask is None:
            mask, mask_name = np.ones((height, width), np.float32), "its data window"
    whites = header.get("chromaticities")
    if whites is not None:
        remarks.append("its primaries are kept and need no conversion")
    return Stored(
        colours,
        alpha=None if alpha is None else _in_display_window(alpha, header, path).astype(np.float64),
        premultiplied=True,
        mask=None if mask is None else _in_display_window(mask, header, path),
        mask_name=mask_name,
        chromaticities=None if whites is None else tuple(float(v) for v in whites),
        remarks=tuple(remarks),
    )


def _windows_differ(header: dict[str, Any]) -> bool:
    return any(np.any(np.asarray(a) != np.asarray(b)) for a, b in zip(header["dataWindow"], header["displayWindow"]))


def _size(window: Any) -> tuple[int, int]:
    """(height, width) of a window, given by its first and last pixel (x, y)."""
    (x0, y0), (x1, y1) = ((int(v) for v in corner) for corner in window)
    return y1 - y0 + 1, x1 - x0 + 1


def _in_display_window(image: np.ndarray, header: dict[str, Any], path: Path) -> np.ndarray:
    """An image of the data window in the display window: cut where it reaches out, black where it has no data."""
    if not _windows_differ(header):
        return image
    (x0, y0), _ = ((int(v) for v in corner) for corner in header["dataWindow"])
    (left, top), _ = ((int(v) for v in corner) for corner in header["displayWindow"])
    height, width = _size(header["displayWindow"])
    check_size(4 * height * width, path)
    whole = np.zeros((height, width), image.dtype)
    rows, columns = (max(0, y0 - top), max(0, x0 - left))
    from_row, from_column = max(0, top - y0), max(0, left - x0)
    inside = image[from_row : from_row + height - rows, from_column : from_column + width - columns]
    whole[rows : rows + inside.shape[0], columns : columns + inside.shape[1]] = inside
    return whole
