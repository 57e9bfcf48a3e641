"""Make the golden data of the recovery methods: small pictures, and what every method says of each.

Usage: python tests/golden/make.py [--pictures] [--answers [--only PICTURE/METHOD]…]. ``--pictures`` renders
``pictures.npz`` anew, ``--answers`` runs every method on the pictures that are there and writes ``answers.npz``; with
``--only`` the other answers stay. Answers are made on purpose only: when a change is meant to alter results, the commit
that makes them anew says which and why.

``pictures.npz`` holds each picture's colours (float32), mask and camera as they were rendered; ``answers.npz`` holds,
for each picture and method, the status and the normals at up to NORMALS evenly spread pixels of those that have one.
Rounds of interreflection removal may not settle; of the methods that take them, ``spread`` tells by how many degrees
(median) the normals turn in copies of the picture that differ by rounding: no answer is known better than that.
"""

import argparse
import json
import tempfile
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from huesphere.configs.load import load_config
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.methods import calling
from huesphere.recover.methods.table import METHODS
from huesphere.recover.run import recover_one
from huesphere.render.dataset import CameraInfo, KnownLights, Observation, read_observation
from huesphere.render.run import render_config

FOLDER = Path(__file__).parent
NORMALS = 240  # kept of an estimate
COPIES, ROUNDING = 4, 1e-7  # of a picture, and the relative difference of their samples
IN_ROUNDS = ("auto", "unbounce")  # methods that remove interreflection
SMALL = "camera.resolution=[72, 72]"
BOWL = "shape={kind: bowl, opening: 80}"
GROOVE = "shape={kind: v_groove, angle: 100, turn: 20}"
NEAR = (
    "lights=[{kind: point, position: [1.5, 0.6, 3], spectrum: {gaussian: {centre: 610, sigma: 25}}, intensity: 10},"
    "{kind: point, position: [-1.5, 0.6, 3], spectrum: {gaussian: {centre: 540, sigma: 25}}, intensity: 10},"
    "{kind: point, position: [0, -1.6, 3], spectrum: {gaussian: {centre: 460, sigma: 20}}, intensity: 10}]"
)
TWO = (
    "lights=[{direction: [0.5, 0.2, 1], spectrum: {gaussian: {centre: 610, sigma: 25}}},"
    "{direction: [-0.5, 0.2, 1], spectrum: {gaussian: {centre: 540, sigma: 25}}}]"
)
SKY = "lights=[{kind: sky}, {direction: [1, 0, 1], spectrum: A}, {direction: [-1, 0.5, 1], spectrum: FL2}]"
NOISE = "camera.read_noise=0.001"
PICTURES: dict[str, tuple[str, str, tuple[str, ...]]] = {  # name: config, transport, overrides
    "linear": ("mozart_5gels.yaml", "linear", (SMALL,)),
    "natural": ("mozart_5lights.yaml", "linear", (SMALL,)),
    "noisy": ("mozart_5gels.yaml", "linear", (SMALL, "camera.read_noise=0.003")),
    "direct": ("mozart_5gels.yaml", "direct", (SMALL,)),
    "full": ("mozart_5gels.yaml", "full", (SMALL, "surface.reflectance=0.8")),
    "full-noisy": ("mozart_5gels.yaml", "full", (SMALL, NOISE)),
    "perspective": ("mozart_5gels.yaml", "direct", (SMALL, "camera.projection=perspective", "camera.field_of_view=40")),
    "near": ("mozart_5gels.yaml", "direct", (SMALL, NEAR, "recover.lights=told")),
    "wide": ("mozart_wide_gels.yaml", "direct", (SMALL, NOISE)),
    "hollow": ("mozart_5gels.yaml", "full", (SMALL, BOWL, "surface.reflectance=0.7")),
    "groove": ("mozart_5gels.yaml", "full", (SMALL, GROOVE, NOISE)),
    "saturated": ("mozart_5gels.yaml", "direct", (SMALL, "camera.exposure=0.005", "camera.bits=12")),
    "dome": ("mozart_5gels.yaml", "direct", (SMALL, SKY)),
    "two-lights": ("mozart_5gels.yaml", "linear", (SMALL, TWO)),
}


def rendered(name: str) -> Observation:
    """The picture of that name, rendered anew."""
    config, transport, overrides = PICTURES[name]
    with tempfile.TemporaryDirectory() as folder:
        asked = [*overrides, f"render.transport=[{transport}]"]
        scene = load_config(config, overrides=asked)
        render_config(scene, Path(folder), progress=lambda share, what: None, log=lambda line: None)
        return read_observation(next(Path(folder).rglob("observation.exr")))


def write_pictures(path: Path, pictures: dict[str, Observation]) -> None:
    arrays: dict[str, Any] = {}
    for name, picture in pictures.items():
        lights = (
            None if picture.lights is None else {k: np.asarray(v).tolist() for k, v in picture.lights._asdict().items()}
        )
        arrays[f"{name}/rgb"] = picture.rgb
        arrays[f"{name}/mask"] = picture.mask
        arrays[f"{name}/header"] = json.dumps({"camera": asdict(picture.camera), "lights": lights})
    np.savez_compressed(path, **arrays)


def read_pictures(path: Path = FOLDER / "pictures.npz") -> dict[str, Observation]:
    pictures = {}
    with np.load(path) as arrays:
        for name in PICTURES:
            header = json.loads(str(arrays[f"{name}/header"]))
            lights = None
            if header["lights"] is not None:
                lights = KnownLights(*(np.array(v, float).reshape(-1, 3) for v in header["lights"].values()))
            camera = CameraInfo(**header["camera"])
            pictures[name] = Observation(arrays[f"{name}/rgb"], arrays[f"{name}/mask"], camera, lights)
    return pictures


def kept_of(estimate: Estimate) -> tuple[np.ndarray, np.ndarray]:
    """(flat pixel numbers (K,), their normals (K, 3)) of an estimate: an even choice of the pixels that have one."""
    pixels = np.flatnonzero(estimate.valid)
    pixels = pixels[np.linspace(0, len(pixels) - 1, min(NORMALS, len(pixels))).round().astype(int)]
    return pixels.astype(np.int32), estimate.normals.reshape(-1, 3)[pixels]


def spread_deg(picture: Observation, method: str, estimate: Estimate) -> float:
    """The largest median turn, degrees, of the normals that ``estimate`` has, over copies that differ by rounding."""
    most = 0.0
    for seed in range(COPIES):
        rounding = 1 + ROUNDING * np.random.default_rng(seed).standard_normal(picture.rgb.shape)
        copy = recover_one(replace(picture, rgb=(picture.rgb * rounding).astype(np.float32)), method)
        both = estimate.valid & copy.valid
        one, other = estimate.normals[both].astype(float), copy.normals[both].astype(float)
        turn = np.arctan2(np.linalg.norm(np.cross(one, other), axis=1), (one * other).sum(axis=1))
        most = max(most, float(np.degrees(np.median(turn)))) if both.any() else most
    return most


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pictures", action="store_true")
    parser.add_argument("--answers", action="store_true")
    parser.add_argument("--only", action="append", metavar="PICTURE/METHOD")
    asked = parser.parse_args()
    if asked.pictures:
        write_pictures(FOLDER / "pictures.npz", {name: rendered(name) for name in PICTURES})
    if asked.answers:
        # the method's own status, before the verdict
        calling._judged_by = lambda function, observation, otherwise: function(observation)
        answers: dict[str, Any] = {}
        if asked.only:
            with np.load(FOLDER / "answers.npz") as kept:
                answers = dict(kept)
        for name, picture in read_pictures().items():
            for method in METHODS:
                if asked.only and f"{name}/{method}" not in asked.only:
                    continue
                estimate = recover_one(picture, method)
                answers[f"{name}/{method}/status"] = estimate.status
                answers[f"{name}/{method}/valid"] = int(estimate.valid.sum())
                answers[f"{name}/{method}/pixels"], answers[f"{name}/{method}/normals"] = kept_of(estimate)
                in_rounds = method in IN_ROUNDS and PICTURES[name][1] == "full"
                answers[f"{name}/{method}/spread"] = spread_deg(picture, method, estimate) if in_rounds else 0.0
                print(name, method, estimate.status, int(estimate.valid.sum()), f"{estimate.seconds:.2f}", flush=True)
        np.savez_compressed(FOLDER / "answers.npz", **answers)


if __name__ == "__main__":
    main()
