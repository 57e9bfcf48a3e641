"""The files of one item of a run: written as a whole, and checked for whether they are there already.

An item is one config with one transport; its folder is <run>/<config>/<transport>. It is written into a temporary
folder that is renamed at the end, so that a run folder never holds a part of an item.
"""

import contextlib
import errno
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.file_paths import absolute_path, digest_of_file
from huesphere.configs.load import dump_config, read_yaml, validate
from huesphere.configs.own_folder import inside, made_folder, temporary_name
from huesphere.configs.regular_file import check_regular
from huesphere.configs.schema import RunConfig
from huesphere.render.dataset import Observation, linear_light, write_observation, write_truth
from huesphere.render.developing import write_developed, write_raw
from huesphere.render.inputs import digests_of_inputs, file_names, portable_config
from huesphere.render.layers import write_layers
from huesphere.render.manifest import OPTIONAL_FILES, RECORD, describe_files, read_record, write_record
from huesphere.render.picture import Picture
from huesphere.render.sensor import camera_info, clips, exposure_gain, linear_picture, preview, read_out
from huesphere.render.transport import Transport
from huesphere.render.truth import ground_truth, known_lights
from huesphere.scenes.build import Scene
from huesphere.scenes.cameras import chromaticities

MOST_DIFFERENCES = 6
# Errors of the operating system after which no item of the run can be written
NO_ROOM_LEFT = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO)


def item_id(config: RunConfig, transport: str) -> str:
    """The id of an item, which is also its path in the run folder."""
    return f"{config.name}/{transport}"


def of_transport(config: RunConfig, transport: str) -> RunConfig:
    """The config of one item: ``config`` with this transport alone."""
    return config.model_copy(update={"render": config.render.model_copy(update={"transport": (transport,)})})


# ---- writing -------------------------------------------------------------------------------------------------------


def write_item(
    run: Path,
    config: RunConfig,
    scene: Scene,
    traced: Transport,
    picture: Picture,
    transport: str,
    entry: dict[str, Any],
) -> dict[str, Any]:
    """Write the files of an item and its record.

    ``picture`` is what the item shows, ``traced`` the transport that it and its truth are made from, ``transport`` the
    name of its level, such as "direct". ``entry`` has the facts of its making (engine, seconds …), and under
    ``left_out`` the files that are not written; returned is the item's complete entry for the manifest.
    """
    one = of_transport(config, transport)
    left_out = entry.get("left_out", ())
    return write_whole_item(run, one, lambda folder: _write_files(folder, one, scene, traced, picture, left_out), entry)


def write_whole_item(run: Path, one: RunConfig, write: Callable[[Path], None], entry: dict[str, Any]) -> dict[str, Any]:
    """Write an item of one transport: its config, what ``write`` puts into the folder it is given, and its record.

    ``entry``: the facts of its making; returned is the complete entry for the manifest.
    """
    (transport,) = one.render.transport
    with _whole(run / item_id(one, transport)) as folder:
        (folder / "config.yaml").write_text(_config_text(run, one, transport), encoding="utf-8")
        write(folder)
        full = _entry(run, one, "done") | entry | {"files": describe_files(folder, item_id(one, transport))}
        write_record(folder, full)
    return full


def write_failure(run: Path, config: RunConfig, transport: str, error: str, trace: str | None = None) -> dict[str, Any]:
    """Write the folder of an item that could not be made: its config and a record of the error; returns its entry.

    Where even that cannot be written, because a file is in the place of the folder, the entry alone is returned.
    """
    one = of_transport(config, transport)
    entry = _entry(run, one, "failed") | {"error": error, "seconds": 0.0, "files": []}
    try:
        with _whole(run / item_id(config, transport)) as folder:
            (folder / "config.yaml").write_text(_config_text(run, one, transport), encoding="utf-8")
            entry["files"] = describe_files(folder, item_id(config, transport))
            write_record(folder, entry | ({"traceback": trace} if trace else {}))
    except (InputError, OSError) as problem:
        if isinstance(problem, OSError) and problem.errno in NO_ROOM_LEFT:
            raise
        entry["files"] = []
    return entry


def _config_text(run: Path, one: RunConfig, transport: str) -> str:
    """The text of the item's config.yaml."""
    return dump_config(portable_config(one, run, item_id(one, transport)))


def _entry(run: Path, one: RunConfig, status: str) -> dict[str, Any]:
    """The parts of an item's entry that follow from its config."""
    (transport,) = one.render.transport
    entry: dict[str, Any] = {"id": item_id(one, transport), "status": status, "seed": one.render.seed}
    inputs = digests_of_inputs(one, run, entry["id"])
    return entry | ({"inputs": inputs} if inputs else {})


@contextlib.contextmanager
def _whole(folder: Path) -> Iterator[Path]:
    """A new folder to write into, which replaces ``folder`` if no error is raised within the block."""
    made_folder(folder.parent.parent, folder.parent.name)
    partial = temporary_name(folder)
    partial.mkdir()
    try:
        yield partial
        if folder.is_dir() and not folder.is_symlink():
            shutil.rmtree(folder, ignore_errors=True)
        try:
            partial.rename(folder)
        except OSError as error:  # another process made the same item meanwhile: its files are equal
            if error.errno not in (errno.ENOTEMPTY, errno.EEXIST) or not (folder / RECORD).is_file():
                raise
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _write_files(
    folder: Path, one: RunConfig, scene: Scene, traced: Transport, picture: Picture, left_out: Sequence[str]
) -> None:
    (transport,) = one.render.transport
    mask = traced.mask()
    gain = exposure_gain(picture.colour[mask], one.camera)
    samples = read_out(gain * picture.colour, one.camera)
    rgb = linear_picture(samples, one.camera)
    if one.camera.raw:
        write_raw(folder / "raw.dng", samples, one.camera, scene.sensitivity)
    if one.camera.develop:
        seen = linear_light(Observation(rgb, mask, camera_info(one.camera))).rgb
        write_developed(folder, seen, one.camera, scene.sensitivity)
    known = known_lights(scene) if one.recover.lights == "told" else None
    camera = replace(camera_info(one.camera, scene.view), chromaticities=chromaticities(scene.sensitivity))
    write_observation(folder / "observation.exr", Observation(rgb, mask, camera, known))
    truth = ground_truth(scene, traced, gain, cast_shadows=transport != "linear")
    if clips(one.camera):
        truth.extra["saturated"] = np.asarray((rgb >= 1.0).any(axis=-1))
    if picture.highlight is not None:
        truth.extra["highlight_share"] = picture.highlight
        truth.extra["highlight"] = picture.highlight > getattr(one.surface, "highlight_share", 1.0)
    write_truth(folder / "truth.exr", truth)
    if picture.layers is not None and "layers.exr" not in left_out:
        scaled = picture.layers
        write_layers(
            folder / "layers.exr",
            replace(scaled, colours=gain * scaled.colours, standard_error=gain * scaled.standard_error),
        )
    if "preview.png" not in left_out:
        write_png(folder / "preview.png", preview(rgb, mask, scene.sensitivity.sum(axis=0)))


def write_png(path: Path, image: np.ndarray) -> None:
    import imageio.v3 as imageio

    imageio.imwrite(path, image)


# ---- items on disk -------------------------------------------------------------------------------------------------


def entry_there(run: Path, manifest: dict[str, Any], config: RunConfig, transport: str) -> dict[str, Any] | None:
    """The entry of an item that is complete on disk, done or failed, and was made by this config; otherwise None.

    Raises InputError, with the differences, if the item on disk was made by another config or from other files.
    """
    name = item_id(config, transport)
    entry = read_record(run, name) or next((i for i in manifest["items"] if i["id"] == name), None)
    if entry is None or entry["status"] not in ("done", "failed") or not all(_is_whole(run, f) for f in entry["files"]):
        return None
    if not inside(run, name, "config.yaml").is_file():
        return None
    changed = _differences(run / name / "config.yaml", of_transport(config, transport), entry.get("inputs"))
    if changed:
        more = f"; and {len(changed) - MOST_DIFFERENCES} more" if len(changed) > MOST_DIFFERENCES else ""
        raise InputError(
            "made by another config: use another --out, or --overwrite",
            got=f"changed {'; '.join(changed[:MOST_DIFFERENCES])}{more}",
            where=run / name,
        )
    return entry


def require_files(run: Path, entry: dict[str, Any], left_out: Sequence[str]) -> None:
    """Raise InputError if a finished item on disk was made without a file that is wanted now.

    ``left_out``: the files that are not wanted. What an item has beyond them is no fault.
    """
    lacking = [name for name in entry.get("left_out", ()) if name not in left_out]
    if entry["status"] == "done" and lacking:
        raise InputError(
            f"made without {' and '.join(lacking)}: leave them out again "
            f"({' '.join(OPTIONAL_FILES[name] for name in lacking)}), or --overwrite",
            where=run / entry["id"],
        )


def _is_whole(run: Path, file: dict[str, Any]) -> bool:
    """Whether the file of a manifest's entry exists and has its size."""
    path = run / file["path"]
    try:
        size = check_regular(path, follow=False).st_size
    except (OSError, InputError):
        return False
    return bool(size == file.get("bytes", size))


def _differences(path: Path, wanted: RunConfig, inputs: Any) -> list[str]:
    """The keys in which ``wanted`` differs from the config at ``path``, each as a text with the new and old value.

    ``inputs``: sha256 of the files by their names in that config, from the item's entry. Files are compared by their
    contents, wherever they lie; by their paths only where the contents are not known.
    """
    data, _ = read_yaml(path)
    with contextlib.suppress(InputError):  # keys that newer versions added have their defaults
        data = validate(data, where=path).model_dump(mode="json")
    mapping = wanted.model_dump(mode="json")
    old, new = dict(_leaves(data)), dict(_leaves(mapping))
    digests = inputs if isinstance(inputs, dict) else {}
    changed = []
    for key, name in file_names(mapping):
        written = old.get(key)
        if isinstance(written, str):
            was, now = digests.get(written), digest_of_file(name)
            if str(absolute_path(written, path.parent)) == name:
                old[key] = name
                changed += [f"the contents of {name}"] if None not in (was, now) and was != now else []
            elif was is not None and was == now and Path(written).suffix == Path(name).suffix:
                old[key] = name
    nothing = object()
    keys = [key for key in dict.fromkeys([*new, *old]) if old.get(key, nothing) != new.get(key, nothing)]
    return [f"{key}: {new.get(key, 'none')} (was {old.get(key, 'none')})" for key in keys] + changed


def _leaves(node: Any, place: str = "") -> Iterator[tuple[str, Any]]:
    """(dotted key, value) of each value of a config; a list without lists or mappings in it is one value."""
    if isinstance(node, dict):
        for key, value in node.items():
            yield from _leaves(value, f"{place}.{key}" if place else str(key))
    elif isinstance(node, list) and any(isinstance(value, dict | list) for value in node):
        for number, value in enumerate(node):
            yield from _leaves(value, f"{place}.{number}")
    else:
        yield place, node
