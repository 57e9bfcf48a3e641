"""The series of bounces: rays over the hemispheres of pixels and mesh vertices, and the light of the points they hit.

With one reflectance S in the scene the images are computed at unit albedo: there is one image for each number k = 1, 2,
… of reflections elsewhere before light arrives at the point that a pixel sees. On arrival it has collected the factor
S^k; the reflection there, toward the camera, adds one more, the S^(k+1) of ``render.transport``. With several
reflectances the first bounce has one image for each reflectance that it comes from, and all later bounces are computed
together at a few wavelengths, the *nodes*, from which the other wavelengths are interpolated
(``render.spectral.wavelength_nodes``). Where reflectance varies over faces, each hit has weights of the reflectances
(``render.albedo``): a reflection multiplies light by their mean, and the images of the first bounce are of the shares.

A *pilot* is a short run of ``render.transport`` that measures the error for a known number of rays.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from huesphere.render.albedo import weights_on_faces
from huesphere.render.gather import apply_operator, at_hits, concatenate, mean_over_rays, weighted_mean_over_rays
from huesphere.render.raycast import CHUNK_RAYS, Hits, RayCaster, SurfacePoints
from huesphere.render.spectral import Components, components_by_material, components_by_order, wavelength_nodes
from huesphere.scenes.build import Scene
from huesphere.scenes.lights.source import EnvironmentLight, RayLight, UniformLight
from huesphere.scenes.quadrature import fibonacci_lattice

VERTEX_RAYS = 64  # most rays from a mesh vertex, for bounces after the first: the last gather averages their error away
MOST_ORDERS = 1000  # reflections; in a closed cavity of albedo 0.98 next to no light is left after so many
PLASTIC = np.array([0.7548776662466927, 0.5698402909980532])  # steps of the R2 sequence (Roberts 2018)
Report = Callable[[float], None]


@dataclass(frozen=True)
class BounceRequest:
    """What one estimate of the bounces needs."""

    points: SurfacePoints  # the n surface points that the pixels see
    direct: np.ndarray  # (L, n) direct light at these points
    rays: int  # number of rays from each point; of azimuths on a depth map
    seed: tuple[int, ...]
    report: Report = lambda _: None  # called with the share of the work done


@dataclass(frozen=True)
class Gathered:
    """Light that n points receive over their hemispheres, by the gather operator K."""

    first: np.ndarray  # (n, M', L) first bounce off each of the M' reflecting materials
    sky: np.ndarray  # (n, D) direct light of the D domes
    later: np.ndarray  # (n, C) K applied to C columns of light that is given at vertices
    hits: Hits  # where the rays hit the mesh; empty unless kept


class Bounces:
    """The bounces of one scene: what one gather, or the whole series of them, gives at the points of the pixels.

    ``most``: most reflections, None for no limit; ``rest``: whether more than one bounce is wanted; ``negligible``: the
    series ends where a bounce adds a smaller share of the light than this. M: materials of the scene, M' of them
    reflect light and occur in it; L: light sources, D of them domes; V: vertices of the mesh.
    """

    rate = 0.76  # error ∝ rays^−rate for the rotated Fibonacci lattice, measured
    pilot_rays, least_rays, most_rays, step = 64, 16, 1 << 17, 16  # a pilot's; bounds and granularity of the rest
    unit = "rays"

    def __init__(self, scene: Scene, caster: RayCaster, most: int | None, negligible: float, *, rest: bool) -> None:
        self.scene, self.caster = scene, caster
        self.orders = min(most or MOST_ORDERS, MOST_ORDERS) if rest else 1  # most reflections that are computed
        self.negligible = negligible
        self.domes = tuple(light for light in scene.lights if isinstance(light, EnvironmentLight))
        self.dome_columns = [i for i, light in enumerate(scene.lights) if isinstance(light, EnvironmentLight)]
        reflecting = np.flatnonzero(scene.reflectances.max(axis=1) > 0)
        present = np.zeros(len(scene.reflectances), dtype=bool)
        present[scene.mesh.material] = True
        if scene.albedo is not None:
            present |= scene.is_object
        if scene.enclosure is not None:
            present[scene.enclosure.first_material :] = True
        self.reflecting = np.array([m for m in reflecting if present[m]], dtype=int)
        # (M,) number of each material among the M' reflecting ones, −1 for the others; then that of each mesh face.
        self.kind = np.full(len(scene.reflectances), -1, np.int32)
        self.kind[self.reflecting] = np.arange(len(self.reflecting))
        self.face_kind = self.kind[scene.mesh.material]
        self.several = len(self.reflecting) > 1
        if self.several:
            self.nodes = wavelength_nodes(scene.reflectances[self.reflecting])[0]
        # In a room the bounces after the first take as long for a few pixels as for all, so a pilot omits them.
        self.pilot_by_first_bounce = scene.enclosure is not None
        # Largest share of light that a reflection keeps: it decides where the series may end.
        self.albedo = float(scene.reflectances.max())

    # ---- what the images mean ----

    def components(self, images: int, scene: Scene | None = None) -> Components:
        """The components of direct light and of the first ``images`` images of `all_bounces`, in their order.

        ``scene``: a scene that differs from the traced one in its reflectance, if it has only one.
        """
        surfaces = (scene or self.scene).reflectances[self.reflecting]
        if not self.several:
            return components_by_order(
                surfaces[0] if len(surfaces) else np.zeros(self.scene.reflectances.shape[1]), images
            )
        # One image for each reflecting material is the first bounce.
        rest = images > len(self.reflecting)
        return components_by_material(self.scene.reflectances, self.reflecting.tolist(), rest=rest)

    # ---- images ----

    def first_bounce(self, request: BounceRequest, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Direct light of the domes (m, D) and first bounce (L, M', m) at the m points ``chosen``, for a pilot.

        The first bounce is that of the other sources; light of the domes that is reflected is left out.
        """
        gathered = self._gather(
            request.points.take(chosen), request.rays, request.seed, request.report, dome_light=None
        )
        return gathered.sky, gathered.first.transpose(2, 1, 0)

    def all_bounces(self, request: BounceRequest) -> tuple[np.ndarray, np.ndarray]:
        """Direct light of the domes (n, D), and images of the bounces (L, C, n) in the order of `components`."""
        scene, points, rays, seed, report = self.scene, request.points, request.rays, request.seed, request.report
        few_rays = min(VERTEX_RAYS, max(16, rays // 4))
        vertices = self.caster.all_vertex_points()
        share = len(vertices.uv) * few_rays / (len(vertices.uv) * few_rays + len(points.uv) * rays)  # of all rays
        dome_light = None
        if self.domes:
            dome_light = self._gather(vertices, few_rays, (*seed, 1), lambda _: None, dome_light=None).sky
        later = None
        if self.orders > 1 and len(self.reflecting):
            at_vertices = self._gather(
                vertices, few_rays, (*seed, 2), lambda done: report(done * share), keep=True, dome_light=dome_light
            )
            light = self._later(at_vertices, few_rays)
            later = (light, self._factor(light.shape[1])) if light.shape[1] else None
        gathered = self._gather(
            points,
            rays,
            (*seed, 3),
            lambda done: report(share + done * (1 - share)),
            dome_light=dome_light,
            later=later,
        )
        images = gathered.first
        if later is not None:
            images = np.concatenate([images, gathered.later.reshape(len(images), -1, len(scene.lights))], axis=1)
        return gathered.sky, images.transpose(2, 1, 0)

    # ---- the series at mesh vertices ----

    def _later(self, at_vertices: Gathered, rays: int) -> np.ndarray:
        """Light (V, columns) that arrives at the vertices; one more gather makes it all bounces after the first.

        ``at_vertices``: what the vertices gather with ``rays`` rays each, with the hits. Columns are components by
        sources: with one reflectance the terms T_1 … T_(n−1), which become the images T_2 … T_n; with several the sum
        of all terms at each node.
        """
        lights = len(self.scene.lights)
        if not self.several:
            factor = self._factor(lights)
            terms = self._orders(
                at_vertices.first[:, 0],
                lambda term: apply_operator(at_vertices.hits, self.scene.mesh, factor, term, rays),
                float(at_vertices.first.mean()),
            )
            # The last term is not needed: the gather at the pixels makes it from the one before.
            return np.concatenate(terms[:-1], axis=1) if len(terms) > 1 else np.zeros((len(terms[0]), 0), np.float32)
        at_wavelengths = self.scene.reflectances[self.reflecting][:, self.nodes]  # (M', J)
        term = np.einsum("vml,mj->vjl", at_vertices.first, at_wavelengths).reshape(len(at_vertices.first), -1)
        factor = self._factor(len(self.nodes) * lights)
        total = term.copy()
        floor = self.negligible * max(float(np.abs(term).mean()), 1e-30)
        for _ in range(2, self.orders):
            term = apply_operator(at_vertices.hits, self.scene.mesh, factor, term, rays)
            total += term
            if np.abs(term).mean() <= floor:
                break
        return total

    def _orders(
        self, first: np.ndarray, reflected: Callable[[np.ndarray], np.ndarray], light: float
    ) -> list[np.ndarray]:
        """[T_1, T_2, …], each (n, L) at albedo 1, up to the last that is not negligible compared with ``light``.

        ``first`` is T_1, and ``reflected`` computes T_{k+1} from T_k. ``light``: a mean over points and sources, of
        light that arrives. The size of the next term is extrapolated from the ratio of the last two.
        """
        terms, means = [first], [float(first.mean())]
        floor = self.negligible * max(light, 1e-30)
        while len(terms) < self.orders:
            fading = means[-1] / means[-2] if len(means) > 1 and means[-2] > 0 else 1.0
            if means[-1] * fading * self.albedo ** len(terms) <= floor:
                break
            terms.append(reflected(terms[-1]))
            means.append(float(terms[-1].mean()))
        return terms

    def _factor(self, columns: int) -> np.ndarray:
        """Factor (M, columns) by which each material multiplies each column of light when it reflects it.

        1 or 0 with one reflectance in the scene; with several the reflectances at the nodes.
        """
        factor = np.zeros((len(self.scene.reflectances), columns), np.float32)
        if not self.several:
            factor[self.reflecting] = 1.0
        else:
            at_wavelengths = self.scene.reflectances[self.reflecting][:, self.nodes]
            factor[self.reflecting] = np.repeat(at_wavelengths, columns // len(self.nodes), axis=1)
        return factor

    # ---- one sweep of hemispheres ----

    def _gather(
        self,
        points: SurfacePoints,
        rays: int,
        seed: tuple[int, ...],
        report: Report,
        *,
        dome_light: np.ndarray | None = None,
        later: tuple[np.ndarray, np.ndarray] | None = None,
        keep: bool = False,
    ) -> Gathered:
        """Cast ``rays`` rays from each point and sum the light of the points they hit.

        For the first bounce the direct light at each hit is computed, with shadow rays; only that of domes, which is
        smooth, is interpolated from ``dome_light`` (V, D) at vertices. ``later``: light (V, C) and factor (M, C), which
        is gathered with the same rays. ``keep``: whether the hits are returned too.
        """
        count = len(points.uv)
        directions = fibonacci_lattice(rays)
        rng = np.random.default_rng(seed)
        shift = rng.random((count, 2), dtype=np.float32)
        out: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        kept = []
        size = max(1, CHUNK_RAYS // rays)
        nothing = np.zeros((0, 0), np.float32)
        for at in range(0, count, size):
            part = slice(at, min(at + size, count))
            hits, sky = self.caster.hemisphere_hits(points, part, directions, shift, self.domes)
            hits = self.with_weights(hits)
            light = self._light_at(hits, dome_light, rng)
            bounced = self.first_by_kind(hits, self.face_kind[hits.face], light, rays)
            onward = apply_operator(hits, self.scene.mesh, later[1], later[0], rays) if later else nothing
            out.append((bounced, sky, onward))
            if keep:
                kept.append(hits)
            report(part.stop / count)
        bounced, sky, onward = (np.concatenate(column) for column in zip(*out, strict=True))
        return Gathered(bounced, sky, onward, concatenate(kept))

    def with_weights(self, hits: Hits) -> Hits:
        """``hits`` with the weights of reflectances at them, if these vary over faces."""
        if self.scene.albedo is None:
            return hits
        return replace(hits, weight=weights_on_faces(self.caster.mi, self.scene, hits.face, hits.uv))

    def first_by_kind(self, hits: Hits, kind: np.ndarray, light: np.ndarray, rays: int) -> np.ndarray:
        """First bounce (n, M', C) off each reflecting material: ``light`` (h, C) at hits, whose kinds are (h,).

        A hit of a negative kind reflects nothing.
        """
        if hits.weight is None:
            return mean_over_rays(hits, kind, max(1, len(self.reflecting)), light, rays)
        weight = hits.weight[:, self.reflecting]
        if len(self.reflecting) == 0:
            weight = np.zeros((len(hits.face), 1), np.float32)
        return weighted_mean_over_rays(hits, weight, light, rays)

    def _light_at(self, hits: Hits, dome_light: np.ndarray | None, rng: np.random.Generator) -> np.ndarray:
        """Direct light of every source at the hits, (h, L)."""
        columns = np.zeros((len(hits.face), len(self.scene.lights)), np.float32)
        for i, light in enumerate(self.scene.lights):
            if isinstance(light, UniformLight):
                columns[:, i] = 1.0
            elif isinstance(light, RayLight):
                square = self._squares(hits, rng) if light.sampled else None
                columns[:, i] = self.caster.arriving(hits, light, square)[1]
        if dome_light is not None:
            columns[:, self.dome_columns] = at_hits(hits, self.scene.mesh, dome_light)
        return columns

    @staticmethod
    def _squares(hits: Hits, rng: np.random.Generator) -> np.ndarray:
        """A point in [0, 1)² for each hit: the hits of one hemisphere together cover an extended source evenly."""
        count = np.diff(hits.start)
        number = np.arange(len(hits.face)) - np.repeat(hits.start[:-1], count)
        shift = np.repeat(rng.random((len(count), 2)), count, axis=0)
        return (shift + number[:, None] * PLASTIC) % 1.0
