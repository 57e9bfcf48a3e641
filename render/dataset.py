"""The data set on disk: the observation, which recovery may read, and the truth, which only evaluation may read.

docs/format.md describes each field. This module imports no renderer, so that recovery and evaluation run without one.
"""

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.own_folder import inside
from huesphere.configs.schema import RunConfig
from huesphere.render.exr import FORMAT_VERSION, read_exr, write_exr
from huesphere.render.inputs import read_item_config
from huesphere.render.layers import Layers, layers_of
from huesphere.render.manifest import TRANSPORTS as TRANSPORTS
from huesphere.render.manifest import item_folder, read_manifest
from huesphere.scenes.encoding import ENCODINGS, decode_srgb


@dataclass(frozen=True)
class CameraInfo:
    """The facts that a photographer knows of the camera; they are stored in the picture's header.

    Levels and noise are in units of the picture, whose full scale is 1.
    """

    projection: str = "orthographic"  # or "perspective"
    focal_px: float | None = None  # perspective: focal length in pixels, principal point at the picture's centre
    saturation: float | None = None  # values at or above this are clipped; None: nothing clips
    read_noise: float = 0.0  # standard deviation, share of full scale
    full_well: float | None = None  # photo-electrons at full scale; None: no photon noise
    bits: int | None = None  # quantisation; None: none
    encoding: str = "linear"  # of the samples in memory; "srgb" only before ``linear_light`` has decoded them
    stored_as: str = "linear"  # in the file: "linear", or "srgb" for samples encoded for a display by any curve
    chromaticities: tuple[float, ...] | None = None  # CIE x, y of red, green, blue, white; None: not known
    known: bool = True  # False: the picture is from another program and nothing is known of its camera

    def of_means(self, factor: int) -> "CameraInfo":
        """The camera of a picture of means over ``factor`` × ``factor`` pixels: less noise, shorter lengths."""
        return replace(
            self,
            focal_px=None if self.focal_px is None else self.focal_px / factor,
            read_noise=self.read_noise / factor,
            full_well=None if self.full_well is None else self.full_well * factor**2,
            bits=None if self.bits is None else self.bits + int(np.log2(factor)),
        )


class KnownLights(NamedTuple):
    """Positions or directions of the lights, without colours, if the config gives them to recovery.

    Camera frame, with the origin at the middle of the picture.
    """

    positions: np.ndarray  # (P, 3) of near lights, pixels; z is measured from the plane where the scene's z is 0
    directions: np.ndarray  # (D, 3) unit, toward distant lights


@dataclass(frozen=True)
class Observation:
    """The input of recovery: one colour picture and the mask of the object in it."""

    rgb: np.ndarray  # (H, W, 3) float32, linear light, full scale 1; functions that read pictures decode them
    mask: np.ndarray  # (H, W) bool, True on the object
    camera: CameraInfo = field(default_factory=CameraInfo)
    lights: KnownLights | None = None  # None: nothing is known of the lights


@dataclass(frozen=True)
class Truth:
    """Ground truth at pixel centres, camera frame (x right, y up, z toward the camera); NaN off the object."""

    normals: np.ndarray  # (H, W, 3) float32, unit
    depth: np.ndarray  # (H, W) float32, pixels, toward the camera
    mask: np.ndarray  # (H, W) bool
    attached_shadow: np.ndarray  # (H, W, L) float32, share of light l lost because the surface faces away from it
    cast_shadow: np.ndarray  # (H, W, L) float32, share of light l lost because another part of the scene blocks it
    extra: dict[str, np.ndarray] = field(default_factory=dict)  # further images (H, W), by channel name
    facts: dict[str, Any] = field(
        default_factory=dict
    )  # truth that is not an image: "F" (3x3, picture units), "lights"


def linear_light(observation: Observation) -> Observation:
    """The observation with its samples decoded to linear light, if they are display-encoded.

    ``camera.stored_as`` keeps the encoding of the file. The saturation level is decoded too, so that the same samples
    count as clipped before and after.
    """
    camera = observation.camera
    if camera.encoding == "linear":
        return observation
    rgb = decode_srgb(observation.rgb.astype(np.float64)).astype(np.float32)
    saturation = None if camera.saturation is None else float(decode_srgb(np.array(camera.saturation)))
    camera = replace(camera, encoding="linear", stored_as=camera.encoding, saturation=saturation)
    return replace(observation, rgb=rgb, camera=camera)


def write_observation(path: Path, observation: Observation) -> None:
    """Write an observation as OpenEXR: channels R, G, B, mask, and a header with camera and known lights."""
    channels = {name: observation.rgb[..., i] for i, name in enumerate("RGB")}
    channels["mask"] = observation.mask
    header = {"format_version": FORMAT_VERSION, "camera": asdict(observation.camera)}
    if observation.lights is not None:
        header["lights"] = {name: np.asarray(v).tolist() for name, v in observation.lights._asdict().items()}
    write_exr(path, channels, header, chromaticities=observation.camera.chromaticities)


def read_observation(path: Path) -> Observation:
    """Read an observation, in linear light. Raises InputError for missing channels or a header of another format."""
    channels, header = read_exr(path)
    _require(channels, ("R", "G", "B", "mask"), path)
    _require_version(header, path)
    rgb = np.stack([channels[c] for c in "RGB"], axis=-1).astype(np.float32)
    mask = channels["mask"] > 0.5
    if mask.any() and not np.isfinite(rgb[mask]).any():
        raise InputError("a picture without a finite value on the object", where=path)
    lights = _known_lights(header["lights"], path) if "lights" in header else None
    return linear_light(Observation(rgb, mask, _camera_info(header.get("camera", {}), path), lights))


def _known_lights(written: Any, path: Path) -> KnownLights:
    """The lights in a header. Raises InputError for anything but lists of three finite numbers."""
    try:
        known = KnownLights(*(np.asarray(written[name], float).reshape(-1, 3) for name in KnownLights._fields))
        if not all(np.isfinite(v).all() for v in known):
            raise ValueError("not finite")
    except (KeyError, TypeError, ValueError):
        raise InputError("header: lights", got=repr(written)[:60], where=path) from None
    return known


def _camera_info(written: Any, path: Path) -> CameraInfo:
    """The camera in a header; unknown keys are ignored. Raises InputError for invalid values."""
    usual = asdict(CameraInfo())
    info = {key: value for key, value in written.items() if key in usual} if isinstance(written, dict) else None
    texts = {"projection": ("orthographic", "perspective"), "encoding": ENCODINGS, "stored_as": ENCODINGS}
    for key, value in (info or {}).items():
        if key in texts:
            right = value in texts[key]
        elif key == "known":
            right = isinstance(value, bool)
        elif key == "chromaticities":
            right = value is None or _are_chromaticities(value)
        else:
            number = isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value < np.inf
            right = number or (value is None and key != "read_noise")
        if not right:
            raise InputError(f"header: camera.{key}", got=repr(value)[:60], where=path)
    if info is None:
        raise InputError("header: camera", got=type(written).__name__, expected="an object", where=path)
    if info.get("chromaticities") is not None:
        info["chromaticities"] = tuple(float(v) for v in info["chromaticities"])
    return CameraInfo(**info)


def _are_chromaticities(written: Any) -> bool:
    """Whether a header's value is eight finite numbers."""
    numbers = isinstance(written, list) and len(written) == 8
    return numbers and all(isinstance(v, int | float) and abs(v) < 1e6 for v in written)


def write_truth(path: Path, truth: Truth) -> None:
    """Write ground truth as OpenEXR, with ``facts`` in the header."""
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
    count, facts = header.get("lights", 0), header.get("facts", {})
    if not isinstance(count, int) or not 0 <= count <= len(channels) or not isinstance(facts, dict):
        raise InputError("header: lights or facts", got=f"{count!r}, {type(facts).__name__}"[:60], where=path)
    per_light = [f"light{i}.{kind}" for kind in ("attached_shadow", "cast_shadow") for i in range(count)]
    _require(channels, per_light, path)
    shape = channels["mask"].shape

    def stack(kind: str) -> np.ndarray:
        images = [channels[f"light{i}.{kind}"] for i in range(count)]
        return np.stack(images, axis=-1) if images else np.zeros((*shape, 0), np.float32)

    mask = channels["mask"] > 0.5
    normals = np.stack([channels[f"normal.{a}"] for a in "XYZ"], axis=-1)
    length = np.linalg.norm(normals[mask], axis=-1)
    length = length[np.isfinite(length)]
    if mask.any() and (length.size == 0 or np.abs(length - 1).max() > 1e-3):
        raise InputError("normals of the object that are not unit vectors", where=path)
    own = {"normal.X", "normal.Y", "normal.Z", "depth.Z", "mask", "lights_seen", *per_light}
    return Truth(
        normals=normals,
        depth=channels["depth.Z"],
        mask=mask,
        attached_shadow=stack("attached_shadow"),
        cast_shadow=stack("cast_shadow"),
        extra={name: image for name, image in channels.items() if name not in own},
        facts=facts,
    )


def lights_seen(truth: Truth) -> np.ndarray:
    """Number of lights that each pixel sees, (H, W); a light that is half hidden counts one half."""
    return np.asarray(np.sum(1.0 - truth.attached_shadow - truth.cast_shadow, axis=-1), dtype=np.float32)


# ---- a run folder, item by item ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class RunItem:
    """One item of a run folder. Its files are read by the methods, at each call, and are not kept in memory."""

    id: str  # "<config>/<transport>"
    folder: Path
    status: str  # "done", "failed" …
    entry: dict[str, Any]  # its entry in the manifest

    def __repr__(self) -> str:
        return f"RunItem({self.id}, {self.status}, in {self.folder})"

    @property
    def transport(self) -> str:
        """The level of transport, one of TRANSPORTS."""
        return self.id.rpartition("/")[2]

    def observation(self) -> Observation:
        """The picture. Raises InputError if it cannot be read, as the other methods do."""
        return read_observation(inside(self.folder, "observation.exr"))

    def truth(self) -> Truth:
        """The ground truth."""
        return read_truth(inside(self.folder, "truth.exr"))

    def layers(self) -> Layers:
        """The picture as a sum of layers."""
        return layers_of(self.folder)

    def config(self) -> RunConfig:
        """The config that the item was rendered with."""
        return read_item_config(self.folder)


def open_run(run: Path | str, *, transport: str | None = None, status: str = "done") -> tuple[RunItem, ...]:
    """The items of a run folder, in the order of their ids; only those with a ``transport`` or ``status``, if given.

    Pictures are read only when the items' methods are called. Raises InputError if there is no run folder, or its
    manifest is damaged.
    """
    run = Path(run)
    items = (RunItem(i["id"], item_folder(run, i["id"]), i["status"], i) for i in read_manifest(run)["items"])
    return tuple(i for i in items if i.status == status and transport in (None, i.transport))


def _require(channels: dict[str, np.ndarray], names: tuple[str, ...] | list[str], path: Path) -> None:
    missing = [name for name in names if name not in channels]
    if missing:
        raise InputError(f"no channel {missing[0]!r}", got=f"channels {', '.join(sorted(channels)[:12])}", where=path)


def _require_version(header: dict[str, Any], path: Path) -> None:
    version = header.get("format_version")
    if version != FORMAT_VERSION:
        raise InputError("format_version", got=version, expected=str(FORMAT_VERSION), where=path)
