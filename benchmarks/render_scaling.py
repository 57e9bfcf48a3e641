"""How time and memory grow with the picture, what relighting costs, how fast commands start.

python benchmarks/render_scaling.py mozart_depth.npz
"""

import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from record import record

BIN = Path(sys.executable).parent


def seconds(*command: object) -> float:
    started = time.perf_counter()
    subprocess.run([str(c) for c in command], check=True, capture_output=True)
    return time.perf_counter() - started


def scaling(shape: str) -> None:
    """Of the whole command, and of the trace alone in a process that has warmed up: there no start-up hides growth."""
    sides = (128, 256, 512, 1024)
    whole = {}
    for side in sides:
        with tempfile.TemporaryDirectory() as folder:
            options = ["--set", f"camera.resolution=[{side},{side}]", "--transport", "full", "--out", folder]
            whole[side] = seconds(BIN / "render", "--config", "mozart_5lights", "--shape", shape, *options)
        record(f"render, real Mozart {side}², full, 1e-3", whole[side], "s", note="whole command")
    rate = np.log(whole[1024] / whole[128]) / np.log(64)
    record("time of the command against pixels, 128² to 1024²: exponent", float(rate), "")
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 2**20
    record("render, real Mozart 1024²: peak memory", peak, "GiB")

    from huesphere.configs.load import load_config
    from huesphere.render.backend import choose_backend, load_mitsuba
    from huesphere.render.picture import assemble
    from huesphere.render.transport import trace
    from huesphere.scenes.build import build_scene

    mi = load_mitsuba(choose_backend())
    times = {}
    for side in (64, *sides):
        config = load_config("mozart_5lights", shape=shape, overrides=[f"camera.resolution=[{side},{side}]"])
        scene = build_scene(config)
        started = time.perf_counter()
        traced = trace(scene, mi, reach="full", target_rms=1e-3, max_bounces=None, seed=0, progress=lambda *_: None)
        assemble(scene, traced, "full")
        times[side] = time.perf_counter() - started
        pixels = len(traced.pixels.row)
        record(
            f"trace, real Mozart {side}², full, 1e-3",
            times[side],
            "s",
            note=f"{times[side] / pixels * 1e6:.0f} µs a pixel",
        )
    rate = np.log(times[1024] / times[128]) / np.log(64)
    record("trace time against pixels, 128² to 1024²: exponent", float(rate), "")


def room() -> None:
    with tempfile.TemporaryDirectory() as folder:
        taken = seconds(BIN / "render", "--config", "room_coloured_walls", "--transport", "full", "--out", folder)
    record("render room_coloured_walls, 256², full, 1e-3", taken, "s", note="whole command")


def relighting() -> None:
    from huesphere.render import open_item, relight

    with tempfile.TemporaryDirectory() as folder:
        one = seconds(BIN / "render", "--config", "mozart_5lights", "--transport", "full", "--out", folder)
        started = time.perf_counter()
        item = open_item(Path(folder) / "mozart_5lights/full")
        for k in range(100):
            relight(
                item, [f"lights.0.intensity={k / 50}", f"surface.reflectance={0.2 + k / 200}", "lights.1.spectrum=D50"]
            )
        extra = time.perf_counter() - started
    record(
        "one render and 100 relightings, against one render",
        (one + extra) / one,
        "times",
        note=f"{one:.1f} + {extra:.1f} s",
    )


def starting() -> None:
    record("render --help", min(seconds(BIN / "render", "--help") for _ in range(5)), "s")
    with tempfile.TemporaryDirectory() as folder:
        options = ["--set", "camera.resolution=[64,64]", "--transport", "linear", "--out", folder]
        record("render sphere_quick, 64², linear", seconds(BIN / "render", "--config", "sphere_quick", *options), "s")


if __name__ == "__main__":
    if len(sys.argv) != 2 or not Path(sys.argv[1]).is_file():
        sys.exit(__doc__)
    starting()
    relighting()
    room()
    scaling(sys.argv[1])
