"""The data set on disk: observation (what recovery may read) apart from truth (what only evaluation may read).

Field by field in docs/format.md. Imports no renderer, so that recovery and evaluation run without one.
"""

from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from configs.errors import InputError
from render.exr import FORMAT_VERSION, read_exr, write_exr

TRANSPORTS = ("linear", "direct", "one-bounce", "full")


@dataclass(frozen=True)
class CameraInfo:
    """What a photographer knows of the camera: no scene, no light, no truth. Stored in the picture's header.

    Levels and noise are in units of the picture, whose full scale is 1.
    """

    projection: str = "orthographic"  # or "perspective"
    focal_px: float | None = None  # perspective: focal length in pixels, principal point at the picture's centre
    saturation: float | None = None  # values at or above this are clipped; None: nothing clips
    read_noise: float = 0.0  # standard deviation, share of full scale
    full_well: float | None = None  # photo-electrons at full scale; None: no photon noise
    bits: int | None = None  # quantisation; None: none
    encoding: str = "linear"  # or "srgb": display-encoded, as a phone would
    known: bool = True  # False: a picture from elsewhere, of whose camera nothing is known


@dataclass(frozen=True)
class Observation:
    """One colour picture and the outline of the object in it: all that recovery is given."""

    rgb: np.ndarray  # (H, W, 3) float32, linear camera units, full scale 1
    mask: np.ndarray  # (H, W) bool, True on the object
    camera: CameraInfo = field(default_factory=CameraInfo)


@dataclass(frozen=True)
class Truth:
    """Ground truth at pixel centres, camera frame (x right, y up, z toward the camera); NaN off the object."""

    normals: np.ndarray  # (H, W, 3) float32, unit
    depth: np.ndarray  # (H, W) float32, pixels, toward the camera
    mask: np.ndarray  # (H, W) bool
    attached_shadow: np.ndarray  # (H, W, L) float32, share of light l lost because the surface faces away from it
    cast_shadow: np.ndarray  # (H, W, L) float32, share of light l lost because something stands in its way
    extra: dict[str, np.ndarray] = field(default_factory=dict)  # further per-pixel truth, by channel name
    facts: dict[str, Any] = field(default_factory=dict)  # what is no image: "F" (3x3, picture units), "lights" …


def write_observation(path: Path, observation: Observation) -> None:
    channels = {name: observation.rgb[..., i] for i, name in enumerate("RGB")}
    channels["mask"] = observation.mask
    write_exr(path, channels, {"format_version": FORMAT_VERSION, "camera": asdict(observation.camera)})


def read_observation(path: Path) -> Observation:
    """Read an observation. Raises InputError if channels are missing or the header is of another format."""
    channels, header = read_exr(path)
    _require(channels, ("R", "G", "B", "mask"), path)
    _require_version(header, path)
    known = {f.name for f in fields(CameraInfo)}
    info: dict[str, Any] = {k: v for k, v in header.get("camera", {}).items() if k in known}
    rgb = np.stack([channels[c] for c in "RGB"], axis=-1).astype(np.float32)
    return Observation(rgb=rgb, mask=channels["mask"] > 0.5, camera=CameraInfo(**info))


def write_truth(path: Path, truth: Truth) -> None:
    channels = {f"normal.{axis}": truth.normals[..., i] for i, axis in enumerate("XYZ")}
    channels["depth.Z"] = truth.depth
    channels["mask"] = truth.mask
    for light in range(truth.attached_shadow.shape[-1]):
        channels[f"light{light}.attached_shadow"] = truth.attached_shadow[..., light]
        channels[f"light{light}.cast_shadow"] = truth.cast_shadow[..., light]
    channels["lights_seen"] = lights_seen(truth)
    channels.update(truth.extra)
    header = {"format_version": FORMAT_VERSION, "lights": truth.attached_shadow.shape[-1], "facts": truth.facts}
    write_exr(path, channels, header)


def read_truth(path: Path) -> Truth:
    """Read ground truth. Only evaluation may call this."""
    channels, header = read_exr(path)
    _require(channels, ("normal.X", "normal.Y", "normal.Z", "depth.Z", "mask"), path)
    _require_version(header, path)
    count = int(header.get("lights", 0))
    per_light = [f"light{i}.{kind}" for kind in ("attached_shadow", "cast_shadow") for i in range(count)]
    _require(channels, per_light, path)
    shape = channels["mask"].shape

    def stack(kind: str) -> np.ndarray:
        images = [channels[f"light{i}.{kind}"] for i in range(count)]
        return np.stack(images, axis=-1) if images else np.zeros((*shape, 0), np.float32)

    own = {"normal.X", "normal.Y", "normal.Z", "depth.Z", "mask", "lights_seen", *per_light}
    return Truth(
        normals=np.stack([channels[f"normal.{a}"] for a in "XYZ"], axis=-1),
        depth=channels["depth.Z"],
        mask=channels["mask"] > 0.5,
        attached_shadow=stack("attached_shadow"),
        cast_shadow=stack("cast_shadow"),
        extra={name: image for name, image in channels.items() if name not in own},
        facts=header.get("facts", {}),
    )


def lights_seen(truth: Truth) -> np.ndarray:
    """How many lights a pixel sees, (H, W): a light of which half is hidden counts one half."""
    return np.asarray(np.sum(1.0 - truth.attached_shadow - truth.cast_shadow, axis=-1), dtype=np.float32)


def _require(channels: dict[str, np.ndarray], names: tuple[str, ...] | list[str], path: Path) -> None:
    missing = [name for name in names if name not in channels]
    if missing:
        raise InputError(f"no channel {missing[0]!r}", got=f"channels {', '.join(sorted(channels)[:12])}", where=path)


def _require_version(header: dict[str, Any], path: Path) -> None:
    version = header.get("format_version")
    if version != FORMAT_VERSION:
        raise InputError("format_version", got=version, expected=str(FORMAT_VERSION), where=path)
