"""The example of a learned baseline: its gradients are those of its error, and its maps are what `evaluate` reads."""

import runpy
from pathlib import Path

import numpy as np
import pytest
from test_eval_fabricated_run import fabricate_run

import huesphere as hs

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def example() -> dict:
    return runpy.run_path(str(ROOT / "examples/train_normals.py"))


def test_a_step_goes_down_the_gradient(example):
    """Central differences of the mean squared error in one weight of each layer."""
    rng = np.random.default_rng(0)
    network = example["Network"](4, 5, rng)
    x, normals = rng.normal(size=(30, 4)), rng.normal(size=(30, 3))

    def error() -> float:
        out = network._layers(x)[-1] @ network.weights[-1]
        return float(((out - normals) ** 2).sum() / 2 / len(x))

    slopes = []
    for weights in network.weights:
        weights[1, 2] += 1e-5
        above = error()
        weights[1, 2] -= 2e-5
        slopes.append((above - error()) / 2e-5)
        weights[1, 2] += 1e-5
    network.step(x, normals, 0.0)
    found = [mean[1, 2] / 0.1 for mean, _ in network.moments]
    assert found == pytest.approx(slopes, rel=1e-5)


def test_the_network_learns_a_sphere(example):
    """Colours F n of a sphere, with a light that switches off where n points away: below 3° after 300 steps."""
    rng = np.random.default_rng(1)
    normals = rng.normal(size=(4000, 3)) * [1, 1, 0.5]
    normals[:, 2] = np.abs(normals[:, 2])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    x = np.maximum(normals @ np.array([[0.4, -0.4, 0.0], [0.2, 0.2, -0.4], [0.9, 0.9, 0.9]]), 0)
    network = example["Network"](3, 24, rng)
    network.middle, network.scale = x.mean(axis=0), x.std(axis=0)
    for _ in range(300):
        at = rng.integers(3000, size=512)
        network.step(x[at], normals[at], 0.01)
    cosine = np.einsum("nc,nc->n", network(x[3000:]), normals[3000:])
    assert np.degrees(np.median(np.arccos(np.clip(cosine, -1, 1)))) < 3


def test_features_do_not_see_what_is_off_the_object(example):
    rng = np.random.default_rng(2)
    rgb, mask = rng.uniform(size=(20, 24, 3)), np.zeros((20, 24), bool)
    mask[4:15, 5:19] = True
    other = np.where(mask[..., None], rgb, 7.0)
    assert np.allclose(example["features"](rgb, mask), example["features"](other, mask))
    flat = example["features"](np.ones((20, 24, 3)), mask)
    assert np.allclose(flat[:, :3], 1)
    assert np.allclose(flat[:, 3:], 0, atol=1e-6)  # means equal the colour, up to the border too


def test_maps_of_a_run_lie_where_a_submission_is_looked_for(example, tmp_path):
    """Under the item's own name, with a unit normal at each pixel of the object and none off it."""
    fabricate_run(tmp_path / "run", {"bump/full": {}}, size=24)
    network = example["Network"](3 + 3 * len(example["WINDOWS"]), 4, np.random.default_rng(3))
    example["write_maps"](network, tmp_path / "run", tmp_path / "predicted")
    assert [path.relative_to(tmp_path) for path in tmp_path.glob("predicted/**/*.npy")] == [
        Path("predicted/bump/full.npy")
    ]
    normals, mask = np.load(tmp_path / "predicted/bump/full.npy"), hs.open_run(tmp_path / "run")[0].observation().mask
    assert np.isfinite(normals).all(axis=-1).tolist() == mask.tolist()
    assert np.linalg.norm(normals[mask], axis=1) == pytest.approx(1.0, abs=1e-6)
