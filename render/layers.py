"""A picture taken apart: for each light and each number of bounces, a grey image and the colour that it carries.

With one reflectance, light that was reflected k+1 times has the same colour everywhere: the picture is the sum over
lights and orders of image × colour. Another reflectance, emitter or camera changes the colours, never the images.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from configs.errors import InputError
from render.dataset import FORMAT_VERSION
from render.exr import read_exr, write_exr


@dataclass(frozen=True)
class Layers:
    """Transport images and colours of one item; ``images[i, k]`` is the light that source i gives after k bounces."""

    images: np.ndarray  # (L, K, H, W) float32, unit albedo: 0 direct, 1 one bounce, 2 and more the rest
    colours: np.ndarray  # (L, K, 3) float64, picture units: full scale 1 after exposure
    standard_error: np.ndarray  # (H, W, 3) float32, picture units; 0 where nothing was sampled
    light_names: tuple[str, ...]

    def rgb(self, light: int, part: str) -> np.ndarray:
        """One light's share of the picture, (H, W, 3); ``part`` is "direct", "one_bounce" or "rest"."""
        orders = {"direct": slice(0, 1), "one_bounce": slice(1, 2), "rest": slice(2, None)}[part]
        return np.einsum("khw,kc->hwc", self.images[light, orders], self.colours[light, orders])

    def picture(self) -> np.ndarray:
        """All light together, (H, W, 3), without the camera's noise."""
        return np.einsum("lkhw,lkc->hwc", self.images, self.colours)


def layer_name(light: int, order: int) -> str:
    return f"light{light}." + ("direct", "one_bounce")[order] if order < 2 else f"light{light}.rest{order}"


def write_layers(path: Path, layers: Layers) -> None:
    lights, orders = layers.images.shape[:2]
    channels = {layer_name(i, k): layers.images[i, k] for i in range(lights) for k in range(orders)}
    channels |= {f"standard_error.{c}": layers.standard_error[..., j] for j, c in enumerate("RGB")}
    header = {
        "format_version": FORMAT_VERSION,
        "lights": list(layers.light_names),
        "orders": orders,
        "colours": layers.colours.tolist(),
    }
    write_exr(path, channels, header)


def read_layers(path: Path) -> Layers:
    """Read layers.exr. Raises InputError if it is not one."""
    channels, header = read_exr(path)
    try:
        names, orders = header["lights"], int(header["orders"])
        images = np.stack([[channels[layer_name(i, k)] for k in range(orders)] for i in range(len(names))])
        colours = np.asarray(header["colours"], dtype=float).reshape(len(names), orders, 3)
        error = np.stack([channels[f"standard_error.{c}"] for c in "RGB"], axis=-1)
    except (KeyError, ValueError, TypeError) as problem:
        raise InputError("not a layers file", got=f"{type(problem).__name__}: {problem}", where=path) from None
    return Layers(images, colours, error, tuple(names))
