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
from pathlib import Path

import numpy as np
from record import record

from configs.load import load_config
from recover.methods import METHODS
from render.dataset import read_observation, read_truth
from render.run import render_config

SCENES = {
    "natural": ("mozart_5lights", []),
    "gels": ("mozart_5gels", []),
    "natural, albedo 0.8": ("mozart_5lights", ["surface.reflectance=0.8"]),
    "gels, noise 1e-3": ("mozart_5gels", ["camera.read_noise=1e-3"]),
}
HOLLOW = {
    "bowl, gels, albedo 0.8": "shape={kind: bowl, opening: 50}",
    "V-groove 110°, gels, albedo 0.8": "shape={kind: v_groove, angle: 110}",
}


def measure(name: str, config: str, changes: list[str], shape: str | None) -> None:
    changes = [*changes, "render.transport=[full]", "render.target_rms=2e-4"]
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
        cosine = np.sum(found.normals[given] * truth.normals[given], axis=-1)
        median = float(np.degrees(np.median(np.arccos(np.clip(cosine, -1, 1))))) if given.any() else np.nan
        told = found.diagnostics.get("interreflection", {})
        albedo = ", albedo " + " ".join(f"{a:.2f}" for a in told["albedo"]) if told else ""
        stated = float(np.nanmedian(found.uncertainty_deg)) if given.any() else np.nan
        note = f"{found.status}, {given.sum() / truth.mask.sum():.0%} of pixels, states {stated:.2g}°, {seconds:.1f} s"
        record(f"{name}: {method}, median error", median, "deg", note=note + albedo)


if __name__ == "__main__":
    if len(sys.argv) > 2 or (len(sys.argv) == 2 and not Path(sys.argv[1]).is_file()):
        sys.exit(__doc__)
    for label, (config, changes) in SCENES.items():
        measure(f"bust, {label}", config, changes, None)
        if len(sys.argv) == 2:
            measure(f"real Mozart, {label}", config, changes, sys.argv[1])
    for label, hollow in HOLLOW.items():
        measure(label, "mozart_5gels", [hollow, "surface.reflectance=0.8"], None)
