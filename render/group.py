"""Renders a group of items that share one geometry: the geometry is traced once for all of them.

A group is the task that ``render.jobs`` gives to a process.
"""

import time
import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from huesphere.configs.commandline import is_interrupt
from huesphere.configs.errors import InputError
from huesphere.configs.photographed import Photographs
from huesphere.configs.schema import MeshFile, RunConfig
from huesphere.configs.visible import visible
from huesphere.render.backend import Backend, choose_backend, load_mitsuba
from huesphere.render.both_sides import with_both_sides
from huesphere.render.item import NO_ROOM_LEFT, of_transport, write_failure, write_item
from huesphere.render.jobs import Log, Progress
from huesphere.render.lit import faint_lights, require_light
from huesphere.render.photographs.item import render_photographs
from huesphere.render.picture import Picture, assemble, mitsuba_picture
from huesphere.render.plan import Group
from huesphere.render.transport import Transport, trace_alike
from huesphere.scenes.build import Scene, build_scene, recoloured
from huesphere.scenes.extent import why_nothing_is_seen

MOST_NAMED = 12  # photographs that a line for the user names


@dataclass(frozen=True)
class _Built:
    """A config of a group with its scene, and the transports of it that are to be made."""

    config: RunConfig
    scene: Scene
    transports: tuple[str, ...]


def render_group(
    group: Group, progress: Progress, log: Log, *, run: Path, engine: str, left_out: tuple[str, ...] = (), lone: bool
) -> list[dict[str, Any]]:
    """Trace the geometry of ``group`` and write its items into ``run``; returns their entries for the manifest.

    An item that cannot be made, wherever that shows, is recorded as failed and does not stop the others; with
    ``lone``, where the command has one config only, bad input raises InputError instead. A disk that is full raises
    OSError, and an output that was closed BrokenPipeError: these are no failures of an item. ``log`` is called with
    lines for the user, which include the number of items unless ``lone``. ``left_out``: files that are not written.
    """
    if isinstance(group.configs[0].shape, Photographs):
        return _mix(group, _Failures(run, lone, log), run, engine, left_out, log)
    started = time.monotonic()
    backend = choose_backend()
    chosen = _choose_engine(engine, backend)
    mi = load_mitsuba(backend)
    failures = _Failures(run, lone, log)
    remarks: list[str] = []
    built = _build(group, failures, mi, remarks.append)
    if not built:
        return failures.entries
    scene = built[0].scene
    log(f"shape: {scene.shape_label} ({len(scene.mesh.faces):,} faces)" + (f", {len(built)} items" * (not lone)))
    for line in remarks:
        log(line)
    log(f"engine: {chosen}, {backend.reason}" + _why(engine, chosen))
    stock = chosen == "reference"
    if scene.coat is not None and not stock and {"one-bounce", "full"} & {t for _, t in group.items}:
        log("not Lambertian: light between surfaces is rendered by the stock integrator, light by light, with noise")
    try:
        traces = _trace(group, [one.scene for one in built], mi, stock, progress, log)
    except Exception as error:
        for one in built:
            failures.put(one.config, one.transports, error)
        return failures.entries
    entries = []
    shared = (time.monotonic() - started) / max(1, len(group.items))
    for one, traced in zip(built, traces, strict=True):
        for transport in one.transports:
            began = time.monotonic()
            try:
                picture = _picture(mi, one.scene, one.config, transport, traced, stock)
                seconds = round(shared + time.monotonic() - began, 3)
                entry = {"engine": chosen, "seconds": seconds, "relative_rms": picture.error}
                if left_out:
                    entry["left_out"] = list(left_out)
                entries.append(write_item(run, one.config, one.scene, traced, picture, transport, entry))
            except Exception as error:
                failures.put(one.config, (transport,), error)
    return entries + failures.entries


def _mix(
    group: Group, failures: "_Failures", run: Path, engine: str, left_out: tuple[str, ...], log: Log
) -> list[dict[str, Any]]:
    """Make the items of a group of photographs, of which nothing is traced."""
    if engine != "auto":
        raise InputError("--engine is for rendered scenes", got=engine, expected="no such option with photographs")
    entries = []
    for config, transports in zip(group.configs, group.todo, strict=True):
        for transport in transports:
            try:
                entry = render_photographs(of_transport(config, transport), run, left_out)
            except Exception as error:
                failures.put(config, (transport,), error)
                continue
            used = entry["photographs"]
            log(f"{entry['id']}: photographs {', '.join(map(str, used['numbers'][:MOST_NAMED]))}"
                f"{' …' * (len(used['numbers']) > MOST_NAMED)} of {used['count']} ({used['layout']})")  # fmt: skip
            entries.append(entry)
    return entries + failures.entries


class _Failures:
    """Records the items that could not be made, and holds their entries."""

    def __init__(self, run: Path, strict: bool, log: Log) -> None:
        self.run, self.strict, self.log = run, strict, log
        self.entries: list[dict[str, Any]] = []

    def put(self, config: RunConfig, transports: tuple[str, ...], error: Exception) -> None:
        """Record ``error`` for each of ``transports``.

        Raises KeyboardInterrupt if an interrupt caused the error; the error itself if it is no failure of the item,
        but of the disk or of the output, and with ``strict`` if it is an InputError.
        """
        if is_interrupt(error):
            raise KeyboardInterrupt
        bad_input = isinstance(error, InputError)
        if (bad_input and self.strict) or _concerns_all(error):
            raise error
        text = str(error) if bad_input else f"{type(error).__name__}: {error}"
        trace = None if bad_input else "".join(traceback.format_exception(error))
        for transport in transports:
            entry = write_failure(self.run, config, transport, visible(" ".join(text.split())), trace)
            self.log(f"{entry['id']}: failed: {entry['error']}")
            self.entries.append(entry)


def _concerns_all(error: Exception) -> bool:
    """Whether an error keeps every item from being made: a full or read-only disk, an output that was closed."""
    return isinstance(error, BrokenPipeError) or (isinstance(error, OSError) and error.errno in NO_ROOM_LEFT)


def _build(group: Group, failures: _Failures, mi, log: Log) -> list[_Built]:
    """The scenes of the group's configs, as far as they can be built. The geometry is built once for all."""
    built: list[_Built] = []
    for config, transports in zip(group.configs, group.todo, strict=True):
        try:
            if built:
                scene = recoloured(built[0].scene, config)
            else:
                scene = build_scene(config, log)
                if isinstance(config.shape, MeshFile):
                    scene = with_both_sides(scene, mi, log)
        except Exception as error:
            failures.put(config, transports, error)
        else:
            built.append(_Built(config, scene, transports))
    return built


def _trace(group: Group, scenes: list[Scene], mi, stock: bool, progress: Progress, log: Log) -> list[Transport]:
    """The transport of each scene; direct light only if ``stock``, the reference engine, renders the rest.

    Raises InputError if the camera sees nothing of the object.
    """
    settings = group.configs[0].render
    traces = trace_alike(
        scenes,
        mi,
        reach="direct" if stock or scenes[0].coat is not None else group.reach,
        target_rms=settings.target_rms,
        max_bounces=settings.max_bounces,
        seed=settings.seed,
        progress=progress,
    )
    traced = traces[0]
    if len(traced.pixels.row) == 0:
        got = why_nothing_is_seen(scenes[0].mesh, scenes[0].view)
        expected = "a shape that covers the centres of pixels: camera.view_height?"
        raise InputError(
            "the camera sees nothing of the object", got=got, expected=expected, where=group.configs[0].name
        )
    for line in faint_lights(scenes[0], traced):
        log(line)
    if traced.error > settings.target_rms:
        log(f"accuracy: {traced.error:.2e} reached of {settings.target_rms:.2e} asked for")
    elif traced.rays:
        log(f"accuracy: {traced.error:.2e} relative standard error, {traced.rays} {traced.unit} a point")
    return traces


def _picture(mi, scene: Scene, config: RunConfig, transport: str, traced: Transport, stock: bool) -> Picture:
    """The picture of one item, from the transport or by the reference engine.

    Raises ArithmeticError if it has values that are not finite, and InputError if it is black all over.
    """
    if (stock and transport != "linear") or (scene.coat is not None and transport in ("one-bounce", "full")):
        picture = mitsuba_picture(mi, scene, config, transport, traced, direct_by_formula=not stock)
    else:
        picture = assemble(scene, traced, transport, mi)
    if not np.isfinite(picture.colour).all():
        raise ArithmeticError("the picture has values that are not finite")
    require_light(scene, traced, picture.colour)
    return picture


def _choose_engine(engine: str, backend: Backend) -> str:
    """The engine, "transport" or "reference", for the option ``engine``. Raises InputError if it cannot run."""
    if engine == "transport" and not backend.vectorised:
        raise InputError(f"--engine transport needs LLVM or CUDA; {backend.reason}")
    if engine == "auto":
        return "transport" if backend.vectorised else "reference"
    return engine


def _why(engine: str, chosen: str) -> str:
    """A remark for the log if the reference engine was chosen only because the other one cannot run."""
    return "; the stock integrator renders instead, with noise" if engine == "auto" and chosen == "reference" else ""
