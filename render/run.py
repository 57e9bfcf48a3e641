"""From configs to items on disk: geometry traced once for all that share it, then one folder for each transport."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from configs.errors import InputError
from configs.schema import RunConfig
from render.backend import Backend, choose_backend, load_mitsuba
from render.dataset import TRANSPORTS
from render.item import is_done, write_item
from render.manifest import describe_files, empty_manifest, put_item, read_manifest
from render.picture import assemble, stock_picture
from render.relighting import geometry_of
from render.transport import Progress, trace_alike
from scenes.build import build_scene, recoloured

MOST_LINES = 8  # items that are named one by one


@dataclass(frozen=True)
class _Work:
    """One config with what is not yet there of it."""

    config: RunConfig
    todo: tuple[str, ...]


def render_configs(
    configs: Sequence[RunConfig], run: Path, *, engine: str, overwrite: bool, progress: Progress, log
) -> list[str]:
    """Render the items of ``configs`` into ``run``; returns their ids. Items that are there already are kept.

    Configs that differ only in what relighting may change share one trace, whose error is that of the worst of them.
    ``log`` is called with lines for the user. Raises InputError for bad input and for items made by another config.
    """
    manifest = read_manifest(run) if (run / "manifest.json").is_file() else empty_manifest()
    ids: list[str] = []
    groups: dict[str, list[_Work]] = {}
    there = []
    for config in configs:
        wanted = [t for t in TRANSPORTS if t in config.render.transport]
        ids += [_id(config, t) for t in wanted]
        todo = tuple(t for t in wanted if overwrite or not is_done(run, manifest, _id(config, t), config))
        there += [_id(config, t) for t in wanted if t not in todo]
        if todo:
            groups.setdefault(geometry_of(config), []).append(_Work(config, todo))
    for item in there if len(there) <= MOST_LINES else [f"{len(there)} items"]:
        log(f"{item}: already there")
    for number, group in enumerate(groups.values()):

        def part(share: float, what: str, number: int = number) -> None:
            progress((number + share) / len(groups), what)

        _render_alike(group, run, manifest, engine, part, log, numbered=len(configs) > 1)
    return ids


def render_config(config: RunConfig, run: Path, *, engine: str, overwrite: bool, progress: Progress, log) -> list[str]:
    """`render_configs` of one."""
    return render_configs([config], run, engine=engine, overwrite=overwrite, progress=progress, log=log)


def _id(config: RunConfig, transport: str) -> str:
    return f"{config.name}/{transport}"


def _render_alike(
    group: list[_Work], run: Path, manifest: dict, engine: str, progress: Progress, log, *, numbered: bool
) -> None:
    """Trace what ``group`` has in common, then write the items of each."""
    started = time.monotonic()
    first = build_scene(group[0].config)
    scenes = [first, *(recoloured(first, work.config) for work in group[1:])]
    backend = choose_backend()
    mi = load_mitsuba(backend)
    chosen = _choose_engine(engine, backend)
    log(f"shape: {first.shape_label} ({len(first.mesh.faces):,} faces)" + (f", {len(group)} items" * numbered))
    log(f"engine: {chosen}, {backend.reason}" + _why(engine, chosen))
    todo = {transport for work in group for transport in work.todo}
    stock = chosen == "reference"
    if first.coat is not None and not stock and {"one-bounce", "full"} & todo:
        log("coated surface: light between surfaces is rendered by the stock integrator, light by light, with noise")
    settings = group[0].config.render
    traces = trace_alike(
        scenes,
        mi,
        reach="direct" if stock or first.coat is not None else next(t for t in reversed(TRANSPORTS) if t in todo),
        target_rms=settings.target_rms,
        max_bounces=settings.max_bounces,
        seed=settings.seed,
        progress=progress,
    )
    traced = traces[0]
    if len(traced.pixels.row) == 0:
        raise InputError(
            "the camera sees nothing of the object", expected="a shape inside the view", where=group[0].config.name
        )
    if traced.error > settings.target_rms:
        log(f"accuracy: {traced.error:.2e} reached of {settings.target_rms:.2e} asked for")
    elif traced.rays:
        log(f"accuracy: {traced.error:.2e} relative standard error, {traced.rays} {traced.unit} a point")
    run.mkdir(parents=True, exist_ok=True)
    shared = (time.monotonic() - started) / sum(len(work.todo) for work in group)
    for work, scene, own in zip(group, scenes, traces, strict=True):
        for transport in work.todo:
            began = time.monotonic()
            by_stock = stock and transport != "linear"
            if by_stock or (scene.coat is not None and transport in ("one-bounce", "full")):
                picture = stock_picture(mi, scene, work.config, transport, own, exact=not stock)
            else:
                picture = assemble(scene, own, transport, mi)
            folder = run / _id(work.config, transport)
            write_item(folder, work.config, scene, own, picture, transport)
            item = {
                "id": _id(work.config, transport),
                "status": "done",
                "seed": work.config.render.seed,
                "engine": chosen,
                "seconds": round(shared + time.monotonic() - began, 3),
                "relative_rms": picture.error,
                "files": describe_files(run, folder),
            }
            put_item(run, manifest, item)


def _choose_engine(engine: str, backend: Backend) -> str:
    if engine == "transport" and not backend.vectorised:
        raise InputError(f"--engine transport needs LLVM or CUDA; {backend.reason}")
    if engine == "auto":
        return "transport" if backend.vectorised else "reference"
    return engine


def _why(engine: str, chosen: str) -> str:
    return "; the stock integrator renders instead, with noise" if engine == "auto" and chosen == "reference" else ""
