"""Fit the weights of `recover/ellipsoid/membership_weights.json` to pixels of random scenes with known lights.

Usage: python benchmarks/recover_all_lit.py [--scenes 900] [--first 20000] [--processes 2]. Scenes are those of
recover_shells.py: in turn with noise of 1e-4, 1e-3, 3e-3 and 1e-2, every third with cast shadows. Two thirds of them
are fitted to, the rest is judged. Prints "weights" and "offset" of that file, and how well they tell pixels apart.
"""

import argparse
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from recover_shells import aligned_error_deg, random_scene

from huesphere.recover.ellipsoid.from_patches import choose_ellipsoid
from huesphere.recover.ellipsoid.membership import Membership, learned_weights
from huesphere.recover.ellipsoid.parameters import ELLIPSOID
from huesphere.recover.parameters import overridden
from huesphere.recover.pixels.usable import problem_of, usable_pixels
from huesphere.recover.status import RecoveryFailure

NOISES = (1e-4, 1e-3, 3e-3, 3e-3, 1e-2)
MOST_PIXELS = 2000  # of a scene
RIGHT_DEG = 3.0  # error of C with which a scene takes part
RIDGE = 1e-3  # on weights of standardised evidence, for each pixel
STEPS = 30


def pixels_of(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """(evidence (P, K), all-lit (P,), inlier (P,)) of some pixels on the ellipsoid; None: it is not the right one."""
    rng = np.random.default_rng(seed)
    scene = random_scene(seed, noise=NOISES[seed % len(NOISES)], cast=seed % 3 == 2)
    problem = problem_of(usable_pixels(scene.observation), scene.observation)
    try:
        with overridden(ELLIPSOID, membership_passes=0):  # the inliers that evidence is computed from, not the outcome
            own = choose_ellipsoid(problem, scene.observation.camera).refitted
    except RecoveryFailure:
        return None
    if aligned_error_deg(scene.clean[scene.all_lit], own.fit.C, scene.normals[scene.all_lit]) > RIGHT_DEG:
        return None
    membership = Membership(problem.rgb, problem.usable, own.fit.C, noise=own.noise)
    on, seen = membership.on, membership.evidence(own.inlier)
    some = rng.permutation(len(seen))[:MOST_PIXELS]
    return seen[some], scene.all_lit[on][some], own.inlier[on][some]


def logistic(X: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, float]:
    """(weights (K,), offset) of P(y) = 1 / (1 + exp(−(X w + b))), by Newton's method."""
    mean, spread = X.mean(axis=0), X.std(axis=0)
    Z = np.column_stack([(X - mean) / spread, np.ones(len(X))])
    w = np.zeros(Z.shape[1])
    ridge = RIDGE * np.eye(len(w))
    for _ in range(STEPS):
        p = 1 / (1 + np.exp(-Z @ w))
        w += np.linalg.solve((Z * (p * (1 - p))[:, None]).T @ Z / len(Z) + ridge, Z.T @ (y - p) / len(Z) - ridge @ w)
    return w[:-1] / spread, float(w[-1] - mean @ (w[:-1] / spread))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=900)
    parser.add_argument("--first", type=int, default=20_000)
    parser.add_argument("--processes", type=int, default=2)
    asked = parser.parse_args()
    seeds = range(asked.first, asked.first + asked.scenes)
    with ProcessPoolExecutor(asked.processes) as pool:
        found = {seed: one for seed, one in zip(seeds, pool.map(pixels_of, seeds)) if one is not None}
    fitted, rest = (
        [np.concatenate(parts) for parts in zip(*(one for seed, one in found.items() if (seed % 7 < 5) == which))]
        for which in (True, False)
    )
    weights, offset = logistic(fitted[0], fitted[1].astype(float))
    print(f"{len(found)} of {asked.scenes} scenes")
    for name, weight in zip(learned_weights()[0], weights):
        print(f'    "{name}": {weight:.3f},')
    print(f'"offset": {offset:.3f}')
    seen, true, inlier = rest
    score = seen @ weights + offset
    print(f"on the rest: purity {true[score > 0].mean():.3f}, found {true[score > 0].sum() / true.sum():.3f};", end=" ")
    print(f"the inliers' {true[inlier].mean():.3f}, {(true & inlier).sum() / true.sum():.3f}")


if __name__ == "__main__":
    main()
