"""Fit `recover/cues/silhouette_weights.json` to random scenes, and print the errors of the silhouette's rotation.

Usage: python benchmarks/recover_outline.py [--scenes 400] [--first 20000] [--processes 2]. Scenes are those of
recover_shells.py, noise 0.3 %; C is that of the true lights, so that all errors are those of the silhouette. Prints the
weights (those in the file and those fitted now), errors by shape with the weights of the other shapes, and, by how
badly the rim fits, the errors across and about the view against what is stated.
"""

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from recover_shells import SHAPES, random_scene

from huesphere.recover.cues.silhouette import silhouette_of, silhouette_weights
from huesphere.recover.geometry.root import symmetric_root

NOISE = 3e-3
SCATTER = 0.1  # radians: errors beyond count ever less in the fit
ROUNDS = 15
RIDGE = 1e-3
MISFITS = (0.0, 0.05, 0.1, 0.2, 0.4, 0.8, np.inf)


@dataclass(frozen=True)
class Told:
    """What the silhouette of one scene tells, in the frame of the camera."""

    shape: str
    level: np.ndarray  # (3,) where slopes cancel; the truth is (0, 0, 1)
    means: np.ndarray  # (3, 3) off it
    tilt: float  # degrees, of the rotation from all of the silhouette
    twist: float
    stated: np.ndarray  # (2,) standard errors of tilt (of either component) and twist
    misfit: float
    same_hand: bool


def told(seed: int) -> Told | None:
    scene = random_scene(seed, noise=NOISE)
    mask, rgb = scene.observation.mask, scene.observation.rgb[scene.observation.mask].astype(float)
    silhouette = silhouette_of(mask, mask)
    if silhouette is None:
        return None
    C = np.linalg.inv(scene.F @ scene.F.T)
    G = symmetric_root(C)
    R = np.linalg.inv(scene.F) @ np.linalg.inv(G)  # n = F⁻¹ρ = R G ρ
    found = silhouette.rotation(rgb @ G, scene.share, NOISE**2 * C)
    if found is None:
        return None
    turn = found.rotation @ R.T
    level, means = silhouette.means(rgb @ G)
    tilt = np.degrees(np.arccos(np.clip(turn[2, 2], -1, 1)))
    twist = abs(np.degrees(np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])))
    stated = np.degrees(1 / np.sqrt(np.diag(found.precision)))[1:]
    misfit = np.inf if found.rim is None else found.rim.misfit
    return Told(scene.name, R @ level, means @ R.T, tilt, twist, stated, misfit, bool(np.linalg.det(turn) > 0))


def fitted(scenes: list[Told]) -> np.ndarray:
    """Weights (3,) of the means under which they point toward the camera, robustly."""
    means = np.array([one.means[:, :2].T for one in scenes])
    wanted = np.array([-one.level[:2] / max(one.level[2], 0.3) for one in scenes])
    weight = np.ones(len(scenes))
    for _ in range(ROUNDS):
        gram = np.einsum("s,sik,sil->kl", weight, means, means) + RIDGE * np.eye(means.shape[2])
        w = np.linalg.solve(gram, np.einsum("s,sik,si->k", weight, means, wanted))
        weight = 1 / (1 + ((wanted - means @ w) ** 2).sum(axis=1) / SCATTER**2)
    return w  # type: ignore[no-any-return]


def off_deg(scenes: list[Told], w: np.ndarray) -> np.ndarray:
    """How far from the camera's direction the weighted means point, degrees (S,)."""
    facing = np.array([one.level + w @ one.means for one in scenes])
    return np.degrees(np.arccos(np.clip(facing[:, 2] / np.linalg.norm(facing, axis=1), -1, 1)))  # type: ignore[no-any-return]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=400)
    parser.add_argument("--first", type=int, default=20_000)
    parser.add_argument("--processes", type=int, default=2)
    asked = parser.parse_args()
    with ProcessPoolExecutor(asked.processes) as pool:
        scenes = [one for one in pool.map(told, range(asked.first, asked.first + asked.scenes)) if one is not None]
    print(f"{len(scenes)} scenes, handedness right in {np.mean([one.same_hand for one in scenes]):.3f}")
    for (name, now), new in zip(silhouette_weights()["weights"].items(), fitted(scenes)):
        print(f'    "{name}": {new:.2f},  # now {now:.2f}')
    for shape in SHAPES:
        own, others = ([one for one in scenes if (one.shape == shape) == same] for same in (True, False))
        if own:
            off = off_deg(own, fitted(others))
            all_told = np.array([one.tilt for one in own])
            print(f"{shape}: means alone {_quantiles(off)}, with the rim {_quantiles(all_told)} deg (median, 90 %)")
    for least, most in pairwise(MISFITS):
        some = [one for one in scenes if least <= one.misfit < most]
        if some:
            tilt, twist = _quantiles([one.tilt for one in some]), _quantiles([one.twist for one in some])
            stated = np.median([one.stated for one in some], axis=0)
            print(f"rim off by {least}–{most} ({len(some)}): tilt {tilt}, twist {twist}, stated {stated.round(1)}")


def _quantiles(values: list[float] | np.ndarray) -> str:
    return " / ".join(f"{x:.1f}" for x in np.quantile(values, [0.5, 0.9]))


if __name__ == "__main__":
    main()
