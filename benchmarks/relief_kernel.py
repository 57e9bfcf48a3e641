"""The gather operator of a relief by profiles (`render.relief`) against rays on the same mesh: error and time.

python benchmarks/relief_kernel.py mozart_depth.npz [--reference]

Five natural lights on skin, full transport, every bounce from the same stored operator. Both start from the same
direct light at the pixels, so they differ in the operator alone. Error: of the colour, the difference of two seeds over
√2, RMS over pixels and channels in units of the channel's mean. Time: building the operator and all bounces, the least
of REPEATS, the two methods in turn. On a machine that is not quiet compare processor time, summed over cores.
``--reference`` compares converged pictures instead: 4 × 8192 rays from every pixel, minutes.
"""

import sys
import time
from collections.abc import Callable

import numpy as np
from record import record

from huesphere.configs.load import load_config
from huesphere.render.backend import choose_backend, load_mitsuba
from huesphere.render.gather import apply_operator, concatenate
from huesphere.render.raycast import CHUNK_RAYS, RayCaster, ray_caster
from huesphere.render.relief import apply_kernel, build_kernel
from huesphere.render.spectral import colour_of, component_colours, components_by_order
from huesphere.render.transport import OFFSET_PIXELS, trace
from huesphere.scenes.build import Scene, build_scene
from huesphere.scenes.quadrature import fibonacci_lattice

BOUNCES = 5
REPEATS = 3
AZIMUTHS = (8, 12, 16, 24, 32, 48, 64, 96, 128)
RAYS = (256, 512, 1024, 4096, 16384)
TARGETS = (1e-3, 1e-4)

Operator = Callable[[np.ndarray], np.ndarray]


def by_profiles(scene: Scene, azimuths: int, seed: int) -> Operator:
    shape = scene.pixel_vertex.shape
    mask = scene.pixel_vertex >= 0
    depth, normals = np.zeros(shape), np.zeros((*shape, 3))
    depth[mask], normals[mask] = scene.mesh.vertices[:, 2], scene.mesh.normals
    kernel = build_kernel(depth, mask, normals, step=scene.view.pixel_size, azimuths=azimuths, seed=seed)
    return lambda values: apply_kernel(kernel, values)


def by_rays(scene: Scene, caster: RayCaster, rays: int, seed: int) -> Operator:
    points = caster.vertex_points(np.arange(len(scene.mesh.vertices)))
    count = len(points.uv)
    directions, shift = fibonacci_lattice(rays), np.random.default_rng(seed).random((count, 2), dtype=np.float32)
    size = max(1, CHUNK_RAYS // rays)
    parts = [slice(at, min(at + size, count)) for at in range(0, count, size)]
    hits = concatenate([caster.hemisphere_hits(points, part, directions, shift)[0] for part in parts])
    return lambda values: apply_operator(hits, scene.mesh, np.ones((1, values.shape[1])), values, rays)


def images(direct: np.ndarray, operator: Operator) -> np.ndarray:
    """(L, 1 + BOUNCES, n) from direct light (n, L)."""
    terms = [direct]
    for _ in range(BOUNCES):
        terms.append(operator(terms[-1]))
    return np.stack(terms).transpose(2, 0, 1)


def main(path: str, *, reference: bool) -> None:
    mi = load_mitsuba(choose_backend())
    scene = build_scene(load_config("mozart_5lights", overrides=[f"shape={{kind: depth_map, path: {path}}}"]))
    traced = trace(scene, mi, reach="direct", target_rms=1e-3, max_bounces=None, seed=0, progress=lambda *_: None)
    direct = np.ascontiguousarray(traced.images[0, :, 0].T)
    colours = component_colours(scene, components_by_order(scene.reflectances[0], BOUNCES))
    caster = ray_caster(mi, scene.mesh, OFFSET_PIXELS * scene.view.pixel_size)

    def colour(operator: Operator) -> np.ndarray:
        return colour_of(images(direct, operator), colours, traced.pixels.material)

    def run(make: Callable[[int], Operator]) -> tuple[float, float, float]:
        """(error, seconds, processor seconds)"""
        pictures, seconds, work = [], [], []
        for seed in range(REPEATS):
            started, busy = time.perf_counter(), time.process_time()
            pictures.append(colour(make(seed)))
            seconds.append(time.perf_counter() - started)
            work.append(time.process_time() - busy)
        return relative(pictures[0] - pictures[1], pictures[0]) / np.sqrt(2), min(seconds), min(work)

    colour(by_profiles(scene, 2, 0)), colour(by_rays(scene, caster, 16, 0))  # compile
    if reference:
        compare_converged(scene, caster, colour)
        return
    tables: dict[str, list[tuple[int, float, float, float]]] = {"azimuths": [], "rays": []}
    for number in range(max(len(AZIMUTHS), len(RAYS))):
        if number < len(AZIMUTHS):
            a = AZIMUTHS[number]
            tables["azimuths"].append((a, *run(lambda seed, a=a: by_profiles(scene, a, seed))))
        if number < len(RAYS):
            r = RAYS[number]
            tables["rays"].append((r, *run(lambda seed, r=r: by_rays(scene, caster, r, seed))))
    for unit, rows in tables.items():
        for count, error, seconds, work in rows:
            note = f"{seconds:.2f} s, processor {work:.2f} s"
            record(f"relief operator, {count} {unit}", error, "relative RMS", note=note)
        counts, errors, *times = np.array(rows).T
        rate = np.polyfit(np.log(counts), np.log(errors), 1)[0]
        record(f"relief operator, rate in {unit}", float(rate), "exponent")
        for target in TARGETS:
            wanted = np.exp(np.interp(-np.log(target), -np.log(errors), np.log(counts)))
            wall, work = (np.exp(np.interp(np.log(wanted), np.log(counts), np.log(column))) for column in times)
            note = f"{wanted:.0f} {unit}, processor {work:.2f} s"
            record(f"relief operator, time to {target:g} by {unit}", float(wall), "s", note=note)


def relative(difference: np.ndarray, picture: np.ndarray) -> float:
    return float(np.sqrt(np.mean((difference / picture.mean(axis=0)) ** 2)))


def compare_converged(scene: Scene, caster: RayCaster, colour: Callable[[Operator], np.ndarray]) -> None:
    profiles = colour(by_profiles(scene, 256, 0))
    casts = np.stack([colour(by_rays(scene, caster, 8192, seed)) for seed in range(4)])
    rays = casts.mean(axis=0)
    own = np.sqrt(np.mean(casts.var(axis=0, ddof=1) / len(casts) / rays.mean(axis=0) ** 2))
    bias = float(np.abs((profiles - rays).mean(axis=0) / rays.mean(axis=0)).max())
    record("relief operator, 256 azimuths against 32768 rays: mean", bias, "of the picture", note="largest channel")
    note = f"rays' own error {own:.1e}; median {np.median(np.abs(profiles / rays - 1)):.1e}"
    record(
        "relief operator, 256 azimuths against 32768 rays: RMS",
        relative(profiles - rays, rays),
        "relative RMS",
        note=note,
    )


if __name__ == "__main__":
    main(sys.argv[1], reference="--reference" in sys.argv)
