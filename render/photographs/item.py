"""One item made of photographs: the mixed picture, its layers, its truth, and where all of it comes from.

The picture is Σ_l w_l ⊙ P_l times the exposure, P_l the photograph under light l alone and w_l its weights for red,
green and blue. All bounces, shadows, highlights and the fall-off of near lights are those of the photographs.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.file_paths import digest_of_file
from huesphere.configs.photographed import PhotographedLights, Photographs
from huesphere.configs.picture_size import MOST_CHANNEL_SAMPLES
from huesphere.configs.schema import RunConfig
from huesphere.render.dataset import CameraInfo, Observation, Truth, write_observation, write_truth
from huesphere.render.item import write_png, write_whole_item
from huesphere.render.layers import Layers, write_layers
from huesphere.render.photographs.mixture import Mixture, mixture
from huesphere.render.photographs.photograph_set import PhotographSet
from huesphere.render.photographs.read import open_photographs
from huesphere.render.sensor import camera_info, clips, expose, exposure_gain, preview
from huesphere.scenes.cameras import sensitivity

SOURCE = "photographs"  # in an item's entry of the manifest, and its engine
COMPONENTS = ("direct.R", "direct.G", "direct.B")  # a photograph does not tell bounces apart
KIND = "photographed"  # of each light, in truth.exr


@dataclass(frozen=True)
class Mixed:
    """The photographs that were added up, and their weights."""

    photographs: PhotographSet
    mixture: Mixture
    images: np.ndarray  # (L, 3, H, W) float32, each light alone, divided by its intensity; 0 off the object
    clipped: np.ndarray  # (H, W) bool, where any of the photographs is at full scale


def render_photographs(config: RunConfig, run: Path, left_out: Sequence[str] = ()) -> dict[str, Any]:
    """Make the item of ``config``, whose shape is photographs, in ``run``; returns its entry for the manifest.

    ``left_out``: the optional files that are not written.

    Raises InputError for files that are missing or cannot be read, and for photographs that are black.
    """
    started = time.monotonic()
    mixed = mix(config)
    entry = {"engine": SOURCE, "source": SOURCE, "relative_rms": 0.0, "photographs": provenance(mixed)}
    entry["seconds"] = round(time.monotonic() - started, 3)
    if left_out:
        entry["left_out"] = list(left_out)
    return write_whole_item(run, config, partial(_write_files, config, mixed, left_out), entry)


def mix(config: RunConfig) -> Mixed:
    """Read the photographs that ``config`` chooses. Raises InputError."""
    spec, lights = of_photographs(config)
    opened = open_photographs(spec)
    chosen = mixture(lights, opened.directions, sensitivity(config.camera.sensitivity))
    samples = (3 * len(chosen.numbers) + 4) * opened.mask.size
    if samples > MOST_CHANNEL_SAMPLES:
        raise InputError(
            "photographs that would not fit in memory", got=f"{samples:,} samples",
            expected=f"at most {MOST_CHANNEL_SAMPLES:,}: fewer lights, or shape.reduce", where=spec.path,
        )  # fmt: skip
    images = np.zeros((len(chosen.numbers), 3, *opened.mask.shape), np.float32)
    clipped = np.zeros(opened.mask.shape, bool)
    for place, number in enumerate(chosen.numbers):
        rgb, full = opened.picture(int(number))
        images[place] = np.where(opened.mask, np.moveaxis(rgb, -1, 0), 0.0)
        clipped |= full & opened.mask
    if not images.any():
        raise InputError("black photographs: no light on the object", where=spec.path)
    return Mixed(opened, chosen, images, clipped)


def of_photographs(config: RunConfig) -> tuple[Photographs, PhotographedLights]:
    """The parts of a config that say which photographs and which lights. Raises InputError for one without them."""
    shape, lights = config.shape, config.lights[0]
    if not isinstance(shape, Photographs) or not isinstance(lights, PhotographedLights):
        raise InputError("not a config of photographs", where=config.name)
    return shape, lights


def provenance(mixed: Mixed) -> dict[str, Any]:
    """What the entry of an item says of its photographs: layout, numbers, weights, and the sha256 of each input file.

    The file of a photograph that was not used is an input too: which are chosen depends on how many there are.
    """
    return {
        "layout": mixed.photographs.layout,
        "count": mixed.photographs.count,
        "numbers": mixed.mixture.numbers.tolist(),
        "weights": mixed.mixture.weights.tolist(),
        "files": {path.name: digest_of_file(path) for path in mixed.photographs.inputs},
    }


def layers_of(mixed: Mixed) -> Layers:
    """The layers of the mixture before exposure: the photograph under each light, times its weights."""
    weights = mixed.mixture.weights
    return Layers(
        images=mixed.images,
        names=COMPONENTS,
        colours=colours_of(weights),
        material=np.where(mixed.photographs.mask, 0, -1),
        standard_error=np.zeros((*mixed.photographs.mask.shape, 3), np.float32),
        lights=tuple(f"photograph {number}" for number in mixed.mixture.numbers),
    )


def colours_of(weights: np.ndarray) -> np.ndarray:
    """`Layers.colours` (L, 3, 1, 3) of the three images of each photograph with ``weights`` (L, 3)."""
    colours = np.zeros((len(weights), 3, 1, 3))
    colours[:, np.arange(3), 0, np.arange(3)] = weights
    return colours


def truth_of(mixed: Mixed, config: RunConfig) -> Truth:
    """The truth of the mixture.

    Depth and cast shadows are not known of photographs, nor F, which their albedo would be needed for: NaN and None.
    Attached shadows follow from normals and directions, NaN where a direction is not known.
    """
    photographs, numbers = mixed.photographs, mixed.mixture.numbers
    directions, mask = photographs.directions[numbers], photographs.mask
    cosine = photographs.normals.astype(np.float64) @ directions.T
    attached = np.where(np.isfinite(cosine), (cosine <= 0).astype(np.float32), np.nan).astype(np.float32)
    unknown = np.full((*mask.shape, len(numbers)), np.nan, np.float32)
    lights = [
        {"name": f"photograph {number}", "kind": KIND, "direction": None if np.isnan(one).any() else one.tolist()}
        for number, one in zip(numbers, directions, strict=True)
    ]
    path = Path(of_photographs(config)[0].path or "")
    return Truth(
        normals=photographs.normals,
        depth=np.full(mask.shape, np.nan, np.float32),
        mask=mask,
        attached_shadow=np.where(mask[..., None], attached, 0.0).astype(np.float32),
        cast_shadow=np.where(mask[..., None], unknown, 0.0).astype(np.float32),
        extra={"clipped": mixed.clipped},
        facts={"F": None, "lights": lights, "pixel_size": 1.0, "shape": f"photographs {path.name}"},
    )


def camera_of(config: RunConfig, focal_px: float | None) -> CameraInfo:
    """What is known of the camera: nothing of its noise; of clipping only what the config adds."""
    return replace(
        camera_info(config.camera),
        known=False,
        projection="orthographic" if focal_px is None else "perspective",
        focal_px=focal_px,
    )


def observed(mixed: Mixed, config: RunConfig) -> tuple[Observation, Layers]:
    """(the picture that the camera of ``config`` takes of the mixture, its layers in the picture's units)."""
    mask, layers = mixed.photographs.mask, layers_of(mixed)
    colour = layers.picture()
    gain = exposure_gain(colour[mask], config.camera)
    observation = Observation(expose(gain * colour, config.camera), mask, camera_of(config, mixed.photographs.focal_px))
    return observation, replace(layers, colours=gain * layers.colours)


def _write_files(config: RunConfig, mixed: Mixed, left_out: Sequence[str], folder: Path) -> None:
    observation, layers = observed(mixed, config)
    write_observation(folder / "observation.exr", observation)
    truth = truth_of(mixed, config)
    if clips(config.camera):
        truth.extra["saturated"] = np.asarray((observation.rgb >= 1.0).any(axis=-1))
    write_truth(folder / "truth.exr", truth)
    if "layers.exr" not in left_out:
        write_layers(folder / "layers.exr", layers)
    if "preview.png" not in left_out:
        write_png(folder / "preview.png", preview(observation.rgb, observation.mask, np.ones(3)))
