"""Bounces on a depth map whose pixels are the vertices of the mesh, by ``render.relief``, not by rays."""

import numpy as np

from huesphere.render.albedo import weights_at_vertices
from huesphere.render.bounces import BounceRequest, Bounces
from huesphere.render.relief import ReliefKernel, apply_kernel, build_kernel, gather_without_kernel
from huesphere.scenes.build import Scene
from huesphere.scenes.lights.source import EnvironmentLight

KEPT = 2_500_000  # most pixels × azimuths for which the kernel is kept in memory, about a gigabyte
LEAST_AZIMUTHS = 4


def is_relief(scene: Scene) -> bool:
    """Whether ``scene`` is one depth map on the pixel grid with one hue of reflectance and nothing else, no dome."""
    domes = any(isinstance(light, EnvironmentLight) for light in scene.lights)
    return scene.pixel_vertex is not None and len(scene.reflectances) == 1 and not domes


class ReliefBounces(Bounces):
    """`Bounces` with azimuths in place of rays. Direct light where a profile is seen is interpolated between pixels.

    If the kernel is too large to be kept, it is computed row by row and applied to all orders at once. The light of the
    orders to which it is applied then comes from a kernel with fewer azimuths, which is computed once; each row
    averages hundreds of pixels, and with them the error of that kernel.
    """

    _sources: list[np.ndarray] | None = None  # [T_1, T_2, …] by the kernel with fewer azimuths

    rate = 1.6  # error ∝ azimuths^−rate, measured
    pilot_rays, least_rays, most_rays, step = LEAST_AZIMUTHS, LEAST_AZIMUTHS, 4096, 1
    unit = "azimuths"

    def __init__(self, scene: Scene, *arguments, **options) -> None:
        super().__init__(scene, *arguments, **options)
        self.pilot_by_first_bounce = True
        vertex = scene.pixel_vertex
        assert vertex is not None
        mask = vertex >= 0
        depth, normals = np.zeros(mask.shape), np.zeros((*mask.shape, 3))
        depth[mask] = scene.mesh.vertices[vertex[mask], 2]
        normals[mask] = scene.mesh.normals[vertex[mask]]
        self._surface = depth, mask, normals
        # (n, 1) factor of the reflectance at each pixel: light that arrives there times this is what is reflected
        self._scale = np.ones((int(mask.sum()), 1), np.float32)
        if scene.albedo is not None:
            self._scale = weights_at_vertices(self.caster.mi, scene, vertex[mask])

    def first_bounce(self, request: BounceRequest, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As `Bounces.first_bounce`; there are no domes."""
        options = self._options(request.rays, request.seed)
        first = gather_without_kernel(
            *self._surface, request.direct.T * self._scale, **options, rows=chosen, report=request.report
        )
        return np.zeros((len(first), 0), np.float32), first.T[:, None]

    def all_bounces(self, request: BounceRequest) -> tuple[np.ndarray, np.ndarray]:
        """As `Bounces.all_bounces`: light of no domes (n, 0), and images (L, K, n)."""
        direct, rays, seed, report = request.direct, request.rays, request.seed, request.report
        count = direct.shape[1]
        kept = count * rays <= KEPT or self.orders == 1
        options = self._options(rays, seed)
        if self.orders == 1:
            sent = direct.T * self._scale
            terms = [direct.T, gather_without_kernel(*self._surface, sent, **options, report=report)]
        elif kept:
            kernel = build_kernel(*self._surface, **options, report=report)
            terms = self._series(kernel, direct.T)
        else:
            share = 0.0
            if self._sources is None:
                few = max(LEAST_AZIMUTHS, KEPT // count)
                share = few / (few + rays)
                coarse = self._options(few, (*seed, 1))
                kernel = build_kernel(*self._surface, **coarse, report=lambda done: report(done * share))
                self._sources = self._series(kernel, direct.T)[1:]
                del kernel
            source = np.concatenate([direct.T, *self._sources[:-1]], axis=1) * self._scale
            rest = 1 - share
            gathered = gather_without_kernel(
                *self._surface, source, **options, report=lambda done: report(share + done * rest)
            )
            terms = [direct.T, *np.split(gathered, len(self._sources), axis=1)]
        return np.zeros((count, 0), np.float32), np.stack(terms[1:]).transpose(2, 0, 1)

    def _options(self, azimuths: int, seed: tuple[int, ...]) -> dict:
        """Arguments of ``build_kernel`` and ``gather_without_kernel``."""
        turns = int(np.random.SeedSequence(seed).generate_state(1)[0])
        return {"step": self.scene.view.pixel_size, "azimuths": azimuths, "seed": turns}

    def _series(self, kernel: ReliefKernel, direct: np.ndarray) -> list[np.ndarray]:
        """[T_0, T_1, …], each (n, L) at albedo 1, by repeated application of ``kernel`` to direct light T_0."""

        def reflected(term: np.ndarray) -> np.ndarray:
            return apply_kernel(kernel, term * self._scale)

        return [direct, *self._orders(reflected(direct), reflected, float(direct.mean()))]
