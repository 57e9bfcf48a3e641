"""Colour profiles (ICC.1:2022): how samples of a picture with a profile become linear light.

A profile of curves and a matrix (sRGB, Adobe RGB, Display P3 and nearly all others) gives its curves, one a channel.
Its matrix is left alone, because any three fixed mixtures of light serve recovery alike. A profile of tables, as
printing inks have, is applied as a whole by Little CMS, to linear light of the primaries of sRGB.
"""

import struct
from collections.abc import Callable
from io import BytesIO

import numpy as np

from huesphere.recover.io.stored import Transfer
from huesphere.recover.io.transfer import linear, power, srgb
from huesphere.scenes.encoding import decode_srgb

Curve = Callable[[np.ndarray], np.ndarray]
LARGEST = 64 << 20  # bytes of a profile; those of printers have a few millions


def profile_transfer(profile: bytes, channels: int) -> Transfer | None:
    """The transfer function of samples of ``channels`` (3 or 4) by their ``profile``; None if it cannot be obeyed.

    A profile for another number of channels, or a damaged one, cannot.
    """
    spaces = {b"RGB ": 3, b"CMYK": 4}
    if not 132 <= len(profile) <= LARGEST or profile[36:40] != b"acsp" or spaces.get(profile[16:20]) != channels:
        return None
    source = f"its colour profile {profile_name(profile)!r}"
    try:
        tags = _tags(profile)
        if channels == 3 and all(name in tags for name in (b"rTRC", b"gTRC", b"bTRC")):
            return _of_curves([_curve(tags[name]) for name in (b"rTRC", b"gTRC", b"bTRC")], source)
        if b"A2B0" in tags or b"A2B1" in tags:
            return _of_tables(profile, channels, source)
    except (struct.error, ValueError, IndexError, KeyError):
        return None
    return None


def profile_name(profile: bytes) -> str:
    """What the profile calls itself, at most 60 characters."""
    from PIL import ImageCms

    try:
        name = str(ImageCms.ImageCmsProfile(BytesIO(profile)).profile.profile_description or "")
    except (OSError, ValueError, TypeError, AttributeError, ImageCms.PyCMSError):
        name = ""
    return "".join(c for c in name if c.isprintable()).strip()[:60] or "without a name"


def _tags(profile: bytes) -> dict[bytes, bytes]:
    """The tagged data of a profile by signature. Raises struct.error, ValueError."""
    (count,) = struct.unpack_from(">I", profile, 128)
    if count > 1000:
        raise ValueError(f"{count} tags")
    found = {}
    for k in range(count):
        name, offset, size = struct.unpack_from(">4sII", profile, 132 + 12 * k)
        if offset + size > len(profile):
            raise ValueError("a tag beyond the end")
        found[name] = profile[offset : offset + size]
    return found


def _curve(data: bytes) -> tuple[Curve, float | None]:
    """(a curve, its exponent if it is a power). ICC.1:2022, 10.6 and 10.18. Raises struct.error, ValueError."""
    if data[:4] == b"curv":
        (count,) = struct.unpack_from(">I", data, 8)
        if count == 0:
            return (lambda v: v), 1.0
        if count == 1:
            exponent = struct.unpack_from(">H", data, 12)[0] / 256
            return (lambda v: np.maximum(v, 0.0) ** exponent), exponent
        light = np.frombuffer(data, ">u2", count, 12) / 65535
        if np.any(np.diff(light) < 0) or light[-1] <= light[0]:
            raise ValueError("a curve that falls")
        at = np.linspace(0.0, 1.0, count)
        return (lambda v: np.interp(v, at, light)), None
    if data[:4] == b"para":
        (kind,) = struct.unpack_from(">H", data, 8)
        count = {0: 1, 1: 3, 2: 4, 3: 5, 4: 7}[kind]
        return _parametric(kind, [v / 65536 for v in struct.unpack_from(f">{count}i", data, 12)])
    raise ValueError("a curve of another kind")


def _parametric(kind: int, given: list[float]) -> tuple[Curve, float | None]:
    """A curve (aX + b)^g + e above d, and cX + f below: the five kinds are cases of the last."""
    g, a, b, c, d, e, f = (*given, *[0.0] * (7 - len(given)))
    if kind == 0:
        return (lambda v: np.maximum(v, 0.0) ** g), g
    if kind in (1, 2):  # X ≥ −b/a: (aX + b)^g + c; below: c
        a, b, c, d, e, f = a, b, 0.0, -b / a, c, c
    return (lambda v: np.where(v >= d, np.maximum(a * v + b, 0.0) ** g + e, c * v + f)), None


def _of_curves(curves: list[tuple[Curve, float | None]], source: str) -> Transfer | None:
    """The transfer function of three curves, by its usual name if it has one."""
    exponents = [exponent for _, exponent in curves]
    at = np.linspace(0.0, 1.0, 257)
    light = np.stack([np.asarray(curve(at), float) for curve, _ in curves], axis=-1)
    if not np.isfinite(light).all() or np.any(light[-1] <= 0.1):
        raise ValueError("curves that lead nowhere")
    if None not in exponents and len(set(exponents)) == 1:
        return power(float(exponents[0] or 1.0), source)
    if np.abs(light - at[:, None]).max() < 1e-4:
        return linear(source)
    if np.abs(light - decode_srgb(at)[:, None]).max() < 2e-4:
        return srgb(source)

    def decode(values: np.ndarray) -> np.ndarray:
        return np.stack([curves[c][0](values[..., c]) for c in range(3)], axis=-1)

    return Transfer("curves of its own", source, decode)


def _of_tables(profile: bytes, channels: int, source: str) -> Transfer | None:
    """The transfer function of a profile of tables, applied by Little CMS; None where that is not installed."""
    try:
        import imagecodecs
    except ImportError:
        return None
    if not imagecodecs.CMS.available:
        return None
    primaries = [0.64, 0.33, 1.0, 0.30, 0.60, 1.0, 0.15, 0.06, 1.0]
    target = imagecodecs.cms_profile("rgb", whitepoint=[0.3127, 0.3290, 1.0], primaries=primaries, gamma=1.0)
    space = {3: "rgb", 4: "cmyk"}[channels]

    def decode(values: np.ndarray) -> np.ndarray:
        stored = np.round(65535 * np.clip(values, 0.0, 1.0)).astype(np.uint16)
        light = imagecodecs.cms_transform(
            np.ascontiguousarray(stored), profile, target, colorspace=space, outcolorspace="rgb", outdtype="f4"
        )
        return np.asarray(light, float)

    try:
        decode(np.zeros((1, 1, channels)))
    except Exception:  # Little CMS refuses the profile by errors of its own
        return None
    return Transfer("tables of its own", source, decode)
