"""Time, memory and accuracy of `recover` on large photographs of a matte relief: a JPEG, as a camera would write it.

python benchmarks/large_pictures.py FOLDER [--megapixels 1 12] [--method weak-integrability auto] [--record]

The command runs as a process of its own, so that its peak memory is its own. The truth is that of the formula.
"""

import argparse
import re
import resource
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from PIL import Image
from record import record

from huesphere.eval.metrics import angular_error_deg
from huesphere.recover.io.estimate import read_estimate
from huesphere.scenes.encoding import encode_srgb

TOWARD = np.array([[0.5, 0.0, 1.0], [-0.25, 0.43, 1.0], [-0.25, -0.43, 1.0]])
COLOURS = np.array([[0.6, 0.15, 0.1], [0.15, 0.6, 0.15], [0.1, 0.15, 0.6]])
NOISE = 0.003  # of full scale
WAVES = 40
RECOVER = Path(sys.executable).with_name("recover")


def relief(height: int, width: int, seed: int = 0) -> np.ndarray:
    """Unit normals (H, W, 3) of a sum of waves, from the size of the picture down to a sixtieth of it."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width].astype(np.float32) / max(height, width)
    p, q = np.zeros((2, height, width), np.float32)
    for _ in range(WAVES):
        frequency, angle, phase = 2 ** rng.uniform(0, 6), rng.uniform(0, 2 * np.pi), rng.uniform(0, 2 * np.pi)
        wave = np.cos(np.pi * frequency * (x * np.cos(angle) - y * np.sin(angle)) + phase) * 0.12 / frequency**0.3
        p += np.cos(angle) * wave
        q += np.sin(angle) * wave
    n = np.dstack([-p, -q, np.ones_like(p)])
    return n / np.linalg.norm(n, axis=-1, keepdims=True)


def photograph(normals: np.ndarray, path: Path) -> None:
    """Write a JPEG of the matte surface under three coloured lights."""
    light = np.maximum(normals @ (TOWARD / np.linalg.norm(TOWARD, axis=1, keepdims=True)).T, 0) @ COLOURS
    light = 0.9 * light / light.max() + NOISE * np.random.default_rng(1).standard_normal(light.shape)
    Image.fromarray(np.round(255 * encode_srgb(np.clip(light, 0, 1))).astype(np.uint8)).save(path, quality=95)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--megapixels", type=float, nargs="+", default=[1, 12])
    parser.add_argument("--method", nargs="+", default=["weak-integrability", "auto"])
    parser.add_argument("--record", action="store_true", help="append the figures to results.tsv")
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    for size in asked.megapixels:
        height, width = (int(side * np.sqrt(size / 12)) for side in (3000, 4000))
        normals = relief(height, width)
        picture = asked.folder / f"relief-{size:g}.jpg"
        photograph(normals, picture)
        for method in asked.method:
            measure(picture, normals, size, method, recorded=asked.record)


def measure(picture: Path, normals: np.ndarray, size: float, method: str, *, recorded: bool) -> None:
    """Run the command once; print seconds, peak memory and errors."""
    out = picture.with_name(f"{picture.stem}-{method}")
    started = time.perf_counter()
    done = subprocess.run(
        [RECOVER, picture, "--method", method, "--out", out, "--overwrite"], capture_output=True, text=True, check=True
    )
    seconds = time.perf_counter() - started
    memory = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e6  # of the largest so far
    print(re.sub(r"^", "    ", done.stdout, flags=re.MULTILINE))
    estimate, _ = read_estimate(out / "estimates", method)
    given = estimate.valid
    error = angular_error_deg(estimate.normals[given].astype(float), normals[given])
    note = (
        f"{estimate.status}; median {np.median(error):.2f}, mean {error.mean():.2f} deg, stated "
        f"{np.nanmedian(estimate.uncertainty_deg[given]):.2f}; {given.mean():.0%} of the pixels; peak {memory:.2f} GB"
    )
    print(f"{size:g} MP, {method}: {seconds:.1f} s, {note}", flush=True)
    if recorded:
        record(f"large pictures, {size:g} MP JPEG of a matte relief, {method}: wall", round(seconds, 1), "s", note=note)


if __name__ == "__main__":
    main()
