"""Normals of a tactile sensor by a calibrated rig, a lookup table and a small network: one press left out in turn.

Usage: python benchmarks/tactile.py FOLDER [--record] [--presses 5] [--only rig]
FOLDER holds presses.json (reference, ball_radius_px, presses: file and centre_px) and its pictures. Each press is left
out once, and each estimator is trained on the others, or on as many of them as --presses says. Two errors are printed,
means over the presses of the median angle in degrees: within 0.75 of the ball's radius, which reaches beyond the
contact circle of most presses, so that part of its "truth" is wrong; and within 0.4, where all of them touch the ball.
Baselines are trained on pixels within the same circles as the rig, and on those within 0.75 of the radius.
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from record import record
from scipy.optimize import minimize
from scipy.spatial import cKDTree

from huesphere.configs.threads import one_blas_thread
from huesphere.recover.rig.ball import Ball
from huesphere.recover.rig.calibrate import CalibrationPicture, calibrate, contact_circles, shown_by
from huesphere.recover.rig.command import read_for_rig
from huesphere.recover.rig.fit import angles_deg
from huesphere.recover.rig.markers import dark_spots
from huesphere.recover.rig.model import matrices_at, positions
from huesphere.scenes.encoding import encode_srgb

WIDE, CERTAIN = 0.75, 0.4  # of the ball's radius
NEIGHBOURS = 10  # of the lookup table, that are averaged
HIDDEN, STEPS, PIXELS = 24, 150, 3000  # units of each of two layers, of L-BFGS, training pixels of the network

Features = tuple[np.ndarray, np.ndarray]  # (N, C) inputs, (N, 3) normals
Predict = Callable[[np.ndarray], np.ndarray]


def lookup_table(inputs: np.ndarray, normals: np.ndarray) -> Predict:
    """Slopes of the nearest colour differences: what the community's tables hold (position is not used)."""
    tree, slopes = cKDTree(inputs[:, :3]), normals[:, :2] / normals[:, 2:]
    return lambda x: of_slopes(slopes[tree.query(x[:, :3], NEIGHBOURS)[1]].mean(axis=1))


def network(inputs: np.ndarray, normals: np.ndarray) -> Predict:
    """Two hidden layers of tanh from colour differences and position to slopes, by L-BFGS on squared errors."""
    rng = np.random.default_rng(0)
    chosen = rng.permutation(len(inputs))[:PIXELS]
    mean, spread = inputs.mean(axis=0), inputs.std(axis=0)
    x, y = (inputs[chosen] - mean) / spread, normals[chosen, :2] / normals[chosen, 2:]
    shapes = [(x.shape[1], HIDDEN), (HIDDEN,), (HIDDEN, HIDDEN), (HIDDEN,), (HIDDEN, 2), (2,)]
    ends = np.cumsum([int(np.prod(s)) for s in shapes])
    start = np.concatenate([rng.normal(size=s).ravel() / np.sqrt(s[0]) * (len(s) > 1) for s in shapes])

    def layers(theta: np.ndarray) -> list[np.ndarray]:
        return [part.reshape(s) for part, s in zip(np.split(theta, ends[:-1]), shapes)]

    def forward(theta: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        a, b, c, d, e, f = layers(theta)
        first = np.tanh(x @ a + b)
        second = np.tanh(first @ c + d)
        return first, second, second @ e + f

    def loss(theta: np.ndarray) -> tuple[float, np.ndarray]:
        _, _, c, _, e, _ = layers(theta)
        first, second, out = forward(theta, x)
        back = 2 * (out - y) / len(x)
        back2 = back @ e.T * (1 - second**2)
        back1 = back2 @ c.T * (1 - first**2)
        parts = (x.T @ back1, back1.sum(0), first.T @ back2, back2.sum(0), second.T @ back, back.sum(0))
        gradient = np.concatenate([part.ravel() for part in parts]) + 2e-4 * theta
        return float(((out - y) ** 2).sum() / len(x) + 1e-4 * (theta**2).sum()), gradient

    theta = minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": STEPS}).x
    return lambda inputs: of_slopes(forward(theta, (inputs - mean) / spread)[2])


def of_slopes(slopes: np.ndarray) -> np.ndarray:
    """Unit normals of n1/n3 and n2/n3."""
    n = np.column_stack([slopes, np.ones(len(slopes))])
    return np.asarray(n / np.linalg.norm(n, axis=1, keepdims=True))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--record", action="store_true")
    parser.add_argument("--presses", type=int, default=9)
    parser.add_argument("--only", default="")
    arguments = parser.parse_args()
    facts = json.loads((arguments.folder / "presses.json").read_text())
    empty = read_for_rig(arguments.folder / facts["reference"]).observation.rgb.astype(float)
    pictures, inputs = [], []
    position = positions(empty.shape[1::-1])
    for press in facts["presses"]:
        light = read_for_rig(arguments.folder / press["file"]).observation.rgb.astype(float)
        usable = ~(dark_spots(empty) | dark_spots(light)) & (empty > 1e-3).all(axis=-1)
        ball = Ball(*press["centre_px"], facts["ball_radius_px"])
        pictures.append(CalibrationPicture(light / np.maximum(empty, 1e-3), usable, ball))
        inputs.append(np.dstack([encode_srgb(light) - encode_srgb(empty), position]))
    errors: dict[str, list[tuple[float, float]]] = {}
    for number, press in enumerate(pictures):
        others = [i for i in range(len(pictures)) if i != number]
        taken = sorted(np.random.default_rng(number).permutation(others)[: arguments.presses])
        normals, distance = press.ball.normals(press.usable.shape)
        wide = press.usable & (distance < WIDE)

        def score(name: str, found: np.ndarray, truth=normals[wide], distance=distance[wide]) -> None:
            error = angles_deg(found, truth)
            both = float(np.median(error)), float(np.median(error[distance < CERTAIN]))
            errors.setdefault(name, []).append(both)

        rig = calibrate([pictures[i] for i in taken], divided=True).rig
        F = matrices_at(rig.coefficients, position[wide])
        b = np.linalg.solve(F, press.rho[wide][..., None])[..., 0]
        score("rig", b / np.linalg.norm(b, axis=1, keepdims=True))
        if arguments.only == "rig":
            continue
        circles = contact_circles([shown_by(pictures[i], i, position, True) for i in taken])
        for where, limits in (("contact", circles), ("0.75 R", (WIDE,) * len(taken))):
            parts = [training(pictures[i], inputs[i], limit) for i, limit in zip(taken, limits)]
            x, n = (np.concatenate(values) for values in zip(*parts))
            for name, method in (("lookup table", lookup_table), ("network", network)):
                score(f"{name}, trained within {where}", method(x, n)(inputs[number][wide]))
    for name, both in errors.items():
        for region, values in zip((f"within {WIDE} R", f"within {CERTAIN} R"), zip(*both)):
            each = "per press " + " ".join(f"{value:.1f}" for value in values)
            case = f"tactile presses, {name}, {arguments.presses} for calibration, {region}"
            if arguments.record:
                record(case, float(np.mean(values)), "deg", note=f"mean of medians; {each}")
            else:
                print(f"{case}: {np.mean(values):.2f} deg; {each}", flush=True)


def training(picture: CalibrationPicture, inputs: np.ndarray, limit: float) -> Features:
    """Pixels of the sphere within ``limit`` of its radius, and a tenth as many of the flat sheet."""
    normals, distance = picture.ball.normals(picture.usable.shape)
    inside = picture.usable & (distance < limit)
    flat = np.flatnonzero((picture.usable & (distance > 2)).ravel())
    flat = flat[np.linspace(0, len(flat) - 1, max(1, inside.sum() // 10)).astype(int)]
    facing = np.tile([0.0, 0.0, 1.0], (len(flat), 1))
    x = np.concatenate([inputs[inside], inputs.reshape(-1, inputs.shape[2])[flat]])
    return x, np.concatenate([normals[inside], facing])


if __name__ == "__main__":
    with one_blas_thread():
        main()
