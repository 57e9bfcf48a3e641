"""Method `auto`, with the same settings, on random scenes: shapes, lights, albedo, noise and light between the parts.

Usage: python benchmarks/recover_random_scenes.py [--scenes 36] [--first 0] [--size 128] [--write]. Prints a table with
a row for each scene, failures included; ``--write`` puts it into docs/studies/random_scenes.md. Shapes are those of
recover_shells.py; cast shadows are marched, and light between the parts is that of the relief engine, all bounces.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from recover_shells import MOZART, SHAPES, WORST_CONDITION, Surface, cast_shadows, lights_tilted, random_surface

from huesphere.eval.metrics import angular_error_deg
from huesphere.recover.run import recover_one
from huesphere.render.dataset import CameraInfo, Observation
from huesphere.render.relief import apply_kernel, build_kernel
from huesphere.scenes.surfaces import depth_normals

PAGE = Path(__file__).parents[1] / "docs" / "studies" / "random_scenes.md"
FIRST_SEED = 77_000
FULL_EVERY, NOISY_EVERY = 2, 3  # every second scene lights itself, every third has noise
NOISE = 1e-3  # of full scale
LEAST_LIT = 0.45  # share of the object that sees every light
GOOD = 3.0  # degrees, median over all pixels
BOUNCES = 40


@dataclass(frozen=True)
class Scene:
    """A picture with what is true of it."""

    surface: Surface
    observation: Observation
    lights: np.ndarray  # (L, 3) directions
    condition: float  # of F
    albedo: np.ndarray | None  # (3,) of the channels; None: direct light alone
    noise: float
    lit: float  # share of the object that sees every light
    indirect: float  # share of the picture's light


def random_scene(number: int, size: int) -> Scene:
    """Scene ``number``: three to six lights that at least LEAST_LIT of the object sees, cond F ≤ WORST_CONDITION."""
    rng = np.random.default_rng(FIRST_SEED + number)
    shapes = SHAPES if MOZART.is_file() else SHAPES[:-1]
    surface = random_surface(shapes[number % len(shapes)], rng, size)
    mask = surface.mask
    while True:
        directions, colours = _random_lights(rng)
        F = colours.T @ directions
        if np.linalg.cond(F) > WORST_CONDITION:
            continue
        seen = surface.normals @ directions.T > 0
        if seen[mask].all(axis=-1).mean() < LEAST_LIT:
            continue
        seen &= ~cast_shadows(surface.depth, mask, directions)
        lit = float(seen[mask].all(axis=-1).mean())
        if lit >= LEAST_LIT:
            break
    direct = (np.where(seen, surface.normals @ directions.T, 0.0) @ colours)[mask]
    albedo = rng.uniform(0.2, 0.9, 3) if number % FULL_EVERY else None
    whole = direct if albedo is None else _with_bounces(surface, direct, albedo)
    noise = NOISE if number % NOISY_EVERY == 2 else 0.0
    rgb = np.zeros((*mask.shape, 3))
    rgb[mask] = whole / whole.max() + noise * rng.standard_normal(whole.shape)
    observation = Observation(rgb.astype(np.float32), mask, CameraInfo(read_noise=noise))
    indirect = float(1 - direct.sum() / whole.sum())
    return Scene(surface, observation, directions, float(np.linalg.cond(F)), albedo, noise, lit, indirect)


def _random_lights(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """(directions (L, 3), colours (L, 3))."""
    count = int(rng.integers(3, 7))
    return lights_tilted(np.radians(rng.uniform(10, 60, count)), rng)


def _with_bounces(surface: Surface, direct: np.ndarray, albedo: np.ndarray) -> np.ndarray:
    """L = D + α K L of the object's pixels (P, 3)."""
    normals = np.where(surface.mask[..., None], depth_normals(surface.depth, surface.mask), [0.0, 0.0, 1.0])
    kernel = build_kernel(np.where(surface.mask, surface.depth, 0.0), surface.mask, normals, azimuths=48, seed=1)
    total = direct.copy()
    for _ in range(BOUNCES):
        total = direct + albedo * apply_kernel(kernel, total)
    return total


def row_of(number: int, scene: Scene) -> tuple[list[str], str, float]:
    """(cells of the table, status, median error in degrees over all pixels of the object)."""
    started = time.process_time()
    found = recover_one(scene.observation, "auto")
    seconds = time.process_time() - started
    given = found.valid & scene.observation.mask
    error = angular_error_deg(found.normals[given], scene.surface.normals[given])
    median, mean = (float(one(error)) if given.any() else float("nan") for one in (np.median, np.mean))
    told = found.diagnostics.get("lights", {}).get("found", [])
    off = [np.degrees(np.arccos(np.clip(scene.lights @ light["direction"], -1, 1).max())) for light in told]
    albedo = found.diagnostics.get("interreflection", {}).get("albedo")

    def shown(values: np.ndarray | None) -> str:
        return "–" if values is None else " ".join(f"{value:.2f}" for value in values)

    cells = [
        str(number),
        scene.surface.name,
        f"{len(scene.lights)}",
        f"{scene.condition:.0f}",
        f"{scene.lit:.0%}",
        f"{scene.indirect:.1%}",
        f"{scene.noise:g}",
        found.status,
        f"{median:.2f} / {mean:.2f}",
        f"{float(np.nanmedian(found.uncertainty_deg)) if given.any() else float('nan'):.2f}",
        f"{given.sum() / scene.observation.mask.sum():.0%}",
        f"{len(told)}" + (f" ({np.median(off):.1f}°)" if off else ""),
        f"{shown(albedo)} ({shown(scene.albedo)})",
        f"{seconds:.0f}",
    ]
    return cells, found.status, median


def table(numbers: range, size: int, show: Callable[[str], None]) -> str:
    """The page, each row of it shown as it comes."""
    names = "scene, shape, lights, cond F, see all lights, indirect, noise, status, median / mean °, stated °, given"
    names += ", found (off), albedo (true), processor s"
    lines = ["| " + " | ".join(names.split(", ")) + " |", "| " + " | ".join("---" for _ in names.split(", ")) + " |"]
    good = said = 0
    for number in numbers:
        cells, status, median = row_of(number, random_scene(number, size))
        good += status == "ok" and median <= GOOD
        said += status != "ok"
        lines.append("| " + " | ".join(cells) + " |")
        show(lines[-1])
    head = f"""# Method `auto` on random scenes

{len(numbers)} scenes of {size}² pixels, the same settings for all: random shapes (spheres, ellipsoids, reliefs, busts,
the scan stretched), three to six lights 10–60° off axis in random colours with cast shadows. Every second scene has
interreflection, with random albedos (a convex shape has none all the same), and every third has noise of {NOISE:g} of
full scale. Made by `benchmarks/recover_random_scenes.py`.

Status ok and a median error of at most {GOOD:g}° over all pixels: {good} of {len(numbers)}.
Scenes with another status: {said}. Scenes with status ok and a larger error: {len(numbers) - good - said}.

Columns: the share of the object that sees all lights; the share of the light that is indirect; the error that the
method states (median); the share of the object that gets a normal; how many lights were found, and in brackets the
median angle between them and the nearest true lights (a light that every pixel sees can be found only when all others
are); the albedo of each channel that was found, and the true one; seconds of processor time.

"""
    return head + "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=36)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--write", action="store_true", help=f"write {PAGE.name}")
    asked = parser.parse_args()
    page = table(range(asked.first, asked.first + asked.scenes), asked.size, lambda line: print(line, flush=True))
    if asked.write:
        PAGE.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
