"""One geometry, traced once, and the items that it serves: the unit of work, in whatever process it is done."""

import time
import traceback
from pathlib import Path
from typing import Any

import numpy as np

from huesphere.configs.commandline import is_interrupt
from huesphere.configs.errors import InputError
from huesphere.configs.schema import RunConfig
from huesphere.render.backend import Backend, choose_backend, load_mitsuba
from huesphere.render.item import write_failure, write_item
from huesphere.render.jobs import Log, Progress
from huesphere.render.picture import Picture, assemble, stock_picture
from huesphere.render.plan import Group
from huesphere.render.transport import Transport, trace_alike
from huesphere.scenes.build import Scene, build_scene, recoloured


def render_group(
    group: Group, progress: Progress, log: Log, *, run: Path, engine: str, strict: bool, numbered: bool
) -> list[dict[str, Any]]:
    """Trace what ``group`` has in common and write its items into ``run``; returns their entries for the manifest.

    An item that cannot be made is recorded as failed and does not stop the others, unless ``strict``: then bad input
    raises InputError. What the run folder itself refuses, a full disk above all, raises OSError. ``log`` is called with
    lines for the user, which say how many items there are if ``numbered``.
    """
    started = time.monotonic()
    backend = choose_backend()
    chosen = _choose_engine(engine, backend)
    mi = load_mitsuba(backend)
    failures = _Failures(run, strict, log)
    scenes = _build(group, failures)
    built = [config for config, scene in zip(group.configs, scenes, strict=True) if scene is not None]
    if not built:
        return failures.entries
    first = next(scene for scene in scenes if scene is not None)
    log(f"shape: {first.shape_label} ({len(first.mesh.faces):,} faces)" + (f", {len(built)} items" * numbered))
    log(f"engine: {chosen}, {backend.reason}" + _why(engine, chosen))
    stock = chosen == "reference"
    if first.coat is not None and not stock and {"one-bounce", "full"} & {t for _, t in group.items}:
        log("coated surface: light between surfaces is rendered by the stock integrator, light by light, with noise")
    try:
        traces = _trace(group, [scene for scene in scenes if scene is not None], mi, stock, progress, log)
    except Exception as error:
        for config, transport in group.items:
            if config in built:
                failures.put(config, transport, error)
        return failures.entries
    traced = dict(zip((config.name for config in built), traces, strict=True))
    entries = []
    shared = (time.monotonic() - started) / max(1, len(group.items))
    for config, scene, todo in zip(group.configs, scenes, group.todo, strict=True):
        for transport in todo if scene is not None else ():
            began = time.monotonic()
            assert scene is not None
            own = traced[config.name]
            try:
                picture = _picture(mi, scene, config, transport, own, stock)
            except Exception as error:
                failures.put(config, transport, error)
                continue
            seconds = round(shared + time.monotonic() - began, 3)
            entry = {"engine": chosen, "seconds": seconds, "relative_rms": picture.error}
            entries.append(write_item(run, config, scene, own, picture, transport, entry))
    return entries + failures.entries


class _Failures:
    """What could not be made, as it is recorded."""

    def __init__(self, run: Path, strict: bool, log: Log) -> None:
        self.run, self.strict, self.log = run, strict, log
        self.entries: list[dict[str, Any]] = []

    def put(self, config: RunConfig, transport: str, error: Exception) -> None:
        if is_interrupt(error):
            raise KeyboardInterrupt
        bad_input = isinstance(error, InputError)
        if bad_input and self.strict:
            raise error
        text = str(error) if bad_input else f"{type(error).__name__}: {error}"
        trace = None if bad_input else "".join(traceback.format_exception(error))
        entry = write_failure(self.run, config, transport, " ".join(text.split()), trace)
        self.log(f"{entry['id']}: failed: {entry['error']}")
        self.entries.append(entry)


def _build(group: Group, failures: _Failures) -> list[Scene | None]:
    """The scene of each config, None where it cannot be built. Geometry is built once."""
    first: Scene | None = None
    scenes: list[Scene | None] = []
    for config, todo in zip(group.configs, group.todo, strict=True):
        try:
            scene = build_scene(config) if first is None else recoloured(first, config)
        except Exception as error:
            for transport in todo:
                failures.put(config, transport, error)
            scenes.append(None)
        else:
            first = first or scene
            scenes.append(scene)
    return scenes


def _trace(group: Group, scenes: list[Scene], mi, stock: bool, progress: Progress, log: Log) -> list[Transport]:
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
        raise InputError(
            "the camera sees nothing of the object", expected="a shape inside the view", where=group.configs[0].name
        )
    if traced.error > settings.target_rms:
        log(f"accuracy: {traced.error:.2e} reached of {settings.target_rms:.2e} asked for")
    elif traced.rays:
        log(f"accuracy: {traced.error:.2e} relative standard error, {traced.rays} {traced.unit} a point")
    return traces


def _picture(mi, scene: Scene, config: RunConfig, transport: str, traced: Transport, stock: bool) -> Picture:
    if (stock and transport != "linear") or (scene.coat is not None and transport in ("one-bounce", "full")):
        picture = stock_picture(mi, scene, config, transport, traced, exact=not stock)
    else:
        picture = assemble(scene, traced, transport, mi)
    if not np.isfinite(picture.colour).all():
        raise ArithmeticError("the picture has values that are not finite")
    return picture


def _choose_engine(engine: str, backend: Backend) -> str:
    if engine == "transport" and not backend.vectorised:
        raise InputError(f"--engine transport needs LLVM or CUDA; {backend.reason}")
    if engine == "auto":
        return "transport" if backend.vectorised else "reference"
    return engine


def _why(engine: str, chosen: str) -> str:
    return "; the stock integrator renders instead, with noise" if engine == "auto" and chosen == "reference" else ""
