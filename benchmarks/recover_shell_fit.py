"""How long the robust fit of the ellipsoid takes, with all its statistics, and how low its median of r² is.

Usage: python benchmarks/recover_shell_fit.py. Prints tab-separated lines: pixels, seconds (best of 4), median of r²,
that of the true ellipsoid, relative error of C. Colours: a sphere under five lights, 0.1 % noise, single precision.
The first call on a machine compiles two kernels (about 5 s), which are then kept.
"""

import time

import numpy as np

from huesphere.recover.ellipsoid.fit import least_median_of_squares, residuals, reweighted


def colours(count: int, noise: float = 1e-3, seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """(colours (N, 3) float32, true C (3, 3))."""
    rng = np.random.default_rng(seed)
    radius, turn = np.sqrt(rng.uniform(0, 1, count)), rng.uniform(0, 2 * np.pi, count)
    n = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1 - radius**2)], axis=-1)
    tilt, around = np.radians(rng.uniform(10, 45, 5)), 2 * np.pi * (np.arange(5) + rng.uniform(0, 0.6, 5)) / 5
    A = np.stack([np.sin(tilt) * np.cos(around), np.sin(tilt) * np.sin(around), np.cos(tilt)], axis=-1)
    B = rng.uniform(0.1, 1, (5, 3))
    rgb = np.maximum(n @ A.T, 0) @ B
    F = B.T @ A / rgb.max()
    rgb = rgb / rgb.max() + noise * rng.standard_normal(rgb.shape)
    return rgb.astype(np.float32), np.linalg.inv(F @ F.T)


def main() -> None:
    print("pixels", "seconds", "median r2", "of the true C", "error of C", sep="\t")
    for count in (10_000, 100_000, 1_000_000, 4_000_000):
        rgb, C_true = colours(count)
        best = np.inf
        for _ in range(4):  # the first may compile
            started = time.perf_counter()
            C = least_median_of_squares(rgb)
            reweighted(rgb, C)
            best = min(best, time.perf_counter() - started)
        ours, true = (float(np.median(residuals(rgb, c) ** 2)) for c in (C, C_true))
        error = np.linalg.norm(C - C_true) / np.linalg.norm(C_true)
        print(count, f"{best:.3f}", f"{ours:.4g}", f"{true:.4g}", f"{error:.2g}", sep="\t", flush=True)


if __name__ == "__main__":
    main()
