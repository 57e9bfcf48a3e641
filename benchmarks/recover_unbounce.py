"""What is gained by taking interreflection out, on rendered pictures of full light transport.

python benchmarks/recover_unbounce.py [mozart_depth.npz]

Median error in degrees over the pixels that the method gives, their share of the object, the error that it states, and
the albedos; beside it the same method without it.
"""

import contextlib
import io
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from record import record

from huesphere.configs.load import load_config
from huesphere.eval.metrics import angular_error_deg
from huesphere.recover.geometry.rotations import TWIN
from huesphere.recover.methods.table import METHODS
from huesphere.render.dataset import read_observation, read_truth
from huesphere.render.run import render_config

FINE = "render.target_rms=2e-4"  # hollows send themselves so much light that it would take minutes
SCENES = {
    "natural": ("mozart_5lights", [FINE]),
    "gels": ("mozart_5gels", [FINE]),
    "natural, albedo 0.8": ("mozart_5lights", [FINE, "surface.reflectance=0.8"]),
    "gels, noise 1e-3": ("mozart_5gels", [FINE, "camera.read_noise=1e-3"]),
}
LIGHTS = {"natural": "mozart_5lights", "gels": "mozart_5gels"}
SIDE, REACH = 256, 110  # pixels of a hollow relief, and of its unit


def dish(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(depth, mask) of a bowl that is no part of a sphere."""
    return 0.75 * (0.9 * u**2 + 1.2 * v**2 + 0.15 * u * v + 0.2 * u**3), u**2 / 1.1 + v**2 < 1


def groove(steep: float) -> Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """A V whose walls bulge and which bends: straight walls have two normals, which fix no ellipsoid."""

    def walls(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        across = u - 0.15 * np.sin(2 * v)
        depth = steep * np.hypot(across, 0.02) + 0.18 * v**2 - 0.15 * across**2 + 0.055 * np.sin(3 * v) * across
        return depth, np.maximum(np.abs(u), np.abs(v)) < 0.95

    return walls


HOLLOW = {"bowl, not round": dish, "V-groove, 96°": groove(0.9), "V-groove, 75°": groove(1.3)}
ROUND = "shape={kind: bowl, opening: 60}"


def relief(shape: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]], folder: str) -> str:
    """Path of the depth map of a hollow."""
    y, x = np.mgrid[:SIDE, :SIDE] - (SIDE - 1) / 2
    depth, mask = shape(x / REACH, -y / REACH)
    path = Path(folder) / "hollow.npz"
    np.savez(path, depth=np.where(mask, depth * REACH, 0.0).astype(np.float32), mask=mask)
    return str(path)


def measure(name: str, config: str, changes: list[str], shape: str | None) -> None:
    changes = [*changes, "render.transport=[full]"]
    made = load_config(config, overrides=changes, shape=shape)
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stderr(io.StringIO()):
        run = Path(folder)
        render_config(made, run, engine="auto", overwrite=False, progress=lambda *_: None, log=lambda _: None)
        item = run / made.name / "full"
        observation, truth = read_observation(item / "observation.exr"), read_truth(item / "truth.exr")
    for method in ("weak-integrability", "unbounce"):
        started = time.perf_counter()
        found = METHODS[method](observation)
        seconds = time.perf_counter() - started
        given = found.valid & truth.mask
        either = [angular_error_deg(n[given], truth.normals[given]) for n in (found.normals, found.normals @ TWIN)]
        median, twin = (float(np.median(errors)) if given.any() else np.nan for errors in either)
        told = found.diagnostics.get("interreflection", {})
        albedo = ", albedo " + " ".join(f"{a:.2f}" for a in told["albedo"]) if told else ""
        stated = float(np.nanmedian(found.uncertainty_deg)) if given.any() else np.nan
        note = f"{found.status}, {given.sum() / truth.mask.sum():.0%} of pixels, states {stated:.2g}°, {seconds:.1f} s"
        note += f", inside out {twin:.2g}°" if twin < median else ""
        record(f"{name}: {method}, median error", median, "deg", note=note + albedo)


def measure_hollows() -> None:
    plaster = ["surface.reflectance=0.8"]
    with tempfile.TemporaryDirectory() as folder:
        for lights, config in LIGHTS.items():
            measure(f"round bowl, {lights}, albedo 0.8", config, [ROUND, *plaster], None)
            for label, hollow in HOLLOW.items():
                measure(f"{label}, {lights}, albedo 0.8", config, plaster, relief(hollow, folder))


if __name__ == "__main__":
    if len(sys.argv) > 2 or (len(sys.argv) == 2 and not Path(sys.argv[1]).is_file()):
        sys.exit(__doc__)
    for label, (config, changes) in SCENES.items():
        measure(f"bust, {label}", config, changes, None)
        if len(sys.argv) == 2:
            measure(f"real Mozart, {label}", config, changes, sys.argv[1])
    measure_hollows()
