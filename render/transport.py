"""Light transport without wavelength: for each source and each number of reflections, one image of pure geometry.

Let E_i(λ) be the spectrum of light i and S(λ) the reflectance of the surface. Light that reaches a pixel's surface
point after k reflections elsewhere, and is then reflected to the camera, has the spectrum E_i S^(k+1). So a pixel's
spectrum is Σ_i Σ_k T_ik E_i S^(k+1), where T_ik is the light that arrives at unit albedo. T_i0 is direct light; the
rest comes from the gather operator, T_{k+1} = K T_k, which is integrated by Monte Carlo until the estimated error meets
the target. In a scene with several reflectances S^k becomes one of C *components*, the products of reflectances that
light can have collected before it arrives (``render.spectral.Components``).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from huesphere.render.albedo import weights_at_vertices, weights_on_faces
from huesphere.render.bounces import BounceRequest, Bounces
from huesphere.render.direct import PixelAreas, camera_hits, direct_light
from huesphere.render.enclosed import EnclosedBounces
from huesphere.render.raycast import RayCaster, SurfacePoints, ray_caster
from huesphere.render.relief_bounces import ReliefBounces, is_relief
from huesphere.render.spectral import Components, Seen, colour_of, component_colours
from huesphere.scenes.build import Scene
from huesphere.scenes.lights.source import EnvironmentLight

OFFSET_PIXELS = 0.01  # how far rays start off the surface
REPLICATES = 2  # least number of independent estimates, each with another random rotation of the directions
MOST_REPLICATES = 16
PILOT_POINTS = 4096  # pixels of the first pilot, the short run that measures the error for a known number of rays
PILOT_STAGES, PILOT_STEP = 4, 8  # most pilots, and the factor of the rays from one to the next
RAYS_PER_SHADOW_RAY = 64  # rays of the gather for each shadow ray from a sub-pixel point to an extended source
NEGLIGIBLE = 0.02  # the series of bounces ends where a bounce is weaker than this share of the target error

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Pixels:
    """The pixels that see the object, and the points that they see at their centres."""

    row: np.ndarray  # (n,) int
    col: np.ndarray  # (n,) int
    points: SurfacePoints
    material: np.ndarray  # (n,) int, number of the reflectance
    weights: np.ndarray | None = None  # (n, M) of each reflectance where it varies over faces, else None


@dataclass(frozen=True)
class Transport:
    """Geometry of the light in one scene; images as (n,) columns over ``pixels``; L sources, C components."""

    shape: tuple[int, int]  # of the picture, (H, W)
    pixels: Pixels
    facing: np.ndarray  # (L, n) light that would arrive if nothing blocked it
    images: np.ndarray  # (R, L, C, n), R independent estimates of each image; component 0 is direct light
    components: Components  # product of reflectances that belongs to each of the C images
    rays: int = 0  # per point and replicate; azimuths on a depth map
    unit: str = "rays"
    error: float = 0.0  # estimated relative standard error of the colour, RMS over object pixels

    def mask(self) -> np.ndarray:
        """(H, W) bool, pixels that see the object."""
        out = np.zeros(self.shape, dtype=bool)
        out[self.pixels.row, self.pixels.col] = True
        return out

    def image(self, values: np.ndarray, fill: float = 0.0) -> np.ndarray:
        """Columns (..., n) over the pixels as images (..., H, W)."""
        out = np.full((*values.shape[:-1], *self.shape), fill, dtype=np.float32)
        out[..., self.pixels.row, self.pixels.col] = values
        return out


def trace(scene: Scene, mi, **options) -> Transport:
    """The transport of one scene; ``options`` and errors are those of ``trace_alike``."""
    return trace_alike([scene], mi, **options)[0]


def trace_alike(
    scenes: Sequence[Scene],
    mi,  # the Mitsuba module, variant set
    *,
    reach: str,
    target_rms: float,
    max_bounces: int | None,
    seed: int,
    progress: Progress,
) -> list[Transport]:
    """Trace several scenes that differ only in their spectra: one transport for each, with images that all share.

    Sampling goes on until the relative standard error of the colours is at most ``target_rms`` in every scene. The
    estimate of the error includes sampling only, not the resolution of the mesh. ``reach`` is the highest level of
    transport that is wanted: "linear" (no shadow rays), "direct" (no rays over the hemisphere, except for light from
    domes), "one-bounce" or "full".
    """
    # The scene whose surface reflects most decides after how many bounces the series ends.
    scene = max(scenes, key=lambda one: float(one.reflectances.max()))
    progress(0.0, "geometry")
    caster = ray_caster(mi, scene.mesh, OFFSET_PIXELS * scene.view.pixel_size)
    pixels = find_pixels(scene, caster)
    kind = EnclosedBounces if scene.enclosure is not None else ReliefBounces if is_relief(scene) else Bounces
    bounces = kind(scene, caster, max_bounces, NEGLIGIBLE * target_rms, rest=reach == "full")
    areas = None
    if (reach != "linear" or scene.area_pixels) and len(pixels.row) > 0:  # Dr.Jit aborts the process over no rays
        areas = PixelAreas(scene, caster, pixels.row, pixels.col, pixels.points)
        facing = np.stack([areas.facing(light) for light in scene.lights])
    else:
        facing = np.stack([light.unoccluded(pixels.points.position, pixels.points.normal) for light in scene.lights])
    facing = facing.astype(np.float32)
    pixels = _with_weights(scene, caster, pixels, areas)
    shape = (scene.view.height, scene.view.width)
    traced = Transport(shape, pixels, facing, facing[None, :, None], bounces.components(0))
    if reach != "linear" and areas is not None:
        sampler = _Sampler(scenes, bounces, areas, traced, hemispheres=reach != "direct")
        if sampler.samples_anything:
            traced = _to_accuracy(sampler, traced, target_rms, seed, progress)
        else:
            traced = replace(traced, images=sampler.direct(0, (seed, 0))[None, :, None])
    bounced_images = traced.images.shape[2] - 1  # all but that of direct light
    return [replace(traced, components=bounces.components(bounced_images, one)) for one in scenes]


def find_pixels(scene: Scene, caster: RayCaster) -> Pixels:
    """The pixels whose centre sees the front of the object, and the surface points there.

    A depth map on the pixel grid has a mesh vertex at each pixel's centre: these are the points. For all other scenes
    rays are cast from the camera.
    """
    view = scene.view
    if scene.pixel_vertex is not None:
        row, col = np.nonzero(scene.pixel_vertex >= 0)
        material = np.zeros(len(scene.mesh.vertices), np.int32)
        material[scene.mesh.faces] = scene.mesh.material[:, None]
        vertex = scene.pixel_vertex[row, col]
        return Pixels(row, col, caster.vertex_points(vertex), material[vertex])
    rows, cols = np.indices((view.height, view.width)).reshape(2, -1)
    hit, points = camera_hits(scene, caster, rows + 0.5, cols + 0.5)
    toward = -view.rays(rows[hit] + 0.5, cols[hit] + 0.5)[1]
    material = scene.mesh.material[points.face]
    seen = scene.is_object[material] & (np.einsum("nc,nc->n", points.normal, toward) > 0)
    chosen = np.flatnonzero(hit)[seen]
    return Pixels(rows[chosen], cols[chosen], points.take(seen), material[seen])


def _with_weights(scene: Scene, caster: RayCaster, pixels: Pixels, areas: PixelAreas | None) -> Pixels:
    """``pixels`` with the weights of reflectances at their centres, or their means over the areas of the pixels."""
    if scene.albedo is None:
        return pixels
    if scene.area_pixels and areas is not None:
        return replace(
            pixels, weights=areas.means(weights_on_faces(caster.mi, scene, areas.points.face, areas.points.uv))
        )
    if scene.pixel_vertex is not None:
        vertex = scene.pixel_vertex[pixels.row, pixels.col]
        return replace(pixels, weights=weights_at_vertices(caster.mi, scene, vertex))
    return replace(pixels, weights=weights_on_faces(caster.mi, scene, pixels.points.face, pixels.points.uv))


# ---- accuracy ------------------------------------------------------------------------------------------------------


def _to_accuracy(sampler: "_Sampler", traced: Transport, target: float, seed: int, progress: Progress) -> Transport:
    """``traced`` with images from as many independent estimates as bring the estimated error to ``target``."""
    progress(0.02, "pilot")
    rays = sampler.bounces.pilot_rays
    for stage in range(PILOT_STAGES):
        wanted = _rays_for(sampler.bounces, target, sampler.pilot_error(rays, (seed, 1, stage)), rays)
        # The error falls with the rays at a rate that depends on the scene. So instead of extrapolating far, another
        # pilot is run with more rays.
        far = wanted > PILOT_STEP * rays and stage + 1 < PILOT_STAGES
        rays = PILOT_STEP * rays if far else wanted
        if not far:
            break
    estimates: list[np.ndarray] = []
    error = np.inf
    while len(estimates) < REPLICATES or (error > target and len(estimates) < MOST_REPLICATES):
        number, total = len(estimates), max(REPLICATES, len(estimates) + 1)

        def report(share: float, number: int = number, total: int = total) -> None:
            progress(0.05 + 0.95 * (number + share) / total, f"light, {rays} {sampler.bounces.unit} a point")

        estimates.append(sampler.estimate(rays, (seed, 2, number), report))
        if len(estimates) >= REPLICATES:
            error = sampler.error(_stack(estimates))
    images = _stack(estimates)
    components = sampler.bounces.components(images.shape[2] - 1)
    return replace(traced, images=images, components=components, rays=rays, unit=sampler.bounces.unit, error=error)


def _rays_for(bounces: Bounces, target: float, pilot_error: float, pilot_rays: int) -> int:
    """Number of rays a point at which the error is expected to be nine tenths of the ``target``.

    Extrapolated from ``pilot_error`` with ``pilot_rays`` at the rate of convergence of the bounces.
    """
    wanted = pilot_rays * (max(pilot_error, 1e-12) / (0.9 * target)) ** (1 / bounces.rate)
    return int(np.clip(bounces.step * np.ceil(wanted / bounces.step), bounces.least_rays, bounces.most_rays))


def _stack(estimates: list[np.ndarray]) -> np.ndarray:
    """R estimates (L, C_r, n) as one array (R, L, C, n), C the largest C_r; components that an estimate lacks are 0."""
    most = max(e.shape[1] for e in estimates)
    return np.stack([np.pad(e, ((0, 0), (0, most - e.shape[1]), (0, 0))) for e in estimates])


class _Sampler:
    """Makes independent estimates of the images of scenes that share them, and estimates the error from their spread.

    ``hemispheres``: whether bounces are wanted. Without them the hemisphere is sampled only where there are domes.
    """

    def __init__(
        self, scenes: Sequence[Scene], bounces: Bounces, areas: PixelAreas, traced: Transport, *, hemispheres: bool
    ) -> None:
        self.scenes, self.bounces, self.areas, self.traced = scenes, bounces, areas, traced
        self.lights = bounces.scene.lights
        self.hemispheres = hemispheres or bool(bounces.domes)
        self.keep_bounces = hemispheres
        self.samples_anything = self.hemispheres or any(light.sampled for light in self.lights)
        self._latest: dict[int, np.ndarray] = {}  # direct light (n,) last computed, by number of the source

    def direct(self, rays: int, seed: tuple[int, ...]) -> np.ndarray:
        """Direct light (L, n) of each source; sources without random sampling are computed only once.

        It is 0 for domes (skies), whose light is gathered together with the bounces.
        """
        rng = np.random.default_rng((*seed, 9))
        out = np.zeros_like(self.traced.facing)
        for i, light in enumerate(self.lights):
            if isinstance(light, EnvironmentLight):
                continue
            if i not in self._latest or light.sampled:
                self._latest[i] = direct_light(self.areas, light, max(1, rays // RAYS_PER_SHADOW_RAY), rng)
            out[i] = self._latest[i]
        return out

    def estimate(self, rays: int, seed: tuple[int, ...], report: Callable[[float], None]) -> np.ndarray:
        """One estimate of all images, (L, C, n), with ``rays`` rays a point; ``report`` is given the share done."""
        direct = self.direct(rays, seed)
        if not self.hemispheres:
            return direct[:, None]
        wanted = BounceRequest(self.traced.pixels.points, direct, rays, seed, report)
        if self.keep_bounces:
            sky, images = self.bounces.all_bounces(wanted)
        else:
            sky = self.bounces.first_bounce(wanted, np.arange(direct.shape[1]))[0]
            images = np.zeros((len(direct), 0, direct.shape[1]))
        direct[self.bounces.dome_columns] = sky.T
        return np.concatenate([direct[:, None], images.astype(np.float32)], axis=1)

    def pilot_error(self, rays: int, seed: tuple[int, ...]) -> float:
        """``error`` of the mean of REPLICATES estimates with ``rays`` rays a point, measured on a sample of pixels."""
        count = len(self.traced.pixels.row)
        few = max(256, PILOT_POINTS * self.bounces.pilot_rays // rays)
        chosen = np.sort(np.random.default_rng(seed).permutation(count)[:few])
        points = self.traced.pixels.points
        estimates = []
        for replicate in range(REPLICATES):
            bounces, own = self.bounces, (*seed, replicate)
            direct = self.direct(rays, own)
            sky, images = np.zeros((len(chosen), 0)), np.zeros((len(direct), 0, len(chosen)), np.float32)
            if self.hemispheres and self.keep_bounces and not bounces.pilot_by_first_bounce:
                sky, images = bounces.all_bounces(BounceRequest(points.take(chosen), direct[:, chosen], rays, own))
            elif self.hemispheres:
                sky, images = bounces.first_bounce(BounceRequest(points, direct, rays, own), chosen)
            direct = direct[:, chosen]
            direct[self.bounces.dome_columns] = sky.T
            images = images if self.keep_bounces else images[:, :0]
            estimates.append(np.concatenate([direct[:, None], images], axis=1))
        return self.error(_stack(estimates), chosen)

    def error(self, images: np.ndarray, chosen: np.ndarray | None = None) -> float:
        """Relative standard error of the colours that the mean of R estimates gives: the largest among the scenes.

        ``images`` (R, L, C, m) are the estimates at the m pixels ``chosen``, numbers among the object's pixels, or at
        all of them. For one scene it is the RMS, over pixels and channels, of the standard error divided by the mean of
        the channel over the pixels.
        """
        pixels = self.traced.pixels
        seen = Seen(pixels.material, pixels.weights)
        seen = seen if chosen is None else seen.take(chosen)
        return max(self._error_in(scene, images, seen) for scene in self.scenes)

    def _error_in(self, scene: Scene, images: np.ndarray, seen: Seen) -> float:
        """``error`` for one scene; ``seen`` is what each of the m pixels sees."""
        components = self.bounces.components(images.shape[2] - 1, scene)
        component_rgb = component_colours(scene, components)[:, : images.shape[2]]
        colours = np.stack([colour_of(estimate, component_rgb, seen) for estimate in images])  # (R, m, channels)
        mean = colours.mean(axis=(0, 1))
        variance = colours.var(axis=0, ddof=1) / len(colours)
        return float(np.sqrt(np.mean(variance / np.where(mean > 0, mean, 1.0) ** 2)))
