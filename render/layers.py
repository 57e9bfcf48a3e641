"""A picture as a sum of layers: for each source and component a grey image, and the colour that it is multiplied by.

Light of one source and one component (``render.spectral.Components``) has the same spectrum everywhere, so the picture
is the sum over sources and components of image × colour. Where reflectance varies over the surface, each term is also
multiplied by the weight of that reflectance at the pixel, and the terms are summed over reflectances. Another emitter,
intensity or camera changes the colours and not the images, and so does another reflectance if the scene has only one:
see ``render.relighting``. Layers that only Mitsuba's own integrator can render ("stock") are colours: they have an
image for each of R, G and B, whose colour is the unit vector of that channel.

The layers of a ``render.picture.Picture`` add up to a picture in camera units, before exposure. In layers.exr
``colours`` and ``standard_error`` are multiplied by the exposure, so that the layers add up to picture units, full
scale 1.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.own_folder import inside
from huesphere.render.exr import FORMAT_VERSION, read_exr, write_exr
from huesphere.render.manifest import read_record
from huesphere.render.spectral import Seen, colour_of

PARTS = ("direct", "one_bounce", "rest")  # of the light: after no, one, and more reflections


@dataclass(frozen=True)
class Layers:
    """Transport images and colours of one item: L sources, C components, M materials."""

    # (L, C, H, W) float32: irradiance by geometry alone; of layers whose name ends in .R, .G or .B (rendered by
    # Mitsuba's integrator) that channel of the picture, before exposure
    images: np.ndarray
    names: tuple[str, ...]  # (C) components: "direct", "highlight", "one_bounce…", "rest…"; colours end in ".R" …
    colours: np.ndarray  # (L, C, M, 3) float64: before exposure in a ``Picture``, times the exposure in layers.exr
    material: np.ndarray  # (H, W) int, number of the reflectance that the pixel sees; −1 off the object
    standard_error: np.ndarray  # (H, W, 3) float32, of the sum of all layers; 0 where nothing was sampled
    lights: tuple[str, ...]  # (L) names of the sources
    # (M, H, W) float32 weight of each reflectance where it varies over the surface; None: 1 for ``material``
    weights: np.ndarray | None = None
    nodes: tuple[int, ...] = ()  # of `Components`

    def rgb(self, light: int, part: str) -> np.ndarray:
        """The light of one source in the picture, (H, W, 3); ``part`` is one of PARTS.

        Highlights belong to "direct". Raises ValueError for another part.
        """
        if part not in PARTS:
            raise ValueError(f"part: got {part!r}, expected one of {', '.join(PARTS)}")
        prefixes = (part, "highlight") if part == "direct" else part
        chosen = [c for c, name in enumerate(self.names) if name.startswith(prefixes)]
        return self._colour(slice(light, light + 1), chosen)

    def of_light(self, light: int) -> np.ndarray:
        """All light of one source in the picture, after any number of reflections: (H, W, 3)."""
        return np.asarray(np.sum([self.rgb(light, part) for part in PARTS], axis=0))

    @property
    def stock(self) -> bool:
        """Whether some of the images are colours, rendered by Mitsuba's own integrator."""
        return any(name.endswith((".R", ".G", ".B")) for name in self.names)

    def picture(self) -> np.ndarray:
        """The sum of all layers, (H, W, 3): the picture without the camera's noise."""
        return self._colour(slice(None), list(range(len(self.names))))

    def _colour(self, lights: slice, components: list[int]) -> np.ndarray:
        """The sum of the layers of some lights and components, (H, W, 3)."""
        inside = self.material >= 0
        images, colours = self.images[lights][:, components][:, :, inside], self.colours[lights][:, components]
        weights = None if self.weights is None else self.weights[:, inside].T
        out = np.zeros((*self.material.shape, 3))
        names = [self.names[c] for c in components]
        out[inside] = colour_of(images, colours, Seen(self.material[inside], weights), names)
        return out


def write_layers(path: Path, layers: Layers) -> None:
    """Write layers.exr; ``layers`` have been multiplied by the exposure."""
    channels = {
        f"light{i}.{name}": layers.images[i, c]
        for i in range(len(layers.lights))
        for c, name in enumerate(layers.names)
    }
    channels |= {f"standard_error.{c}": layers.standard_error[..., j] for j, c in enumerate("RGB")}
    channels["material"] = layers.material
    if layers.weights is not None:
        channels |= {f"weight.{m}": image for m, image in enumerate(layers.weights)}
    header = {
        "format_version": FORMAT_VERSION,
        "lights": list(layers.lights),
        "components": list(layers.names),
        "colours": layers.colours.tolist(),
        "nodes": list(layers.nodes),
    }
    write_exr(path, channels, header)


def layers_of(folder: Path) -> Layers:
    """The layers of the item in ``folder`` (run/<config>/<transport>). Raises InputError if it has none."""
    path = inside(folder, "layers.exr")
    if not path.exists():
        absolute = folder.absolute()
        record = read_record(absolute.parent.parent, f"{absolute.parent.name}/{absolute.name}")
        if record is not None and path.name in record.get("left_out", ()):
            raise InputError(
                "no layers.exr: the item was rendered with --no-layers",
                expected="an item rendered without that option (render --overwrite)",
                where=folder,
            )
        raise InputError("no layers.exr", where=folder)
    return read_layers(path)


def read_layers(path: Path) -> Layers:
    """Read layers.exr, which adds up to picture units. Raises InputError if it is not such a file."""
    channels, header = read_exr(path)
    try:
        lights, names = tuple(header["lights"]), tuple(header["components"])
        images = np.stack([[channels[f"light{i}.{name}"] for name in names] for i in range(len(lights))])
        colours = np.asarray(header["colours"], dtype=float)
        if colours.shape[:2] != (len(lights), len(names)) or colours.shape[3:] != (3,):
            raise ValueError(f"colours of shape {colours.shape}")
        error = np.stack([channels[f"standard_error.{c}"] for c in "RGB"], axis=-1)
        material = np.round(channels["material"]).astype(int)
        weights = None
        if "weight.0" in channels:
            weights = np.stack([channels[f"weight.{m}"] for m in range(colours.shape[2])])
        nodes = tuple(int(node) for node in header.get("nodes", ()))
    except (KeyError, ValueError, TypeError) as problem:
        raise InputError("not a layers file", got=f"{type(problem).__name__}: {problem}", where=path) from None
    return Layers(images, names, colours, material, error, lights, weights, nodes)
