"""Another light, surface or camera for a scene that was traced once: colours change, transport does not."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.load import apply_override, read_yaml, validate
from huesphere.configs.schema import RunConfig
from huesphere.render.dataset import Observation
from huesphere.render.layers import Layers, read_layers
from huesphere.render.sensor import camera_info, expose, exposure_gain
from huesphere.render.spectral import Components, component_colours_of, components_by_order
from huesphere.scenes.cameras import sensitivity
from huesphere.scenes.lights import build_lights
from huesphere.scenes.spectra import reflectance

# What may change without tracing again: keys of the config, as prefixes after list indices are dropped.
FREE = (
    "lights.spectrum",
    "lights.intensity",
    "lights.zenith",
    "lights.horizon",
    "lights.ground",
    "lights.sun.spectrum",
)
FREE_TOO = ("lights.sun.intensity", "surface.reflectance", "camera", "name", "recover", "render")
FIXED_CAMERA = ("camera.projection", "camera.resolution", "camera.view_height", "camera.field_of_view", "camera.pixel")


def geometry_of(config: RunConfig) -> str:
    """What of ``config`` is traced, as text: configs of which it is the same differ by relighting alone."""
    data = config.model_dump(mode="json")
    single = config.surface.checker is None and config.room is None and not getattr(config.shape, "background", False)
    kept = {"target_rms", "max_bounces", "samples", "seed"}
    data["render"] = {key: value for key, value in data["render"].items() if key in kept}
    return json.dumps(_without_free(data, (), single), sort_keys=True)


def _without_free(node: Any, place: tuple[str, ...], single: bool) -> Any:
    if isinstance(node, list):
        return [_without_free(value, place, single) for value in node]
    if not isinstance(node, dict):
        return node
    return {
        key: _without_free(value, (*place, key), single)
        for key, value in node.items()
        if not _is_free(".".join((*place, key)), single)
    }


def _is_free(name: str, single: bool) -> bool:
    """Whether a key may change without tracing again; a reflectance only where there is a ``single`` one."""
    if name in ("camera", "render") or name.startswith(("render.", *FIXED_CAMERA)):
        return False
    if name.startswith("surface.reflectance"):
        return single
    return name.startswith(FREE + FREE_TOO)


@dataclass(frozen=True)
class TracedItem:
    """One rendered item, read once, for any number of relightings."""

    layers: Layers
    config: RunConfig
    source: Path
    mask: np.ndarray  # (H, W) bool
    columns: np.ndarray  # (n, L C) float32, the images over the object's pixels


def open_item(folder: Path | str) -> TracedItem:
    """Read the item in ``folder`` (run/<config>/<transport>). Raises InputError if it cannot be relit."""
    folder = Path(folder)
    data, _ = read_yaml(folder / "config.yaml")
    layers = read_layers(folder / "layers.exr")
    if layers.stock:
        raise InputError("relighting needs geometry, and the stock integrator gives colours", where=folder)
    if layers.colours.shape[2] > 1 or any("." in name or name == "highlight" for name in layers.names):
        raise InputError(
            "relighting needs one matte reflectance in the scene", got=", ".join(layers.names), where=folder
        )
    mask = layers.material >= 0
    columns = np.ascontiguousarray(layers.images[:, :, mask].reshape(-1, mask.sum()).T)
    return TracedItem(layers, validate(data, where=folder / "config.yaml"), folder, mask, columns)


def relight(item: TracedItem | Path | str, changes: list[str] | tuple[str, ...] = ()) -> Observation:
    """The picture of a traced scene under other spectra, intensities, reflectance or camera, without tracing.

    ``changes`` are written as for ``--set``: ``lights.0.spectrum=D65``, ``lights.1.intensity=0.2``,
    ``surface.reflectance=0.8``, ``camera.sensitivity=CIE 1931``, ``camera.read_noise=1e-3``. A reflectance above the
    one that was traced leaves out bounces that were negligible then. Raises InputError for changes that move something.
    """
    if not isinstance(item, TracedItem):
        item = open_item(item)
    config = _changed(item, changes)
    lights = build_lights(config.lights)
    surface = reflectance(config.surface.reflectance, where="surface.reflectance")
    order = len(item.layers.names) - 1
    colours = component_colours_of(
        np.stack([light.spectrum for light in lights]),
        Components(item.layers.names, components_by_order(surface, order).basis),
        surface[None],
        sensitivity(config.camera.sensitivity),
    )
    seen = (item.columns @ colours[:, :, 0].reshape(-1, 3).astype(np.float32)).astype(float)
    picture = np.zeros((*item.mask.shape, 3))
    picture[item.mask] = exposure_gain(seen, config.camera) * seen
    return Observation(expose(picture, config.camera), item.mask.copy(), camera_info(config.camera, None))


def _changed(item: TracedItem, changes: list[str] | tuple[str, ...]) -> RunConfig:
    data = item.config.model_dump(mode="json")
    for change in changes:
        place = apply_override(data, change)
        name = ".".join(str(part) for part in place if not isinstance(part, int))
        if not name.startswith(FREE + FREE_TOO) or name.startswith(FIXED_CAMERA):
            raise InputError(f"relight: {name} cannot change without tracing again", got=change, where=item.source)
    return validate(data, where="relight")
