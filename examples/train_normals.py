"""A learned baseline: a small network of NumPy, trained on a sweep of this tool, tested on a shape it has not seen.

python examples/train_normals.py FOLDER [--shapes 16] [--size 64] [--transport full] [--steps 1500] [--predict RUN]

1. Renders ellipsoids and bowls under three coloured lights, and for the test the bust, once
   under the same lights and once under others.
2. Trains a network from colours to normals. Its input at a pixel are the colour there and the mean colours of the
   object in windows about it; it has two hidden layers.
3. Writes its normals of the test pictures as maps, and has ``evaluate --estimates`` score them beside the methods that
   know nothing of the lights.
4. With --predict RUN, writes its normals of the pictures of another run too, such as `pictures/` of a benchmark, as
   FOLDER/predicted/<config>/<transport>.npy, which `evaluate --submit FOLDER/predicted` scores.
"""

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.ndimage import uniform_filter

import huesphere as hs

LIGHTS = """
  - {direction: [0.5, 0.2, 1.0], spectrum: {gaussian: {centre: 610, sigma: 25}}}
  - {direction: [-0.5, 0.2, 1.0], spectrum: {gaussian: {centre: 540, sigma: 25}}}
  - {direction: [0.0, -0.5, 1.0], spectrum: {gaussian: {centre: 460, sigma: 20}}}
"""
OTHER_LIGHTS = """
  - {direction: [-0.1, 0.5, 1.0], spectrum: {gaussian: {centre: 610, sigma: 25}}}
  - {direction: [0.5, -0.3, 1.0], spectrum: {gaussian: {centre: 540, sigma: 25}}}
  - {direction: [-0.5, -0.2, 1.0], spectrum: {gaussian: {centre: 460, sigma: 20}}}
"""
WINDOWS = (3, 7, 15)  # pixels
PIXELS = 2048  # of a batch
METHODS = ("auto", "drew-kontsevich")


def render_all(folder: Path, shapes: int, camera: str, rng: np.random.Generator) -> tuple[Path, Path]:
    """Render the run to learn from and the run to be tested on; returns their paths. What is there is kept.

    ``camera``: the sections camera and render of the configs, as YAML.
    """

    def render(name: str, run: str, shape: str, lights: str, sweep: str = "") -> None:
        config = folder / f"{name}.yaml"
        config.write_text(f"shape: {shape}\nsurface: {{reflectance: 0.6}}\nlights:{lights}{camera}{sweep}")
        hs.render_scene(config, out=folder / run)

    folder.mkdir(parents=True, exist_ok=True)
    axes = json.dumps(rng.uniform([0.5, 0.5, 0.3], [1, 1, 1.2], (shapes - shapes // 4, 3)).round(3).tolist())
    openings = json.dumps(rng.uniform(45, 80, shapes // 4).round(2).tolist())
    render("ellipsoids", "train", "{kind: ellipsoid, detail: 48}", LIGHTS, f"sweep: {{shape.semi_axes: {axes}}}\n")
    render("bowls", "train", "{kind: bowl, detail: 48}", LIGHTS, f"sweep: {{shape.opening: {openings}}}\n")
    render("bust_same_lights", "test", "{kind: bust}", LIGHTS)
    render("bust_other_lights", "test", "{kind: bust}", OTHER_LIGHTS)
    return folder / "train", folder / "test"


def features(rgb: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Inputs of the network (n, 3 + 3 · windows) at the pixels of the object: its colour, and mean colours about it."""
    lit = np.where(mask[..., None], rgb, 0).astype(float)
    share = [np.maximum(uniform_filter(mask.astype(float), window), 1e-3)[..., None] for window in WINDOWS]
    means = [uniform_filter(lit, (window, window, 0)) / s for window, s in zip(WINDOWS, share, strict=True)]
    return np.concatenate([image[mask] for image in (lit, *(mean - lit for mean in means))], axis=1)


class Network:
    """Two hidden layers with tanh, trained by Adam (Kingma and Ba 2015) on the squared error of the normal."""

    def __init__(self, inputs: int, hidden: int, rng: np.random.Generator) -> None:
        sizes = [(inputs + 1, hidden), (hidden + 1, hidden), (hidden + 1, 3)]
        self.weights = [rng.normal(0, rows**-0.5, (rows, columns)) for rows, columns in sizes]
        self.moments = [(np.zeros_like(w), np.zeros_like(w)) for w in self.weights]
        self.middle, self.scale, self.steps = np.zeros(inputs), np.ones(inputs), 0

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Unit normals (n, 3)."""
        out = self._layers(x)[-1] @ self.weights[-1]
        return np.asarray(out / np.linalg.norm(out, axis=1, keepdims=True))

    def _layers(self, x: np.ndarray) -> list[np.ndarray]:
        """The input of each layer, with a column of ones."""
        ones = np.ones((len(x), 1))
        layers = [np.hstack([(x - self.middle) / self.scale, ones])]
        for weights in self.weights[:-1]:
            layers.append(np.hstack([np.tanh(layers[-1] @ weights), ones]))
        return layers

    def step(self, x: np.ndarray, normals: np.ndarray, rate: float) -> None:
        layers = self._layers(x)
        error = (layers[-1] @ self.weights[-1] - normals) / len(x)
        gradients = []
        for layer, weights in zip(layers[::-1], self.weights[::-1], strict=True):
            gradients.append(layer.T @ error)
            error = ((error @ weights.T) * (1 - layer**2))[:, :-1]
        self.steps += 1
        for weights, (mean, square), gradient in zip(self.weights, self.moments, gradients[::-1], strict=True):
            mean += 0.1 * (gradient - mean)
            square += 0.001 * (gradient**2 - square)
            step = mean / (1 - 0.9**self.steps) / (np.sqrt(square / (1 - 0.999**self.steps)) + 1e-8)
            weights -= rate * step


def batches(run: Path, steps: int, rng: np.random.Generator) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yields (features, normals) of PIXELS random pixels of a few pictures, all pictures once in an epoch."""
    samples = hs.RunSamples(run)
    kept = [(features(s["rgb"], s["mask"]), s["normals"][s["mask"]]) for s in samples]  # small enough for memory
    for _ in range(steps):
        chosen = [kept[n] for n in rng.choice(len(kept), min(4, len(kept)), replace=False)]
        x, normals = (np.concatenate(parts) for parts in zip(*chosen, strict=True))
        at = rng.integers(len(x), size=PIXELS)
        yield x[at], normals[at]


def train(run: Path, steps: int, rng: np.random.Generator) -> Network:
    """A network that learned from all items of ``run``; its learning rate falls along a cosine."""
    network = Network(3 + 3 * len(WINDOWS), 48, rng)
    for number, (x, normals) in enumerate(batches(run, steps, rng)):
        if number == 0:
            network.middle, network.scale = x.mean(axis=0), x.std(axis=0) + 1e-6
        network.step(x, normals, 0.01 * (0.5 + 0.5 * np.cos(np.pi * number / steps)))
    return network


def write_maps(network: Network, run: Path, folder: Path) -> None:
    """Write the network's normals of each item as <folder>/<config>/<transport>.npy, NaN off the object."""
    for item in hs.open_run(run):
        seen = item.observation()
        normals = np.full(seen.rgb.shape, np.nan, np.float32)
        normals[seen.mask] = network(features(seen.rgb, seen.mask))
        path = folder / f"{item.id}.npy"
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, normals)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--shapes", type=int, default=16, help="to learn from")
    parser.add_argument("--size", type=int, default=64, help="of the pictures, pixels")
    parser.add_argument("--transport", default="full", help="linear, direct, one-bounce or full")
    parser.add_argument("--steps", type=int, default=1500)
    parser.add_argument("--predict", type=Path, metavar="RUN", help="write the normals of this run's pictures too")
    arguments = parser.parse_args()
    camera = f"camera: {{resolution: [{arguments.size}, {arguments.size}], read_noise: 1.0e-3}}\n"
    camera += f"render: {{transport: [{arguments.transport}]}}\n"
    rng, began = np.random.default_rng(0), time.process_time()
    learn, test = render_all(arguments.folder, arguments.shapes, camera, rng)
    print(f"rendered: {time.process_time() - began:.0f} s of processor time", flush=True)
    network = train(learn, arguments.steps, rng)
    print(f"trained: {time.process_time() - began:.0f} s of processor time in all", flush=True)
    write_maps(network, test, arguments.folder / "maps" / "network")
    if arguments.predict:
        write_maps(network, arguments.predict, arguments.folder / "predicted")
        print(f"normals of {arguments.predict}: {arguments.folder / 'predicted'}", flush=True)
    command = [Path(sys.executable).parent / "evaluate", test, "--estimates", arguments.folder / "maps"]
    for name in ("network", *METHODS):
        command += ["--method", name]
    subprocess.run(command, check=True)


if __name__ == "__main__":
    main()
