"""One item of a run on disk: written whole or not at all, and whether it is there already."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np

from configs.errors import InputError
from configs.load import dump_config
from configs.schema import RunConfig
from render.dataset import Observation, write_observation, write_truth
from render.layers import write_layers
from render.picture import Picture
from render.sensor import camera_info, clips, expose, exposure_gain, preview
from render.transport import Transport
from render.truth import ground_truth
from scenes.build import Scene


def write_item(
    folder: Path, config: RunConfig, scene: Scene, traced: Transport, picture: Picture, transport: str
) -> None:
    """Write an item's files into a folder beside ``folder``, and put it in its place when they are all there."""
    partial = folder.with_name(f".{folder.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    try:
        _write_files(partial, config, scene, traced, picture, transport)
        shutil.rmtree(folder, ignore_errors=True)
        partial.rename(folder)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _write_files(
    folder: Path, config: RunConfig, scene: Scene, traced: Transport, picture: Picture, transport: str
) -> None:
    mask = traced.mask()
    gain = exposure_gain(picture.colour[mask], config.camera)
    rgb = expose(gain * picture.colour, config.camera)
    one = config.model_copy(update={"render": config.render.model_copy(update={"transport": (transport,)})})
    (folder / "config.yaml").write_text(dump_config(one), encoding="utf-8")
    write_observation(folder / "observation.exr", Observation(rgb, mask, camera_info(config.camera, scene.view)))
    truth = ground_truth(scene, traced, gain, cast_shadows=transport != "linear")
    if clips(config.camera):
        truth.extra["saturated"] = np.asarray((rgb >= 1.0).any(axis=-1))
    if picture.highlight is not None:
        truth.extra["highlight_share"] = picture.highlight
        truth.extra["highlight"] = picture.highlight > getattr(config.surface, "highlight_share", 1.0)
    write_truth(folder / "truth.exr", truth)
    if picture.layers is not None:
        scaled = picture.layers
        write_layers(
            folder / "layers.exr",
            replace(scaled, colours=gain * scaled.colours, standard_error=gain * scaled.standard_error),
        )
    _write_png(folder / "preview.png", preview(rgb, mask, scene.sensitivity.sum(axis=0)))


def _write_png(path: Path, image: np.ndarray) -> None:
    import imageio.v3 as imageio

    imageio.imwrite(path, image)


def is_done(run: Path, manifest: dict, item_id: str, config: RunConfig) -> bool:
    """Whether the item is there, finished and made by this very config; refuses one made by another."""
    item = next((i for i in manifest["items"] if i["id"] == item_id), None)
    if item is None or item["status"] != "done" or not all((run / f["path"]).is_file() for f in item["files"]):
        return False
    transport = item_id.rsplit("/", 1)[1]
    render = config.render.model_copy(update={"transport": (transport,)})
    wanted = dump_config(config.model_copy(update={"render": render}))
    made = (run / item_id / "config.yaml").read_text(encoding="utf-8")
    if made != wanted:
        changed = [line.strip() for line in wanted.splitlines() if line not in made.splitlines()]
        raise InputError(
            "made by another config: use another --out, or --overwrite",
            got=f"changed {'; '.join(changed[:4]) or 'keys'}",
            where=run / item_id,
        )
    return True
