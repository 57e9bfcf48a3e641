"""Depth from an OpenEXR file: the channel that holds it, in any part or layer, and whether it is a distance.

A channel called Z is by the convention of OpenEXR the distance from the camera, and renderers write it so; layers put
their names before it ("ViewLayer.Depth.Z"). ``depth.Z`` is the channel of this project's own files, toward the camera.
"""

import os
from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.quiet import silence
from huesphere.scenes.depth_maps.stored import StoredDepth

OWN = "depth.Z"
OTHERS = ("depth", "Y")  # further names of a channel that holds depth, toward the camera


def read_exr(path: Path, channel: str | None) -> StoredDepth:
    """The depth in an EXR file: the one ``channel``, or the only one that can be depth. Raises InputError."""
    import OpenEXR

    with silence(), OpenEXR.File(os.fsencode(path), separate_channels=True) as file:
        parts = [{name: np.array(c.pixels) for name, c in part.channels.items()} for part in file.parts]
    found = [(number, name) for number, part in enumerate(parts) for name in part]
    names = [name for _, name in found]
    name = _chosen(names, parts, channel, path)
    number = next(number for number, other in found if other == name)
    part = parts[number]
    is_distance = name != OWN and _last(name) in ("Z", "V")
    return StoredDepth(
        part[name],
        mask=part["mask"] > 0.5 if "mask" in part else None,
        is_distance=is_distance,
        said=(f"channel {name}",) if len(names) > 1 else (),
    )


def _chosen(names: list[str], parts: list[dict[str, np.ndarray]], channel: str | None, path: Path) -> str:
    """The name of the channel with the depth."""
    listed = ", ".join(dict.fromkeys(names))
    if channel is not None:
        if channel not in names:
            raise InputError("shape.channel", got=channel, expected=f"one of {listed}", where=path)
        return channel
    if OWN in names:
        return OWN
    distances = [name for name in dict.fromkeys(names) if _may_be_distance(name, names)]
    named = [name for name in distances if "depth" in name.lower()] if len(distances) > 1 else distances
    if "Z" in distances or len(named) == 1:
        return "Z" if "Z" in distances else named[0]
    if len(distances) > 1:
        raise InputError(
            "several channels may be the depth", got=", ".join(distances), expected="one as shape.channel", where=path
        )
    for name in OTHERS:
        if name in names:
            return name
    grey = next((part for part in parts if "R" in part), None)
    if grey is not None and all(np.array_equal(grey["R"], grey.get(other, grey["R"])) for other in "GB"):
        return "R"
    expected = "depth.Z, Z, a layer's Z, depth, Y or a grey R; or its name as shape.channel"
    raise InputError("no depth channel", got=f"channels {listed}", expected=expected, where=path)


def _may_be_distance(name: str, names: list[str]) -> bool:
    """Whether a channel may be a distance: called Z, or V of a depth layer; not the third component of a vector."""
    layer, last = name.rpartition(".")[0], _last(name)
    if last == "V":
        return "depth" in layer.lower()
    vector = any(f"{layer}.{other}".lstrip(".") in names for other in ("X", "Y"))
    return last == "Z" and not (layer and vector)


def _last(name: str) -> str:
    return name.rpartition(".")[2]
