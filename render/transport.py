"""Light transport without wavelength: for each light and each number of bounces, one image of pure geometry.

A path of k reflections off one reflectance S carries S(λ)^k, so a pixel's spectrum is Σ_i Σ_k T_ik E_i S^(k+1), with
T_ik the transport at unit albedo. T_i0 = max(0, a_i·n) V_i is direct light, without sampling; the rest comes from the
gather operator, T_{k+1} = K T_k, integrated until its own estimate of the error meets the target.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from render.gather import apply_operator, concatenate, fibonacci_lattice, mean_over_rays
from render.raycast import CHUNK_RAYS, Hits, RayCaster, SurfacePoints, ray_caster
from render.spectral import colours_by_order
from scenes.build import Scene

OFFSET_PIXELS = 0.01  # how far rays start off the surface
REPLICATES = 2  # independent rotations of the direction set: their spread is the error
RATE = 0.76  # measured: error ∝ rays^−RATE for the rotated Fibonacci lattice
PILOT_POINTS, PILOT_RAYS = 4096, 64
NODE_RAYS = 128  # rays at mesh vertices, for bounces after the first: their error is averaged away by the final gather
MOST_ORDERS = 64
MOST_RAYS = 1 << 17
NEGLIGIBLE = 0.02  # an order weaker than this share of the target ends the series

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Pixels:
    """The pixels that see the object, and the points that they see at their centres."""

    row: np.ndarray  # (n,) int
    col: np.ndarray  # (n,) int
    points: SurfacePoints

    def subset(self, chosen: np.ndarray) -> "Pixels":
        return Pixels(self.row[chosen], self.col[chosen], self.points.take(chosen))


@dataclass(frozen=True)
class Transport:
    """Geometry of the light in one scene; images as (n,) columns over ``pixels``; unit albedo; L lights."""

    shape: tuple[int, int]  # of the picture, (H, W)
    pixels: Pixels
    facing: np.ndarray  # (L, n) max(0, a·n): light that would arrive if nothing stood in its way
    direct: np.ndarray  # (L, n) light that arrives
    bounces: np.ndarray  # (R, L, K, n) T_1 … T_K, in R independent estimates; R, K may be 0
    rays: int  # per point and replicate
    error: float  # estimated relative standard error of the colour, RMS over object pixels; 0 without sampling

    def mask(self) -> np.ndarray:
        """The object's outline, (H, W) bool."""
        out = np.zeros(self.shape, dtype=bool)
        out[self.pixels.row, self.pixels.col] = True
        return out

    def image(self, values: np.ndarray, fill: float = 0.0) -> np.ndarray:
        """Columns (..., n) over the pixels as images (..., H, W)."""
        out = np.full((*values.shape[:-1], *self.shape), fill, dtype=np.float32)
        out[..., self.pixels.row, self.pixels.col] = values
        return out


def trace(
    scene: Scene,
    mi,  # the Mitsuba module, variant set
    *,
    cast_shadows: bool,
    indirect: bool,
    target_rms: float,
    max_bounces: int | None,
    seed: int,
    progress: Progress,
) -> Transport:
    """Trace ``scene`` once, for every light and bounce, to a relative standard error of ``target_rms``.

    ``cast_shadows`` and ``indirect`` False leave out what a caller does not want. The error estimate sees sampling
    only, not the mesh's resolution.
    """
    progress(0.0, "geometry")
    caster = ray_caster(mi, scene.mesh, OFFSET_PIXELS * scene.view.pixel_size)
    pixels = find_pixels(scene, caster)
    directions = [light.direction for light in scene.lights]
    facing, direct = _direct_light(scene, caster, pixels, directions, cast_shadows)
    none = np.zeros((0, len(directions), 0, len(pixels.row)), np.float32)
    shape = (scene.view.height, scene.view.width)
    traced = Transport(shape, pixels, facing, direct, none, rays=0, error=0.0)
    if not indirect or len(pixels.row) == 0:
        return traced
    return _trace_bounces(scene, caster, traced, target_rms, max_bounces, seed, progress)


# ---- what each pixel sees ------------------------------------------------------------------------------------------


def find_pixels(scene: Scene, caster: RayCaster) -> Pixels:
    """Object pixels and the surface points at their centres."""
    view = scene.view
    if scene.pixel_vertex is not None:
        row, col = np.nonzero(scene.pixel_vertex >= 0)
        return Pixels(row, col, caster.vertex_points(scene.pixel_vertex[row, col]))
    rows, cols = np.indices((view.height, view.width)).reshape(2, -1)
    hit, points = _camera_hits(scene, caster, rows + 0.5, cols + 0.5)
    on_object = scene.is_object[scene.mesh.material[points.face]] & (points.normal[:, 2] > 0)
    chosen = np.flatnonzero(hit)[on_object]
    return Pixels(rows[chosen], cols[chosen], points.take(on_object))


def _camera_hits(
    scene: Scene, caster: RayCaster, rows: np.ndarray, cols: np.ndarray
) -> tuple[np.ndarray, SurfacePoints]:
    """First hits of camera rays through (row, col) given in pixels."""
    top = scene.mesh.vertices[:, 2].max() + scene.view.pixel_size
    origins = np.concatenate([scene.view.pixel_xy(rows, cols), np.full((len(rows), 1), top)], axis=1)
    return caster.first_hits(origins, np.broadcast_to(np.array([0.0, 0.0, -1.0]), origins.shape))


def _direct_light(
    scene: Scene, caster: RayCaster, pixels: Pixels, directions: list[np.ndarray], cast_shadows: bool
) -> tuple[np.ndarray, np.ndarray]:
    """(facing, direct), each (L, n): max(0, a·n) without and with the shadows that the scene casts.

    Shading is that of the pixel's centre, where the true normal is; visibility is the share, among sub-pixel points
    that face the light, of those that see it: a shadow's edge is smooth and yet lit pixels keep ρ = F n exactly.
    With ``scene.area_pixels`` both are averages over the pixel's area, as a camera takes them.
    """
    count = len(pixels.row)
    facing = np.stack([np.maximum(pixels.points.normal @ a, 0.0) for a in directions]).astype(np.float32)
    if not (cast_shadows or scene.area_pixels) or count == 0:
        return facing, facing
    across = caster.subpixels
    steps = (np.arange(across) + 0.5) / across
    down, right = (grid.ravel() for grid in np.meshgrid(steps, steps, indexing="ij"))
    hit, points = _camera_hits(
        scene, caster, (pixels.row[:, None] + down).ravel(), (pixels.col[:, None] + right).ravel()
    )
    owner = np.repeat(np.arange(count), across**2)[hit]

    def per_pixel(values: np.ndarray) -> np.ndarray:
        return np.bincount(owner, values, minlength=count)

    direct = np.empty_like(facing)
    for light, direction in enumerate(directions):
        cosine = np.maximum(points.normal @ direction, 0.0)
        lit = cosine > 0
        blocked = caster.blocked(points.origin, direction, lit) if cast_shadows else np.zeros_like(lit)
        if scene.area_pixels:
            facing[light] = per_pixel(cosine) / across**2
            direct[light] = per_pixel(cosine * ~blocked) / across**2
        else:
            direct[light] = facing[light] * (1.0 - per_pixel(blocked) / np.maximum(per_pixel(lit), 1.0))
    return facing, direct


# ---- bounces -------------------------------------------------------------------------------------------------------


def _trace_bounces(
    scene: Scene, caster: RayCaster, traced: Transport, target: float, most: int | None, seed: int, progress: Progress
) -> Transport:
    colours = colours_by_order(scene, MOST_ORDERS + 1)
    mean = _colour(colours, traced.direct).mean(axis=1)
    mean = np.where(mean > 0, mean, 1.0)
    gather = _Gather(scene, caster, colours, most, NEGLIGIBLE * target)
    pixels = traced.pixels

    def error(bounces: np.ndarray) -> float:
        """RMS over pixels and channels of the standard error, in units of the channel's mean over the object."""
        replicas = np.stack([_colour_of_bounces(colours, b) for b in bounces]) / mean[:, None]
        return float(np.sqrt(np.mean(replicas.var(axis=0, ddof=1)) / len(bounces)))

    # A pilot over a few pixels says how many rays the target takes.
    progress(0.02, "pilot")
    rng = np.random.default_rng((seed, 0))
    chosen = np.sort(rng.permutation(len(pixels.row))[:PILOT_POINTS])
    few = pixels.subset(chosen)
    pilot = _stack([gather.first_bounce(few, PILOT_RAYS, (seed, 1, r), lambda _: None) for r in range(REPLICATES)])
    rays = _rays_for(target, error(pilot), PILOT_RAYS)

    estimates: list[np.ndarray] = []
    while len(estimates) < REPLICATES or (error(_stack(estimates)) > target and len(estimates) < 4 * REPLICATES):
        number = len(estimates)
        total = max(REPLICATES, number + 1)

        def beat(share: float, number: int = number, total: int = total) -> None:
            progress(0.05 + 0.95 * (number + share) / total, f"bounces, {rays} rays a point")

        estimates.append(gather.all_bounces(pixels, rays, (seed, 2, number), beat))
    bounces = _stack(estimates)
    return replace(traced, bounces=bounces, rays=rays, error=error(bounces))


def _rays_for(target: float, pilot_error: float, pilot_rays: int) -> int:
    """Rays that bring the error of the pilot down to nine tenths of the target; a multiple of 16."""
    wanted = pilot_rays * (max(pilot_error, 1e-12) / (0.9 * target)) ** (1 / RATE)
    return int(np.clip(16 * np.ceil(wanted / 16), 16, MOST_RAYS))


def _stack(estimates: list[np.ndarray]) -> np.ndarray:
    """Replicates (L, K_r, n) as (R, L, K, n): orders that one of them did not need are 0 there."""
    orders = max(e.shape[1] for e in estimates)
    return np.stack([np.pad(e, ((0, 0), (0, orders - e.shape[1]), (0, 0))) for e in estimates])


class _Gather:
    """The gather of one scene: hemispheres from pixels and from mesh vertices, and the series of bounces."""

    def __init__(
        self, scene: Scene, caster: RayCaster, colours: np.ndarray, most: int | None, negligible: float
    ) -> None:
        self.scene, self.caster, self.colours = scene, caster, colours
        self.orders = min(most or MOST_ORDERS, MOST_ORDERS)
        self.negligible = negligible
        self.directions = [light.direction for light in scene.lights]
        self.reflects = scene.reflectances.max(axis=1)[scene.mesh.material] > 0  # (F,)

    def first_bounce(
        self, pixels: Pixels, rays: int, seed: tuple[int, ...], beat: Callable[[float], None]
    ) -> np.ndarray:
        """T_1 at pixels, (L, 1, n)."""
        light, _ = self._gather(pixels.points, rays, seed, beat, keep=False)
        return light.T[:, None]

    def all_bounces(
        self, pixels: Pixels, rays: int, seed: tuple[int, ...], beat: Callable[[float], None]
    ) -> np.ndarray:
        """T_1 … T_K at pixels, (L, K, n): as many orders as matter."""
        if self.scene.pixel_vertex is not None:
            # Every pixel is a mesh vertex: the pixels' own hemispheres are the operator.
            first, hits = self._gather(pixels.points, rays, seed, beat, keep=True)
            return np.stack(self._series(first, hits, rays), axis=0).transpose(2, 0, 1)
        node_rays = min(rays, NODE_RAYS)
        nodes = self.caster.vertex_points(np.arange(len(self.scene.mesh.vertices)))
        share = len(nodes.normal) * node_rays / (len(nodes.normal) * node_rays + len(pixels.row) * rays)
        first, hits = self._gather(nodes, node_rays, (*seed, 1), lambda done: beat(share * done), keep=True)
        at_nodes = self._series(first, hits, node_rays)
        later = np.concatenate(at_nodes[:-1], axis=1) if len(at_nodes) > 1 else None
        values, _ = self._gather(
            pixels.points, rays, seed, lambda done: beat(share + (1 - share) * done), keep=False, later=later
        )
        lights = len(self.directions)
        return values.reshape(len(values), -1, lights).transpose(2, 1, 0)

    def _series(self, first: np.ndarray, hits: Hits, rays: int) -> list[np.ndarray]:
        """[T_1, T_2, …] at the points whose hemispheres are ``hits``, each (n, L), until an order is negligible."""
        terms = [first]
        scale = np.abs(self.colours[:, 0]).sum()
        while len(terms) < self.orders:
            order = len(terms) + 1
            new = apply_operator(hits, self.scene.mesh.faces, terms[-1], rays)
            terms.append(new)
            if np.abs(new.mean(axis=0) @ self.colours[:, order]).sum() <= self.negligible * scale:
                break
        return terms

    def _gather(
        self,
        points: SurfacePoints,
        rays: int,
        seed: tuple[int, ...],
        beat: Callable[[float], None],
        *,
        keep: bool,
        later: np.ndarray | None = None,
    ) -> tuple[np.ndarray, Hits]:
        """First bounce at ``points``, (n, L), and with ``later`` (V, C) at vertices K·later beside it, (n, L + C).

        The first bounce is summed from the exact direct light at each hit, shadow rays and all. The hits come back
        too where ``keep`` asks for them, else none.
        """
        count = len(points.normal)
        directions = fibonacci_lattice(rays)
        shift = np.random.default_rng(seed).random((count, 2), dtype=np.float32)
        values, kept = [], []
        size = max(1, CHUNK_RAYS // rays)
        for at in range(0, count, size):
            hits = self.caster.hemisphere_hits(points, slice(at, min(at + size, count)), directions, shift)
            hits = self._drop_black(hits)
            direct = np.stack([self.caster.cosine_at_hits(hits, a) for a in self.directions], axis=1)
            chunk = mean_over_rays(hits, direct, rays)
            if later is not None:
                chunk = np.concatenate([chunk, apply_operator(hits, self.scene.mesh.faces, later, rays)], axis=1)
            values.append(chunk)
            if keep:
                kept.append(hits)
            beat(min(1.0, (at + size) / count))
        return np.concatenate(values), concatenate(kept)

    def _drop_black(self, hits: Hits) -> Hits:
        """Without the hits on faces that reflect nothing."""
        if self.reflects.all():
            return hits
        bright = self.reflects[hits.face]
        before = np.concatenate([[0], np.cumsum(bright)])
        return Hits(before[hits.start], hits.face[bright], hits.uv[bright])


def _colour(colours: np.ndarray, direct: np.ndarray) -> np.ndarray:
    return colours[:, 0].T @ direct


def _colour_of_bounces(colours: np.ndarray, bounces: np.ndarray) -> np.ndarray:
    """RGB (3, n) of T_1 … T_K (L, K, n)."""
    return np.einsum("lkc,lkn->cn", colours[:, 1 : bounces.shape[1] + 1], bounces)
