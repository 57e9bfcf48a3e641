"""Pictures, normals and depth as images to look at: bytes (H, W, 3), sRGB."""

import io

import numpy as np

from huesphere.recover.reasons import REASONS, Reason
from huesphere.render.dataset import Observation
from huesphere.scenes.encoding import encode_srgb

REASON_COLOURS = {  # Okabe and Ito's palette, which the colour-blind can tell apart, and greys for what has no colour
    Reason.BACKGROUND: ("white", (255, 255, 255)),
    Reason.ALL_LIT: ("blue", (0, 114, 178)),
    Reason.MISSES_LIGHTS: ("sky blue", (86, 180, 233)),
    Reason.IRRADIANCE_MAP: ("green", (0, 158, 115)),
    Reason.KNOWN_LIGHTS: ("blue", (0, 114, 178)),
    Reason.INTERPOLATED: ("yellow", (240, 228, 66)),
    Reason.INTERPOLATED_SATURATED: ("yellow", (240, 228, 66)),
    Reason.INTERPOLATED_DARK: ("yellow", (240, 228, 66)),
    Reason.INTERPOLATED_NOT_FINITE: ("yellow", (240, 228, 66)),
    Reason.OUTLIER: ("orange", (230, 159, 0)),
    Reason.OUTLIER_BRIGHT: ("vermilion", (213, 94, 0)),
    Reason.SATURATED: ("purple", (204, 121, 167)),
    Reason.DARK: ("black", (0, 0, 0)),
    Reason.NOT_FINITE: ("grey", (120, 120, 120)),
    Reason.NO_SOLUTION: ("light grey", (200, 200, 200)),
}
WHITE, DECLINED = 255, (176, 190, 208)  # off the object; where the method gives no normal


def picture_image(observation: Observation) -> np.ndarray:
    """The picture as it is to be looked at, bytes; off the object white."""
    rgb = np.clip(np.nan_to_num(observation.rgb), 0, None)
    if observation.camera.stored_as == "linear":
        top = np.percentile(rgb[observation.mask], 99.5) if observation.mask.any() else 1.0
        rgb = rgb / max(float(top), 1e-12)
    rgb = encode_srgb(np.clip(rgb, 0, 1))
    return on_object(np.round(255 * np.clip(rgb, 0, 1)), observation.mask)


def normal_image(normals: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Normals as colours (n + 1) / 2, bytes."""
    return on_object(_declined(np.round(127.5 * normals + 127.5), normals), mask)


def relit_image(normals: np.ndarray, mask: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """The surface in matte white under one distant light, bytes."""
    light = direction / np.linalg.norm(direction)
    shade = np.maximum(normals.astype(float) @ light, 0)[..., None]
    return on_object(
        _declined(np.repeat(np.round(255 * encode_srgb(np.clip(np.nan_to_num(shade), 0, 1))), 3, axis=-1), normals),
        mask,
    )


def depth_image(depth: np.ndarray) -> np.ndarray:
    """Depth as grey, black at the 0.5th percentile and white at the 99.5th, bytes."""
    low, high = np.nanpercentile(depth, [0.5, 99.5])
    grey = np.clip((depth - low) / max(high - low, 1e-12), 0, 1)[..., None]
    return on_object(np.repeat(np.round(255 * grey), 3, axis=-1), np.isfinite(depth))


def reason_image(reason: np.ndarray) -> np.ndarray:
    """The reason of each pixel's normal (H, W), codes of ``recover.reasons``, as colours; ``legend`` names them."""
    table = np.zeros((256, 3))
    for code, (_, colour) in REASON_COLOURS.items():
        table[code] = colour
    return on_object(table[reason], reason > 0)


def legend(reason: np.ndarray) -> str:
    """The names of the colours of ``reason_image`` that occur in it, with the reason that each stands for."""
    named: dict[str, list[str]] = {}
    for code, (colour, _) in REASON_COLOURS.items():
        if (reason == code).any() and code:
            named.setdefault(colour, []).append(REASONS[code][0])
    return ", ".join(f"{colour} {' or '.join(names)}" for colour, names in named.items())


def normal_png(normals: np.ndarray, mask: np.ndarray) -> bytes:
    """Normals (H, W, 3) of the object ``mask`` (H, W) as colours (n + 1) / 2: a PNG file, which notebooks show."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(normal_image(normals, mask)).save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def _declined(image: np.ndarray, normals: np.ndarray) -> np.ndarray:
    return np.where(np.isfinite(normals).all(axis=-1)[..., None], image, DECLINED)


def on_object(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    return np.where(mask[..., None], np.nan_to_num(image), WHITE).astype(np.uint8)
