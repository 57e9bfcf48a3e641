"""Time to a given relative RMS colour error: `transport` against the stock spectral path tracer, in one run.

python benchmarks/render_speed.py mozart_depth.npz

Five natural lights on skin, full transport, 256². The stock renderer's error is the difference of two seeds over √2; it
is carried to the target by its 1/√N. Ours is the difference of two seeds over √2 at the target asked for, timed from
scene arrays to picture as the stock one is; both have run once before, so that no compilation is counted.
"""

import statistics
import sys
import time
from pathlib import Path

import numpy as np
from record import record
from scipy import ndimage

from huesphere.configs.load import load_config
from huesphere.render.backend import choose_backend, load_mitsuba
from huesphere.render.picture import assemble
from huesphere.render.reference import CHANNELS, build_reference_scene
from huesphere.render.transport import trace
from huesphere.scenes.build import build_scene

TARGETS = (1e-2, 1e-3, 1e-4)
STOCK_SAMPLES = 256  # enough that what a stock render costs beside its samples (a third of 64 of them) hardly counts


def relative_rms(a: np.ndarray, b: np.ndarray, mask: np.ndarray) -> float:
    """Error of one of two independent pictures, RMS over object pixels and channels, in units of the channel's mean."""
    difference = (a - b)[mask] / np.sqrt(2) / ((a + b)[mask].mean(axis=0) / 2)
    return float(np.sqrt(np.mean(difference**2)))


def stock(mi, scene, sampler: str, mask: np.ndarray) -> float:
    """Seconds that the stock renderer would take to a relative RMS error of 1."""
    world = build_reference_scene(mi, scene, sampler=sampler)
    integrator = mi.load_dict({"type": "path", "max_depth": -1, "rr_depth": 1000})

    def picture(seed: int) -> np.ndarray:
        return np.array(mi.render(world, integrator=integrator, spp=STOCK_SAMPLES, seed=seed))[..., : len(CHANNELS)]

    picture(0)
    times, pictures = [], []
    for seed in (1, 2, 3):
        started = time.perf_counter()
        pictures.append(picture(seed))
        times.append(time.perf_counter() - started)
    # Edges apart: antialiasing noise there is no fault of the estimator's.
    inner = ndimage.binary_erosion(mask, iterations=2)
    error = relative_rms(pictures[0], pictures[1], inner)
    record(
        f"stock path, {sampler}, {STOCK_SAMPLES} spp: error",
        error,
        "relative RMS",
        note=f"{statistics.median(times):.2f} s",
    )
    return statistics.median(times) * error**2


def ours(mi, scene, target: float, seed: int) -> tuple[float, np.ndarray, np.ndarray]:
    started = time.perf_counter()
    traced = trace(scene, mi, reach="full", target_rms=target, max_bounces=None, seed=seed, progress=lambda *_: None)
    picture = assemble(scene, traced, "full").colour
    return time.perf_counter() - started, picture, traced.mask()


def main(shape: str) -> None:
    scene = build_scene(load_config("mozart_5lights", shape=shape))
    mi = load_mitsuba(choose_backend())
    _, _, mask = ours(mi, scene, 1e-2, 0)
    found = {}
    for target in TARGETS:
        runs = [ours(mi, scene, target, seed) for seed in (1, 2, 3)]
        error = relative_rms(runs[0][1], runs[1][1], mask)
        seconds = statistics.median(r[0] for r in runs)
        found[target] = (seconds, error)
        record(f"transport, real Mozart 256², target {target:g}: time", seconds, "s", note=f"true error {error:.2e}")
    for sampler in ("independent", "ldsampler"):
        cost = stock(mi, scene, sampler, mask)
        for target, (seconds, error) in found.items():
            ratio = cost / error**2 / seconds
            record(
                f"transport against stock path ({sampler}) at {target:g}: speed ratio", ratio, "times", note="same run"
            )


if __name__ == "__main__":
    if len(sys.argv) != 2 or not Path(sys.argv[1]).is_file():
        sys.exit(__doc__)
    main(sys.argv[1])
