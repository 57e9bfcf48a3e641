"""Method `auto` over all pixels of pictures of which a tenth and more sees every light: scenes of recover_shells.

Usage: python benchmarks/recover_few_lit.py [--scenes 40] [--first 506000] [--noise 0.001] [--cast] [--record].
"""

import argparse

import numpy as np
from record import record
from recover_shells import random_scene

from huesphere.eval.metrics import angular_error_deg
from huesphere.recover.run import recover_one


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=40)
    parser.add_argument("--first", type=int, default=506_000)
    parser.add_argument("--noise", type=float, default=1e-3)
    parser.add_argument("--cast", action="store_true", help="with cast shadows")
    parser.add_argument("--record", action="store_true", help="append to results.tsv")
    asked = parser.parse_args()
    rows = []
    for seed in range(asked.first, asked.first + asked.scenes):
        scene = random_scene(seed, noise=asked.noise, cast=asked.cast)
        found = recover_one(scene.observation, "auto")
        error = angular_error_deg(found.normals[found.valid], scene.normals[found.valid])
        median, mean = (float(one(error)) if len(error) else 90.0 for one in (np.median, np.mean))
        stated = float(found.uncertainty_deg[found.valid].mean()) if len(error) else 90.0
        given = float(found.valid.sum() / scene.observation.mask.sum())
        rows.append((median, mean, stated, given, found.status == "ok", found.seconds))
    median, mean, stated, given, ok, seconds = np.array(rows, dtype=float).T
    case = f"auto, few pixels all-lit, noise {asked.noise:g}{', cast shadows' if asked.cast else ''}"
    note = f"{asked.scenes} scenes from seed {asked.first}; {given.mean():.0%} of pixels given"
    figures = (
        ("median of medians over all pixels", float(np.median(median)), "deg"),
        ("mean of means", float(mean.mean()), "deg"),
        ("mean stated over mean error, median", float(np.median(stated / np.maximum(mean, 1e-3))), "ratio"),
        ("over 10° and ok", float(((median > 10) & (ok > 0)).sum()), "scenes"),
        ("over 10°", float((median > 10).sum()), "scenes"),
        ("under 3° and flagged", float(((median < 3) & (ok == 0)).sum()), f"of {(median < 3).sum()}"),
        ("seconds", float(np.median(seconds)), "s"),
    )
    for name, value, unit in figures:
        if asked.record:
            record(f"{case}: {name}", value, unit, note=note)
        else:
            print(f"{case}: {name}", f"{value:.3f}", unit, note, sep="\t")


if __name__ == "__main__":
    main()
