"""Depth over gaps: seconds and error of each model on a relief within an oval, a tenth of it gaps, slope noise 0.02.

python benchmarks/recover_depth.py [side …] [--record]
"""

import sys
import time

import numpy as np
from record import record

from huesphere.recover.depth.integration import MODELS, depth_from_slopes


def relief(size: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(z, p, q, known, mask): 44 % of the square, gaps of discs and bands."""
    rng = np.random.default_rng(seed)
    row, column = np.mgrid[:size, :size]
    x, y, k = (column - size / 2) / size, (size / 2 - row) / size, 2 * np.pi
    mask = (x / 0.37) ** 2 + (y / 0.38) ** 2 < 1

    def depth(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        dome = 0.25 * np.sqrt(0.3 - np.minimum(x * x + y * y, 0.29))
        return size * (dome + 0.03 * np.cos(3 * k * x) * np.cos(2 * k * y) + 0.01 * np.sin(7 * k * x + 2 * k * y))

    h = 1e-5
    p = (depth(x + h, y) - depth(x - h, y)) / (2 * h * size) + 0.02 * rng.standard_normal(mask.shape)
    q = (depth(x, y + h) - depth(x, y - h)) / (2 * h * size) + 0.02 * rng.standard_normal(mask.shape)
    gap = np.zeros_like(mask)
    while (gap & mask).sum() < 0.1 * mask.sum():
        at_x, at_y = rng.uniform(-0.35, 0.35, 2)
        gap |= (x - at_x) ** 2 + (y - at_y) ** 2 < rng.uniform(0.01, 0.05) ** 2
        if rng.random() < 0.05:
            gap |= np.abs(0.8 * x + 0.6 * y - at_x) < 0.006
    return depth(x, y), p, q, mask & ~gap, mask


def main(sides: list[int], keep: bool) -> None:
    for size in sides:
        z, p, q, known, mask = relief(size)
        for model in MODELS:
            if size > 300 and model in ("harris", "robust"):
                continue  # the reference factorises everything; robust solves forty times
            depth_from_slopes(p[:64, :64], q[:64, :64], mask[:64, :64], mask[:64, :64])  # imports aside
            wall, cpu = time.perf_counter(), time.process_time()
            found = depth_from_slopes(p, q, known, mask, model=model)
            wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
            error = (found - z) - np.mean((found - z)[known])
            rms = [float(np.sqrt(np.mean(error[where] ** 2))) for where in (known, mask & ~known)]
            note = f"cpu {cpu:.2f} s; RMS {rms[0]:.3f} px known, {rms[1]:.3f} px in gaps; {int(mask.sum())} pixels"
            if keep:
                record(f"depth, {size}², {model}", wall, "s", note=note)
            else:
                print(f"{size} {model}: {wall:.2f} s, {note}")


if __name__ == "__main__":
    main([int(a) for a in sys.argv[1:] if a.isdigit()] or [256, 1024], "--record" in sys.argv)
