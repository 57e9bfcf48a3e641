"""From a config to items on disk: trace once, then one folder for each transport that was asked for."""

import shutil
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import ndimage

from configs.errors import InputError
from configs.load import dump_config
from configs.schema import RunConfig
from render.backend import Backend, choose_backend, load_mitsuba
from render.coat import coated_light
from render.dataset import TRANSPORTS, Observation, write_observation, write_truth
from render.layers import PARTS, Layers, write_layers
from render.manifest import describe_files, empty_manifest, put_item, read_manifest
from render.sensor import camera_info, clips, expose, exposure_gain, preview
from render.spectral import Components, colour_of, component_colours
from render.transport import Progress, Transport, trace
from render.truth import ground_truth
from scenes.build import Scene, build_scene

POOL = 5  # pixels a side over which the standard error is pooled: two replicates say little of one pixel alone


@dataclass(frozen=True)
class Picture:
    """One transport of a scene, before the camera's noise."""

    colour: np.ndarray  # (H, W, 3) camera units before exposure
    layers: Layers | None  # None where the engine cannot take the picture apart
    highlight: np.ndarray | None  # (H, W) share of the colour that a coat's highlight makes; None without a coat
    error: float  # estimated relative standard error, RMS over object pixels; 0 where nothing was sampled


def render_config(config: RunConfig, run: Path, *, engine: str, overwrite: bool, progress: Progress, log) -> list[str]:
    """Render the items of ``config`` into ``run``; returns their ids. Items that are there already are kept.

    ``log`` is called with lines for the user. Raises InputError for bad input and for items made by another config.
    """
    wanted = [t for t in TRANSPORTS if t in config.render.transport]
    ids = {transport: f"{config.name}/{transport}" for transport in wanted}
    manifest = read_manifest(run) if (run / "manifest.json").is_file() else empty_manifest()
    todo = [t for t in wanted if overwrite or not _is_done(run, manifest, ids[t], config)]
    for transport in sorted(set(wanted) - set(todo)):
        log(f"{ids[transport]}: already there")
    if not todo:
        return list(ids.values())

    started = time.monotonic()
    scene = build_scene(config)
    log(f"shape: {scene.shape_label} ({len(scene.mesh.faces):,} faces)")
    backend = choose_backend()
    mi = load_mitsuba(backend)
    chosen = _choose_engine(engine, backend)
    log(f"engine: {chosen}, {backend.reason}" + _why(engine, chosen))
    stock = chosen == "reference"
    if scene.coat is not None and not stock and {"one-bounce", "full"} & set(todo):
        log("coated surface: light between surfaces is rendered by the stock integrator, with noise")
    traced = trace(
        scene,
        mi,
        reach="direct" if stock or scene.coat is not None else next(t for t in reversed(TRANSPORTS) if t in todo),
        target_rms=config.render.target_rms,
        max_bounces=config.render.max_bounces,
        seed=config.render.seed,
        progress=progress,
    )
    if len(traced.pixels.row) == 0:
        raise InputError("the camera sees nothing of the object", expected="a shape inside the view", where=config.name)
    if traced.error > config.render.target_rms:
        log(f"accuracy: {traced.error:.2e} reached of {config.render.target_rms:.2e} asked for")
    elif traced.rays:
        log(f"accuracy: {traced.error:.2e} relative standard error, {traced.rays} {traced.unit} a point")
    run.mkdir(parents=True, exist_ok=True)
    shared = time.monotonic() - started
    for transport in todo:
        began = time.monotonic()
        if (stock and transport != "linear") or (scene.coat is not None and transport in ("one-bounce", "full")):
            picture = _stock_picture(mi, scene, config, transport, traced, exact=not stock)
        else:
            picture = assemble(scene, traced, transport, mi)
        folder = run / ids[transport]
        _write_item(folder, config, scene, traced, picture, transport)
        item = {
            "id": ids[transport],
            "status": "done",
            "seed": config.render.seed,
            "engine": chosen,
            "seconds": round(shared / len(todo) + time.monotonic() - began, 3),
            "relative_rms": picture.error,
            "files": describe_files(run, folder),
        }
        put_item(run, manifest, item)
    return list(ids.values())


def assemble(scene: Scene, traced: Transport, transport: str, mi=None) -> Picture:
    """The picture that ``transport`` gives, and its layers, from one trace; ``mi`` only for coats."""
    if scene.coat is not None:
        replicas = coated_light(mi, scene, traced, cast_shadows=transport != "linear")[None]
        components = Components(("direct", "highlight"), np.ones((2, scene.reflectances.shape[1])), ("highlight",))
    else:
        components, replicas = _chosen(traced, transport)
    colours = component_colours(scene, components)
    images = replicas.mean(axis=0)
    material = traced.pixels.material
    error = np.zeros((3, *traced.shape), np.float32)
    relative = 0.0
    if len(replicas) > 1:
        colour_replicas = np.stack([colour_of(one, colours, material).T for one in replicas])
        variance = colour_replicas.var(axis=0, ddof=1) / len(replicas)
        error = _pooled(traced, variance)
        scale = colour_replicas.mean(axis=(0, 2))
        relative = float(np.sqrt(np.mean(variance / np.where(scale > 0, scale, 1.0)[:, None] ** 2)))
    layers = Layers(
        images=traced.image(images),
        names=components.names,
        colours=colours,
        material=traced.image(material.astype(np.float32), fill=-1).astype(int),
        standard_error=np.moveaxis(error, 0, -1),
        lights=tuple(light.name for light in scene.lights),
    )
    colour = colour_of(images, colours, material)
    highlight = None
    if scene.coat is not None:
        shine = colour_of(images[:, 1:], colours[:, 1:], material).sum(axis=1)
        highlight = traced.image(shine / np.maximum(colour.sum(axis=1), 1e-30))
    return Picture(np.moveaxis(traced.image(colour.T), 0, -1), layers, highlight, relative)


def _chosen(traced: Transport, transport: str) -> tuple[Components, np.ndarray]:
    """Components that ``transport`` is made of, and their images (R, L, C, n)."""
    parts = {"linear": ("direct",), "direct": ("direct",), "one-bounce": ("direct", "one_bounce")}.get(transport, PARTS)
    chosen = [c for c, name in enumerate(traced.components.names) if name.startswith(parts)]
    components = Components(tuple(traced.components.names[c] for c in chosen), traced.components.basis[chosen])
    return components, traced.facing[None, :, None] if transport == "linear" else traced.images[:, :, chosen]


def _pooled(traced: Transport, variance: np.ndarray) -> np.ndarray:
    """Standard error (3, H, W) from the variance (3, n) of the mean, pooled over POOL × POOL pixels of the object."""
    inside = ndimage.uniform_filter(traced.mask().astype(np.float32), POOL)
    pooled = [ndimage.uniform_filter(image, POOL) for image in traced.image(variance)]
    return np.where(traced.mask(), np.sqrt(np.maximum(pooled, 0) / np.maximum(inside, 1e-6)), 0.0).astype(np.float32)


def _stock_picture(mi, scene: Scene, config: RunConfig, transport: str, traced: Transport, *, exact: bool) -> Picture:
    """The stock integrator's picture, light by light, in two halves whose difference is its error.

    Its layers are colours: an image for each of R, G, B, where others have one of geometry. With ``exact``, direct
    light is our own and the stock integrator gives only what comes after.
    """
    from render.reference import render_lights

    settings, first, seen = config.render, int(exact), traced.mask()
    halves = []
    for half in (0, 1):
        seed, samples = 2 * settings.seed + half, max(1, settings.samples // 2)
        parts = render_lights(mi, scene, transport, samples=samples, seed=seed, max_bounces=settings.max_bounces)
        columns = parts[:, first:, seen].transpose(0, 1, 3, 2)  # (L, parts, 3, n)
        halves.append(columns.reshape(len(parts), -1, columns.shape[-1]))
    images = np.mean(halves, axis=0)  # (L, 3 parts, n)
    variance = ((halves[0] - halves[1]) / 2).reshape(-1, columns.shape[1], 3, images.shape[-1]).sum(axis=(0, 1)) ** 2
    names = tuple(f"{part}.{c}" for part in PARTS[first : first + columns.shape[1]] for c in "RGB")
    unit = np.tile(np.eye(3), (columns.shape[1], 1))[None, :, None]
    colours = np.broadcast_to(unit, (*images.shape[:2], len(scene.reflectances), 3))
    layers = Layers(
        images=traced.image(images),
        names=names,
        colours=colours,
        material=traced.image(traced.pixels.material.astype(np.float32), fill=-1).astype(int),
        standard_error=np.moveaxis(_pooled(traced, variance), 0, -1),
        lights=tuple(light.name for light in scene.lights),
    )
    highlight = None
    if exact:
        ours = assemble(scene, traced, "direct", mi)
        assert ours.layers is not None
        layers = replace(
            layers,
            images=np.concatenate([ours.layers.images, layers.images], axis=1),
            names=ours.layers.names + names,
            colours=np.concatenate([ours.layers.colours, colours], axis=1),
        )
    colour = layers.picture()
    if exact and ours.highlight is not None:
        highlight = ours.highlight * ours.colour.sum(axis=-1) / np.maximum(colour.sum(axis=-1), 1e-30)
    scale = np.maximum(colour[seen].mean(axis=0), 1e-30)[:, None]
    return Picture(colour, layers, highlight, float(np.sqrt(np.mean(variance / scale**2))))


def _write_item(
    folder: Path, config: RunConfig, scene: Scene, traced: Transport, picture: Picture, transport: str
) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
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


def _is_done(run: Path, manifest: dict, item_id: str, config: RunConfig) -> bool:
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


def _choose_engine(engine: str, backend: Backend) -> str:
    if engine == "transport" and not backend.vectorised:
        raise InputError(f"--engine transport needs LLVM or CUDA; {backend.reason}")
    if engine == "auto":
        return "transport" if backend.vectorised else "reference"
    return engine


def _why(engine: str, chosen: str) -> str:
    return "; the stock integrator renders instead, with noise" if engine == "auto" and chosen == "reference" else ""
