"""Relighting: pictures of a traced scene with other spectra, intensities, reflectance or camera, without tracing."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.load import anchor_paths, apply_override, validate
from huesphere.configs.own_folder import inside
from huesphere.configs.photographed import Photographs
from huesphere.configs.schema import RunConfig
from huesphere.render.dataset import CameraInfo, Observation, RunItem, linear_light, read_observation
from huesphere.render.inputs import content_of, read_item_config
from huesphere.render.layers import Layers, layers_of
from huesphere.render.photographs.item import camera_of, colours_of, of_photographs
from huesphere.render.photographs.mixture import weights_of
from huesphere.render.sensor import camera_info, expose, exposure_gain
from huesphere.render.spectral import (
    Components,
    component_colours_of,
    components_by_material,
    components_by_order,
)
from huesphere.scenes.build import scene_reflectances
from huesphere.scenes.cameras import sensitivity
from huesphere.scenes.lights.table import build_lights

# Keys of the config that may change without tracing again, each with all below it; those of lights are `spectral`.
FREE = ("surface.reflectance", "camera", "name", "recover", "render")
FIXED_CAMERA = ("camera.projection", "camera.resolution", "camera.view_height", "camera.field_of_view", "camera.pixel")
TRACE_SETTINGS = ("target_rms", "max_bounces", "samples", "seed")  # keys of `render` on which a trace depends


def geometry_of(config: RunConfig) -> str:
    """The parts of ``config`` that the trace depends on, as a text; configs with equal texts can share a trace.

    The text has the contents of files, not where they lie, so that a run is divided in the same way everywhere.
    """
    data = content_of(config)
    free = [key for key in _free_keys(config) if key not in ("camera", "render")]
    free += [f"camera.{key}" for key in data["camera"] if f"camera.{key}" not in FIXED_CAMERA]
    if not _is_single(config):
        free.remove("surface.reflectance")  # with several reflectances the images of bounces depend on them
    data["render"] = {key: data["render"][key] for key in TRACE_SETTINGS}
    return json.dumps(_without(data, (), tuple(free)), sort_keys=True)


def _is_single(config: RunConfig) -> bool:
    """Whether the scene has one reflectance alone, so that all its light depends on its powers."""
    surface = config.surface
    several = surface.checker is not None or surface.mixture is not None or surface.srgb is not None
    several = several or getattr(config.shape, "markers", None) is not None
    return not several and config.room is None and not getattr(config.shape, "background", False)


def _reflectance_keys(config: RunConfig) -> list[str]:
    """Keys of the object's reflectances, in a scene of several."""
    if config.surface.mixture is not None:
        return [f"surface.mixture.{number}.reflectance" for number in range(len(config.surface.mixture))]
    checker = ["surface.checker.reflectance"] if config.surface.checker is not None else []
    return [] if config.surface.srgb is not None else ["surface.reflectance", *checker]


def _free_keys(config: RunConfig) -> list[str]:
    """Dotted keys of the config, with list items by number, that may change without tracing again."""
    return [*FREE, *(f"lights.{i}.{key}" for i, light in enumerate(config.lights) for key in light.spectral)]


def _without(node: Any, place: tuple[str, ...], free: tuple[str, ...]) -> Any:
    """``node``, a part of a config as written (mapping, list or value), without the keys ``free``.

    ``place``: the keys that lead to ``node`` from the top, numbers in lists as text; ``free``: dotted keys from the
    top. A free key of a light that is null is kept: null says that this part of the source does not exist (such as the
    ``ground`` of a sky), and whether it exists changes what is traced.
    """
    if isinstance(node, list):
        return [_without(value, (*place, str(number)), free) for number, value in enumerate(node)]
    if not isinstance(node, dict):
        return node
    return {
        key: _without(value, (*place, key), free)
        for key, value in node.items()
        if ".".join((*place, key)) not in free or (value is None and place[:1] == ("lights",))
    }


@dataclass(frozen=True)
class TracedItem:
    """A rendered item, read into memory for any number of relightings."""

    layers: Layers
    config: RunConfig
    source: Path
    mask: np.ndarray  # (H, W) bool
    columns: np.ndarray  # (n, L C) float32, the images over the object's pixels


def open_item(folder: Path | str) -> TracedItem:
    """Read the item in ``folder`` (run/<config>/<transport>). Raises InputError if it cannot be relit."""
    folder = Path(folder)
    config = read_item_config(folder)
    layers = layers_of(folder)
    if layers.stock and not isinstance(config.shape, Photographs):
        raise InputError(
            "relighting needs layers of geometry, and Mitsuba's own integrator gives colours", where=folder
        )
    if any(name.startswith("highlight") for name in layers.names):
        raise InputError("relighting needs matte surfaces", got=", ".join(layers.names), where=folder)
    mask = layers.material >= 0
    columns = np.ascontiguousarray(layers.images[:, :, mask].reshape(-1, mask.sum()).T)
    return TracedItem(layers, config, folder, mask, columns)


def relight(item: TracedItem | RunItem | Path | str, changes: list[str] | tuple[str, ...] = ()) -> Observation:
    """The picture (H, W, 3), linear, of a traced scene under other spectra, intensities, reflectances or camera.

    ``changes`` are written as for ``--set``: ``lights.0.spectrum=D65``, ``lights.1.intensity=0.2``,
    ``surface.reflectance=0.8``, ``camera.sensitivity=CIE 1931``, ``camera.read_noise=1e-3``. With a larger reflectance
    than the traced one, bounces are missing that were negligible with that one. In a scene of several reflectances
    these may change only if the item has no light that was reflected more than twice, on which the picture depends
    linearly: ``surface.mixture.0.reflectance=0.8`` of an item ``direct`` or ``one-bounce``. Raises InputError for
    changes of the geometry and of maps.
    """
    if not isinstance(item, TracedItem):
        item = open_item(item.folder if isinstance(item, RunItem) else item)
    config = _changed(item, changes)
    colours = _photographed(item, config) if isinstance(config.shape, Photographs) else _of_spectra(item, config)
    seen = np.zeros((len(item.columns), 3))
    material, weights = item.layers.material[item.mask], item.layers.weights
    for number in range(colours.shape[2]):
        of_this = material == number if weights is None else weights[number, item.mask] > 0
        if of_this.any():
            columns = item.columns if of_this.all() else item.columns[of_this]
            part = (columns @ colours[:, :, number].reshape(-1, 3).astype(np.float32)).astype(float)
            seen[of_this] += part if weights is None else weights[number, item.mask][of_this, None] * part
    picture = np.zeros((*item.mask.shape, 3))
    picture[item.mask] = exposure_gain(seen, config.camera) * seen
    exposed = Observation(expose(picture, config.camera), item.mask.copy(), _camera(item, config))
    return linear_light(exposed)


def _camera(item: TracedItem, config: RunConfig) -> CameraInfo:
    """What is known of the camera of the relit picture."""
    if not isinstance(config.shape, Photographs):
        return camera_info(config.camera, None)
    return camera_of(config, read_observation(inside(item.source, "observation.exr")).camera.focal_px)


def _photographed(item: TracedItem, config: RunConfig) -> np.ndarray:
    """Colours (L, 3, 1, 3) of the photographs of ``item`` with the weights of ``config``."""
    _, lights = of_photographs(config)
    weights = weights_of(lights, len(item.layers.lights), sensitivity(config.camera.sensitivity))
    return colours_of(weights)


def _of_spectra(item: TracedItem, config: RunConfig) -> np.ndarray:
    """Colours (L, C, M, 3) of the traced images of ``item`` for M reflectances, with the spectra of ``config``."""
    emitters = np.stack([light.spectrum for light in build_lights(config.lights)])
    reflectances = scene_reflectances(config)[0]
    components = _components(item, reflectances)
    return component_colours_of(emitters, components, reflectances, sensitivity(config.camera.sensitivity))


def _components(item: TracedItem, reflectances: np.ndarray) -> Components:
    """The components of the item's layers with these ``reflectances`` (M, W). Raises InputError if they differ."""
    names = item.layers.names
    reflecting = [int(name.partition(".")[2]) for name in names if name.startswith("one_bounce.")]
    if not reflecting:  # direct light alone, or one reflectance that reflects light
        return Components(names, components_by_order(reflectances[0], len(names) - 1).basis)
    components = components_by_material(reflectances, reflecting, rest=any(name.startswith("rest.") for name in names))
    more = set(np.flatnonzero(reflectances.max(axis=1) > 0)) - set(reflecting)
    if components.names != names or components.nodes != item.layers.nodes or more:
        what = "relight: the layers do not hold the light of these reflectances"
        raise InputError(what, expected="a new trace", where=item.source)
    return components


def _changed(item: TracedItem, changes: list[str] | tuple[str, ...]) -> RunConfig:
    data = item.config.model_dump(mode="json")
    free = _free_keys(item.config)
    if not _is_single(item.config):
        free.remove("surface.reflectance")
        if not any(name.startswith("rest") for name in item.layers.names):
            free += _reflectance_keys(item.config)
    for change in changes:
        name = ".".join(str(part) for part in apply_override(data, change))
        if not _is_below(name, tuple(free)) or _is_below(name, FIXED_CAMERA):
            raise _needs_tracing(item, change)
    config = validate(anchor_paths(data, Path()), where="relight")
    traced = len(item.layers.lights)
    if isinstance(config.shape, Photographs):
        sources = of_photographs(config)[1].number_of_colours or traced
    else:
        sources = len(build_lights(config.lights))
    if sources != traced:
        raise _needs_tracing(item, ", ".join(changes))
    return config


def _is_below(name: str, keys: tuple[str, ...]) -> bool:
    """Whether ``name`` is one of the dotted ``keys`` or a key below one of them."""
    return any(f"{name}.".startswith(f"{key}.") for key in keys)


def _needs_tracing(item: TracedItem, change: str) -> InputError:
    name = change.partition("=")[0].strip()
    return InputError(f"relight: {name} cannot change without tracing again", got=change, where=item.source)
