"""Direct light of each source at the pixels, with and without the shadows that the scene casts."""

import numba
import numpy as np

from huesphere.render.raycast import RayCaster, SurfacePoints
from huesphere.scenes.build import Scene
from huesphere.scenes.lights.source import Light, RayLight
from huesphere.scenes.quadrature import fibonacci_lattice


def camera_hits(
    scene: Scene, caster: RayCaster, rows: np.ndarray, cols: np.ndarray
) -> tuple[np.ndarray, SurfacePoints]:
    """First hits of camera rays through (row, col), in pixels with integers at the corners of pixels.

    Returns (bool, whether each ray hits the mesh; the surface points of those that do).
    """
    return caster.first_hits(*scene.view.rays(rows, cols))


class PixelAreas:
    """Sub-pixel points spread over the area of each pixel: their rays are cast once and used for every source.

    Shading is that of the pixel's centre, which is where the true normal is given. Only visibility is averaged over the
    area, so that the edges of shadows are smooth while lit pixels obey ρ = F n exactly. With ``scene.area_pixels`` the
    shading is averaged over the area too, as in a real camera.
    """

    def __init__(
        self, scene: Scene, caster: RayCaster, row: np.ndarray, col: np.ndarray, centre: SurfacePoints
    ) -> None:
        across = caster.subpixels
        steps = (np.arange(across) + 0.5) / across
        down, right = (grid.ravel() for grid in np.meshgrid(steps, steps, indexing="ij"))
        hit, points = camera_hits(scene, caster, (row[:, None] + down).ravel(), (col[:, None] + right).ravel())
        on_object = scene.is_object[scene.mesh.material[points.face]]
        self.scene, self.caster, self.centre = scene, caster, centre
        owner = np.repeat(np.arange(len(row), dtype=np.int32), across**2)
        if not hit.all():
            owner = owner[hit]
        if not on_object.all():
            points, owner = points.take(on_object), owner[on_object]
        self.points, self.owner = points, owner
        self.count, self.share = len(row), 1.0 / across**2

    def facing(self, light: Light) -> np.ndarray:
        """(n,) light that would arrive if nothing blocked it."""
        if self.scene.area_pixels:
            shading = light.unoccluded(self.points.position, self.points.normal)
            return _sums_by_owner(self.owner, shading[None], self.count)[0] * self.share
        return light.unoccluded(self.centre.position, self.centre.normal)

    def means(self, values: np.ndarray) -> np.ndarray:
        """Means (n, K) over each pixel of ``values`` (m, K) at the sub-pixel points that see the object."""
        sums = _sums_by_owner(
            self.owner, np.concatenate([values.T, np.ones((1, len(values)), values.dtype)]), self.count
        )
        return np.asarray((sums[:-1] / np.maximum(sums[-1], 1)).T, dtype=np.float32)

    def direct(self, light: RayLight, samples: int, rng: np.random.Generator) -> np.ndarray:
        """(n,) light that arrives; a ``sampled`` source is sampled at ``samples`` points from each sub-pixel point."""
        total = np.zeros((2, self.count))
        lattice = fibonacci_lattice(samples)
        sampled = light.sampled
        shift = rng.random((len(self.points.uv), 2)) if sampled else None
        for point in lattice if sampled else lattice[:1]:
            square = None if shift is None else (point + shift) % 1.0
            total += _sums_by_owner(self.owner, self.caster.arriving(self.points, light, square), self.count)
        if self.scene.area_pixels:
            return total[1] * self.share / (samples if sampled else 1)
        lit = total[0] > 0
        return self.facing(light) * np.where(lit, total[1] / np.where(lit, total[0], 1.0), 1.0)


@numba.njit(cache=True)
def _sums_by_owner(owner, values, count):
    """Values (K, m) summed by owner (m,), numbered below ``count``; (K, count)."""
    out = np.zeros((values.shape[0], count))
    for i in range(len(owner)):
        for k in range(values.shape[0]):
            out[k, owner[i]] += values[k, i]
    return out


def direct_light(areas: PixelAreas, light: Light, samples: int, rng: np.random.Generator) -> np.ndarray:
    """(n,) direct light of any source but an `EnvironmentLight`, whose light comes with the gather."""
    return areas.direct(light, samples, rng) if isinstance(light, RayLight) else areas.facing(light)
