"""Bounces on a depth map: every pixel a vertex, so that the operator of `render.relief` gives them without a ray."""

from collections.abc import Callable

import numpy as np

from render.bounces import Bounces
from render.raycast import SurfacePoints
from render.relief import apply_kernel, build_kernel
from scenes.build import Scene
from scenes.lights import DomeLight


def is_relief(scene: Scene) -> bool:
    """Whether all that reflects in ``scene`` is one depth map on the pixel grid, of one reflectance, under no dome."""
    domes = any(isinstance(light, DomeLight) for light in scene.lights)
    return scene.pixel_vertex is not None and len(scene.reflectances) == 1 and not domes


class ReliefBounces(Bounces):
    """As `Bounces`, with azimuths for rays. Light at a hit is interpolated from pixels, shadow edges and all."""

    rate = 1.6  # error ∝ azimuths^−rate, measured
    pilot_rays, least_rays, most_rays, step = 4, 4, 4096, 1
    pilot_on_all = True
    unit = "azimuths"

    def first_bounce(
        self,
        points: SurfacePoints,
        rays: int,
        seed: tuple[int, ...],
        beat: Callable[[float], None],
        direct: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        return self._bounces(rays, seed, direct, orders=1)

    def all_bounces(
        self,
        points: SurfacePoints,
        rays: int,
        seed: tuple[int, ...],
        beat: Callable[[float], None],
        direct: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        bounces = self._bounces(rays, seed, direct, orders=self.orders)
        beat(1.0)
        return bounces

    def _bounces(
        self, azimuths: int, seed: tuple[int, ...], direct: np.ndarray, orders: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """(no sky, images (L, K, n)) from ``direct`` (L, n) light."""
        vertex = self.scene.pixel_vertex
        assert vertex is not None
        mask = vertex >= 0
        depth = np.zeros(mask.shape)
        normals = np.zeros((*mask.shape, 3))
        depth[mask] = self.scene.mesh.vertices[vertex[mask], 2]
        normals[mask] = self.scene.mesh.normals[vertex[mask]]
        turns = int(np.random.SeedSequence(seed).generate_state(1)[0])
        kernel = build_kernel(depth, mask, normals, step=self.scene.view.pixel_size, azimuths=azimuths, seed=turns)
        terms = [direct.T]
        floor = self.negligible * max(float(direct.mean()), 1e-30)
        while len(terms) <= orders:
            terms.append(apply_kernel(kernel, terms[-1]))
            if terms[-1].mean() * self.albedo ** (len(terms) - 1) <= floor:
                break
        return np.zeros((direct.shape[1], 0), np.float32), np.stack(terms[1:]).transpose(2, 0, 1)
