"""How right ``silhouette-matrix`` and ``uniform-hue`` are, and what they state, where brightness varies.

Usage: python benchmarks/uniform_hue.py [--bodies FIRST LAST] [--photographs FIRST LAST] [--method NAME]… [--record].
Bodies are the random scenes of ``uniform_hue_scenes``, by seed; photographs the mixes of ``trust_scenes``, by seed of
the mix, where they are at hand. For each picture: median and mean error over all object pixels, the median stated
error, and their ratio. The numbers of ``recover/uniform_hue/cue_weights.json`` and ``silhouette_matrix_errors.json``
were chosen with bodies 0 to 11 and 100 to 111 and mixes 0 to 2; others are for judging.
"""

import argparse
from collections import defaultdict
from collections.abc import Iterator

import numpy as np
from record import record
from trust_scenes import PHOTOGRAPHED, REAL, photograph
from uniform_hue_scenes import scene

from huesphere.recover.methods.table import METHODS
from huesphere.render.dataset import CameraInfo, Observation

SIZE = 112  # pixels of a body's picture
MOST = 15_000  # pixels of a photographed object: larger ones are reduced


def pictures(bodies: list[int], photographs: list[int]) -> Iterator[tuple[str, Observation, np.ndarray]]:
    """(family, observation, true normals) of all that was asked for."""
    for seed in range(*bodies):
        made = scene(seed, SIZE)
        yield "bodies", made.observation, made.normals
    for seed in range(*photographs) if REAL.is_dir() else ():
        for name in PHOTOGRAPHED:
            for mix in ("lamps", "gels"):
                sample = photograph(name, mix, seed)
                row, column = (np.flatnonzero(sample.mask.any(axis=axis)) for axis in (1, 0))
                box = np.s_[max(row[0] - 3, 0) : row[-1] + 4, max(column[0] - 3, 0) : column[-1] + 4]
                rgb = np.where(sample.mask[..., None], sample.rgb, 0.0)[box].astype(np.float32)
                observation = Observation(rgb, sample.mask[box], CameraInfo(known=False))
                yield f"{name} {mix}", observation, sample.normals[box]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bodies", type=int, nargs=2, default=[0, 0])
    parser.add_argument("--photographs", type=int, nargs=2, default=[0, 0])
    parser.add_argument("--method", action="append")
    parser.add_argument("--record", action="store_true")
    asked = parser.parse_args()
    found: dict[tuple[str, str], list[tuple[float, float, float]]] = defaultdict(list)
    for family, observation, normals in pictures(asked.bodies, asked.photographs):
        for method in asked.method or ("silhouette-matrix", "uniform-hue"):
            estimate = METHODS[method](observation, most_pixels=MOST)
            given = estimate.valid & observation.mask
            error = np.full(observation.mask.shape, 90.0)  # where no normal is given
            cosine = np.clip((estimate.normals[given].astype(float) * normals[given]).sum(axis=1), -1, 1)
            error[given] = np.degrees(np.arccos(cosine))
            stated = float(np.nanmedian(estimate.uncertainty_deg[given])) if given.any() else float("nan")
            one = (float(np.median(error[observation.mask])), float(error[observation.mask].mean()), stated)
            found[family, method].append(one)
            print(
                f"{family:22} {method:18} {estimate.verdict:9} {one[0]:5.1f} {one[1]:5.1f} stated {stated:5.1f}",
                flush=True,
            )
    for (family, method), rows in found.items():
        median, mean, stated = np.mean(rows, axis=0)
        within = np.mean([row[0] <= row[2] for row in rows])
        note = f"mean of the means {mean:.1f}, stated {stated:.1f}, {within:.0%} within it, {len(rows)} pictures"
        if asked.record:
            record(f"varying brightness, {family}, {method}: mean of the medians", float(median), "deg", note=note)
        else:
            print(f"{family}, {method}: {median:.2f}, {note}")


if __name__ == "__main__":
    main()
