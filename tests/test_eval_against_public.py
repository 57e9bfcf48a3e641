"""Our numbers against those of a public evaluator on the same normal maps.

DSINE (G. Bae and A. Davison, "Rethinking inductive biases for surface normal estimation", CVPR 2024,
github.com/baegwangbin/DSINE, `compute_normal_error` and `compute_normal_metrics`) scores as is usual since NYUv2:
cosine similarity, clamped, arccos, degrees; mean, median, root mean square; per cent below 5, 7.5, 11.25, 22.5 and 30
degrees. That arithmetic is written out anew here, in double precision, where arccos keeps seven digits at these errors.
Its own is in single precision, which is what the last test is about.
"""

import numpy as np
import pytest
from test_eval_fabricated_run import bump, fabricate_run, rotation, table

from eval.others import find_others
from eval.report import write_report
from eval.score import read_items

PUBLIC = {"mean": "mean_deg", "median": "median_deg", "rmse": "rms_deg"}
PUBLIC |= {"a1": "within_5", "a3": "within_11_25", "a4": "within_22_5", "a5": "within_30"}


def published_metrics(prediction: np.ndarray, truth: np.ndarray, precision: type) -> dict[str, float]:
    """The evaluator's formulas on (N, 3) normals of any length."""
    a, b = prediction.astype(precision), truth.astype(precision)
    lengths = np.maximum(np.sqrt((a * a).sum(axis=1)) * np.sqrt((b * b).sum(axis=1)), precision(1e-8))
    cosine = np.clip((a * b).sum(axis=1) / lengths, precision(-1), precision(1))
    error = np.arccos(cosine) * precision(180.0) / precision(np.pi)
    below = {f"a{n}": 100.0 * np.mean(error < t) for n, t in enumerate((5, 7.5, 11.25, 22.5, 30), start=1)}
    return {"mean": np.average(error), "median": np.median(error), "rmse": np.sqrt(np.mean(error * error))} | below


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, dict[str, str]], dict[str, np.ndarray]]:
    """Rows of metrics.csv and the normal maps behind them: a turn, one with a hole, one with much noise."""
    folder = tmp_path_factory.mktemp("run")
    fabricate_run(folder / "run", {"bump/linear": {"robust": rotation("z", 7.0)}})
    _, normals, mask = bump(64)
    rng = np.random.default_rng(1)
    noisy = normals + 0.25 * rng.standard_normal(normals.shape)
    hollow = normals @ rotation("x", 9.0).T
    hollow[mask & (np.arange(64) % 5 == 0)] = np.nan
    maps = {"noisy": noisy, "hollow": hollow, "turned": normals @ rotation("y", 20.0).T}
    for name, image in maps.items():
        path = folder / f"others/{name}/bump/linear.npy"
        path.parent.mkdir(parents=True)
        np.save(path, image)
    write_report(folder / "run", estimates=find_others(folder / "others", read_items(folder / "run")))
    return {row["method"]: row for row in table(folder / "run")}, maps


@pytest.mark.parametrize("name", ["noisy", "hollow", "turned"])
def test_mean_median_and_shares_are_those_of_the_public_evaluator(compared, name: str):
    rows, maps = compared
    _, normals, mask = bump(64)
    normals = normals.astype(np.float32)  # as truth.exr holds them
    given = mask & np.isfinite(maps[name]).all(axis=-1)
    length = np.linalg.norm(maps[name][given], axis=-1, keepdims=True)
    public = published_metrics((maps[name][given] / length).astype(np.float32), normals[given], np.float64)
    assert 1.0 < public["median"] < 60.0
    for theirs, ours in PUBLIC.items():
        value = float(rows[name][ours]) * (100.0 if ours.startswith("within") else 1.0)
        assert value == pytest.approx(public[theirs], abs=1e-6), ours


def test_in_single_precision_the_usual_formula_cannot_tell_small_errors_apart():
    """Why ours is not that formula: on normals 0.01 degrees apart it is off by half and more."""
    _, normals, mask = bump(64)
    truth = normals[mask]
    turned = truth @ rotation("z", 0.01).T
    exact = published_metrics(turned, truth, np.float64)["median"]
    single = published_metrics(turned, truth, np.float32)["median"]
    chord = np.hypot(truth[:, 0], truth[:, 1]) * np.sin(np.radians(0.005))
    assert exact == pytest.approx(np.median(2 * np.degrees(np.arcsin(chord))), rel=1e-3)
    assert abs(single - exact) > 0.5 * exact
