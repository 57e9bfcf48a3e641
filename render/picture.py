"""Makes a picture, its layers and its standard error, from light transport or by Mitsuba's own integrator.

R independent estimates of the images give the standard error.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from huesphere.configs.schema import RunConfig
from huesphere.render.coat import coated_light
from huesphere.render.layers import PARTS, Layers
from huesphere.render.spectral import Components, Seen, colour_of, component_colours
from huesphere.render.transport import Transport
from huesphere.scenes.build import Coat, Scene

POOL = 5  # side in pixels of the squares over which variances are averaged; few estimates do not give that of one pixel


@dataclass(frozen=True)
class Picture:
    """One transport of a scene, before the camera's noise."""

    colour: np.ndarray  # (H, W, 3) camera units before exposure
    layers: Layers | None  # before exposure; None if the engine gives no layers
    highlight: np.ndarray | None  # (H, W) share of the coat's highlight in the colour; None without a coat
    error: float  # estimated relative standard error, RMS over object pixels; 0 where nothing was sampled


def assemble(scene: Scene, traced: Transport, transport: str, mi=None) -> Picture:
    """The picture of ``scene`` at the level ``transport``, from what was traced; ``mi`` is needed for coats only."""
    if scene.coat is not None:
        replicas = coated_light(mi, scene, traced, cast_shadows=transport != "linear")
        components = _coated(scene)
    else:
        components, replicas = _chosen(traced, transport)
    return _picture(scene, traced, replicas, components.names, component_colours(scene, components), components.nodes)


def _picture(
    scene: Scene,
    traced: Transport,
    replicas: np.ndarray,
    names: tuple[str, ...],
    colours: np.ndarray,
    nodes: tuple[int, ...] = (),
) -> Picture:
    """The picture whose layers are the mean of R independent estimates ``replicas`` (R, L, C, n).

    ``names`` (C), ``colours`` (L, C, M, 3) and ``nodes`` are those of the layers.
    """
    images = replicas.mean(axis=0)
    seen = Seen(traced.pixels.material, traced.pixels.weights)
    error = np.zeros((3, *traced.shape), np.float32)
    relative = 0.0
    if len(replicas) > 1:
        colour_replicas = np.stack([colour_of(one, colours, seen, names).T for one in replicas])
        variance = colour_replicas.var(axis=0, ddof=1) / len(replicas)
        error = _pooled(traced, variance)
        scale = colour_replicas.mean(axis=(0, 2))
        relative = float(np.sqrt(np.mean(variance / np.where(scale > 0, scale, 1.0)[:, None] ** 2)))
    layers = Layers(
        images=traced.image(images),
        names=names,
        colours=colours,
        material=traced.image(seen.material.astype(np.float32), fill=-1).astype(int),
        nodes=nodes,
        weights=None if seen.weights is None else traced.image(seen.weights.T),
        standard_error=np.moveaxis(error, 0, -1),
        lights=tuple(light.name for light in scene.lights),
    )
    colour = colour_of(images, colours, seen, names)
    highlight = None
    if "highlight" in names:
        at = [names.index("highlight")]
        shine = colour_of(images[:, at], colours[:, at], seen, ("highlight",)).sum(axis=1)
        highlight = traced.image(shine / np.maximum(colour.sum(axis=1), 1e-30))
    return Picture(np.moveaxis(traced.image(colour.T), 0, -1), layers, highlight, relative)


def _coated(scene: Scene) -> Components:
    """The components of direct light on a surface that is not Lambertian: by the base, and by a coat without it."""
    names = ("direct", "highlight") if isinstance(scene.coat, Coat) else ("direct",)
    return Components(names, np.ones((len(names), scene.reflectances.shape[1])), names[1:])


def _chosen(traced: Transport, transport: str) -> tuple[Components, np.ndarray]:
    """Components that ``transport`` is made of, and their images (R, L, C, n)."""
    parts = {"linear": ("direct",), "direct": ("direct",), "one-bounce": ("direct", "one_bounce")}.get(transport, PARTS)
    chosen = [c for c, name in enumerate(traced.components.names) if name.startswith(parts)]
    names = tuple(traced.components.names[c] for c in chosen)
    nodes = traced.components.nodes if transport == "full" else ()
    components = Components(names, traced.components.basis[chosen], nodes=nodes)
    return components, traced.facing[None, :, None] if transport == "linear" else traced.images[:, :, chosen]


def _pooled(traced: Transport, variance: np.ndarray) -> np.ndarray:
    """Standard error (3, H, W) from the variance (3, n) of the mean, averaged over POOL × POOL pixels of the object."""
    inside = ndimage.uniform_filter(traced.mask().astype(np.float32), POOL)
    pooled = [ndimage.uniform_filter(image, POOL) for image in traced.image(variance)]
    return np.where(traced.mask(), np.sqrt(np.maximum(pooled, 0) / np.maximum(inside, 1e-6)), 0.0).astype(np.float32)


def mitsuba_picture(
    mi, scene: Scene, config: RunConfig, transport: str, traced: Transport, *, direct_by_formula: bool
) -> Picture:
    """The picture by Mitsuba's own integrator, rendered light by light, as two independent estimates (halves).

    Half h (0 or 1) is rendered with the seed 2 · ``render.seed`` + h and half of ``render.samples`` a pixel. The layers
    are colours in camera units: each has an image for each of R, G and B, where layers of the transport engine have one
    image of geometry. With ``direct_by_formula``, direct light (and the highlight of a coat) is computed by
    ``coated_light`` and takes the place of the rendered direct part, which is discarded. ``mi`` is the Mitsuba module
    with a variant set, ``transport`` the name of the level; ``traced`` tells which pixels see the object.
    """
    from huesphere.render.reference import render_lights

    settings, first, seen = config.render, int(direct_by_formula), traced.mask()
    halves = []
    for half in (0, 1):
        seed, samples = 2 * settings.seed + half, max(1, settings.samples // 2)
        parts = render_lights(mi, scene, transport, samples=samples, seed=seed, max_bounces=settings.max_bounces)
        columns = parts[:, first:, seen].transpose(0, 1, 3, 2)  # (L, parts, 3, n)
        halves.append(columns.reshape(len(parts), -1, columns.shape[-1]))
    replicas = np.stack(halves)  # (2, L, 3 parts, n)
    names = tuple(f"{part}.{c}" for part in PARTS[first : first + columns.shape[1]] for c in "RGB")
    unit = np.tile(np.eye(3), (columns.shape[1], 1))[None, :, None]
    colours = np.broadcast_to(unit, (*replicas.shape[1:3], len(scene.reflectances), 3))
    if direct_by_formula:
        direct = coated_light(mi, scene, traced, cast_shadows=True)
        components = _coated(scene)
        replicas = np.concatenate([np.broadcast_to(direct, (2, *direct.shape[1:])), replicas], axis=2)
        colours = np.concatenate([component_colours(scene, components), colours], axis=1)
        names = components.names + names
    return _picture(scene, traced, replicas, names, colours)
