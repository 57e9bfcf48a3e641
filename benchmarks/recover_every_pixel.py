"""Error over all pixels of the object, lights unknown, from one picture: the rows of the research log.

Usage: python benchmarks/recover_every_pixel.py [--method auto] [--surface scan|bust] [--record]. Renders what it needs
into a temporary folder. ``scan`` is the Mozart scan beside the project; without it the rows of the bust are made.
"""

import argparse
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from record import record

from huesphere.configs.load import load_config
from huesphere.eval.metrics import angular_error_deg
from huesphere.recover.run import recover_one
from huesphere.render.dataset import Observation, read_observation, read_truth
from huesphere.render.run import render_config

MOZART = Path(__file__).parents[2] / "shared" / "data" / "mozart" / "mozart_depth.npz"
WHITE = ["surface.reflectance=0.8"]
ROWS = (  # name, config, overrides, transport, noise of full scale, bits
    ("natural, direct", "mozart_5lights", [], "direct", 0.0, None),
    ("gels, direct", "mozart_5gels", [], "direct", 0.0, None),
    ("gels, full", "mozart_5gels", [], "full", 0.0, None),
    ("natural, full", "mozart_5lights", [], "full", 0.0, None),
    ("natural, albedo 0.8, full", "mozart_5lights", WHITE, "full", 0.0, None),
    ("natural, direct, noise 1e-3", "mozart_5lights", [], "direct", 1e-3, None),
    ("natural, full, noise 1e-3", "mozart_5lights", [], "full", 1e-3, None),
    ("gels, full, 12 bits, noise 1e-3", "mozart_5gels", [], "full", 1e-3, 12),
    ("wide gels, direct", "mozart_wide_gels", [], "direct", 0.0, None),
    ("wide natural, direct", "mozart_wide", [], "direct", 0.0, None),
    ("wide natural, full", "mozart_wide", [], "full", 0.0, None),
)


def observed(observation: Observation, noise: float, bits: int | None) -> Observation:
    """The picture as a camera with this noise and these bits would have it."""
    if not noise:
        return observation
    rgb = observation.rgb + noise * np.random.default_rng(0).standard_normal(observation.rgb.shape)
    if bits:
        rgb = np.round(np.clip(rgb, 0, 1) * (2**bits - 1)) / (2**bits - 1)
    camera = replace(observation.camera, read_noise=noise, bits=bits, known=True)
    return replace(observation, rgb=np.where(observation.mask[..., None], rgb, 0.0).astype(np.float32), camera=camera)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--method", default="auto")
    parser.add_argument("--surface", choices=("scan", "bust"), default="scan" if MOZART.is_file() else "bust")
    parser.add_argument("--record", action="store_true", help="append to results.tsv")
    asked = parser.parse_args()
    shape = str(MOZART) if asked.surface == "scan" else None
    with tempfile.TemporaryDirectory() as folder:
        for name, config, overrides, transport, noise, bits in ROWS:
            run = Path(folder) / f"{config}{len(overrides)}"
            made = run / config / transport
            if not made.exists():
                wanted = [*overrides, "render.transport=[direct, full]"]
                scene = load_config(f"{config}.yaml", overrides=wanted, shape=shape)
                render_config(scene, run, progress=lambda share, what: None, log=lambda line: None)
            truth = read_truth(made / "truth.exr")
            started = time.process_time()
            estimate = recover_one(observed(read_observation(made / "observation.exr"), noise, bits), asked.method)
            seconds = time.process_time() - started
            where = estimate.valid & truth.mask
            error = angular_error_deg(estimate.normals[where], truth.normals[where])
            note = f"mean {error.mean():.3f}; {where.sum() / truth.mask.sum():.1%} of the object; {estimate.status}"
            case = f"{asked.method}, all pixels, {asked.surface}, {name}: median"
            if asked.record:
                record(case, float(np.median(error)), "deg", note=f"{note}; processor {seconds:.0f} s")
            else:
                print(case, f"{np.median(error):.3f}", note, f"{seconds:.0f} s", sep="\t", flush=True)


if __name__ == "__main__":
    main()
