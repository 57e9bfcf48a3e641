"""A training loop without a framework, fed from a run folder: normals from colours by a small network in NumPy.

python docs/train.py run        (after: render --config my_sweep.yaml --out run)

What a loop needs of huesphere is `batches`; what follows stands for any learner.
"""

import sys
from collections.abc import Iterator, Sequence

import numpy as np

from huesphere.render.dataset import RunItem, open_run


def batches(items: Sequence[RunItem], size: int, rng: np.random.Generator) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yields (colours (size, 3), normals (size, 3)), a batch of one item's pixels; items in any order."""
    for number in rng.permutation(len(items)):
        seen, truth = items[number].observation(), items[number].truth()
        at = rng.choice(np.flatnonzero(seen.mask & truth.mask), size)
        yield seen.rgb.reshape(-1, 3)[at], truth.normals.reshape(-1, 3)[at]


class Network:
    """Two layers, tanh between them, trained by gradient descent with momentum on the squared error of the normal."""

    def __init__(self, hidden: int, rng: np.random.Generator) -> None:
        self.weights = [rng.normal(0, 1, (4, hidden)), rng.normal(0, hidden**-0.5, (hidden + 1, 3))]
        self.speed = [np.zeros_like(w) for w in self.weights]

    def __call__(self, colours: np.ndarray) -> np.ndarray:
        return self._forward(colours)[2]

    def _forward(self, colours: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        first = np.c_[colours, np.ones(len(colours))]
        second = np.c_[np.tanh(first @ self.weights[0]), np.ones(len(colours))]
        return first, second, second @ self.weights[1]

    def step(self, colours: np.ndarray, normals: np.ndarray, rate: float) -> None:
        first, second, out = self._forward(colours)
        error = (out - normals) / len(normals)
        inner = (error @ self.weights[1][:-1].T) * (1 - second[:, :-1] ** 2)
        for w, v, gradient in zip(self.weights, self.speed, (first.T @ inner, second.T @ error), strict=True):
            v *= 0.9
            v -= rate * gradient
            w += v


def mean_error_deg(network: Network, items: Sequence[RunItem], rng: np.random.Generator) -> float:
    """Mean angle between the network's normals and the true ones."""
    angles = []
    for colours, normals in batches(items, 512, rng):
        guess = network(colours)
        cosine = np.einsum("ij,ij->i", guess, normals) / np.linalg.norm(guess, axis=1)
        angles.append(np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean())
    return float(np.mean(angles))


def train(run: str, epochs: int = 200, rate: float = 0.1, seed: int = 0) -> tuple[float, float]:
    """(error before, error after) in degrees, on items that were not learnt from: every fifth is held out."""
    rng = np.random.default_rng(seed)
    items = open_run(run)
    held_out, known = items[::5], [item for number, item in enumerate(items) if number % 5]
    network = Network(32, rng)
    before = mean_error_deg(network, held_out, rng)
    for _ in range(epochs):
        for colours, normals in batches(known, 512, rng):
            network.step(colours, normals, rate)
    return before, mean_error_deg(network, held_out, rng)


if __name__ == "__main__":
    print("mean error, items held out: {:.1f}° before, {:.1f}° after".format(*train(sys.argv[1])))
