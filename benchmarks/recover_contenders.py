"""Fit the weights of `recover/ellipsoid/selection_weights.json` to random scenes whose right ellipsoid is known.

Usage: python benchmarks/recover_contenders.py [--scenes 960] [--first 61000] [--processes 2]. Scenes are those of
recover_shells.py with 10 to 20 % all-lit pixels and noise 0.3 %. Prints the weights in that file, and in how many
scenes the right one is chosen: before, by the weights, and by those fitted to the other seven eighths of the scenes.
"""

import argparse
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from recover_shells import SHARES, judged, random_scene
from scipy.optimize import minimize

from huesphere.recover.ellipsoid.from_patches import find_candidates
from huesphere.recover.ellipsoid.selection import leading, learned_evidence, refit_contenders
from huesphere.recover.pixels.usable import problem_of, usable_pixels
from huesphere.recover.status import RecoveryFailure

RIGHT_DEG = 3.0
NOISE = 3e-3
RIDGE = 3.0  # on weights of standardised evidence, for all scenes
PARTS = 8


def contenders_of(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """(evidence (K, 5), right (K,)) of the leading candidates of a scene, in their order."""
    scene = random_scene(seed, noise=NOISE)
    try:
        problem = problem_of(usable_pixels(scene.observation), scene.observation)
        search = find_candidates(problem, scene.observation.camera)
    except RecoveryFailure:
        return np.empty((0, len(learned_evidence()))), np.empty(0, bool)
    ends = refit_contenders(search.grid, leading(search.found))
    right = [judged(scene, end.refitted.fit.C)[0] < RIGHT_DEG for end in ends]
    return np.array([end.evidence for end in ends]), np.array(right, bool)


def fitted(scenes: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Weights (5,) under which a right one is likeliest to be the first, of scenes that leave a choice."""
    scenes = [(X, right) for X, right in scenes if right.any() and not right.all()]
    spread = np.concatenate([X for X, _ in scenes]).std(axis=0)

    def loss(w: np.ndarray) -> tuple[float, np.ndarray]:
        total, slope = RIDGE * float(w @ w), 2 * RIDGE * w
        for X, right in scenes:
            Z = (X - X.mean(axis=0)) / spread
            p = np.exp(Z @ w - (Z @ w).max())
            p /= p.sum()
            total -= np.log(p[right].sum())
            slope -= np.where(right, p / p[right].sum(), 0.0) @ Z - p @ Z
        return total, slope

    return np.asarray(minimize(loss, np.zeros(len(spread)), jac=True).x) / spread


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=960)
    parser.add_argument("--first", type=int, default=61_000)
    parser.add_argument("--processes", type=int, default=2)
    asked = parser.parse_args()
    seeds = range(asked.first, asked.first + len(SHARES) * asked.scenes, len(SHARES))
    with ProcessPoolExecutor(asked.processes) as pool:
        scenes = list(pool.map(contenders_of, seeds))
    some = [scene for scene in scenes if len(scene[1])]

    def right(scene: tuple[np.ndarray, np.ndarray], w: np.ndarray) -> bool:
        return bool(scene[1][np.argmax(scene[0] @ w)])

    weights = fitted(some)
    for name, weight in zip(learned_evidence(), weights):
        print(f'    "{name}": {{"weight": {weight:.3f}}}')
    others = [fitted([scene for j, scene in enumerate(some) if j % PARTS != part]) for part in range(PARTS)]
    apart = [right(scene, others[k % PARTS]) for k, scene in enumerate(some)]
    first = sum(bool(s[1][0]) for s in some)
    print(f"right, of {len(scenes)}: the first {first}, the likeliest {sum(right(s, weights) for s in some)},", end=" ")
    print(f"by the others' weights {sum(apart)}, any {sum(bool(s[1].any()) for s in some)}")


if __name__ == "__main__":
    main()
