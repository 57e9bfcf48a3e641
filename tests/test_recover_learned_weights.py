"""Learned weights: all of them are those that were fitted, and each of the silhouette's is worth having."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from test_recover_cues_silhouette import START, ellipsoid, lit

from huesphere.recover.cues.silhouette import silhouette_of, silhouette_weights
from huesphere.recover.ellipsoid.membership import learned_weights
from huesphere.recover.ellipsoid.selection import learned_evidence
from huesphere.recover.geometry.rotations import rotation_by
from huesphere.recover.parameters import learned, learned_files

ROOT = Path(__file__).parent.parent


def test_weights_of_membership_are_those_of_the_regression():
    """What benchmarks/recover_all_lit.py fitted; the golden answers were made with them."""
    weights, offset = learned_weights()
    assert list(weights.values()) == [-2.116, -1.091, -1.323, -0.107, 4.489, -4.471, 1.401, 1.309, 0.605]
    assert offset == 4.531


def test_evidence_of_selection_is_that_of_the_choice_model():
    """What benchmarks/recover_contenders.py fitted: weights, floors, and values for what is unknown."""
    assert list(learned_evidence().values()) == [
        {"weight": 0.470, "least": 1e-6},
        {"weight": -5.334, "least": 0.8},
        {"weight": 3.960, "if unknown": 0.8},
        {"weight": -1.953, "least": 0.05, "if unknown": 1.0},
        {"weight": -1.358, "least": 0.01, "if unknown": 0.3},
    ]


def test_numbers_of_the_silhouette_are_those_that_were_measured():
    """What benchmarks/recover_outline.py fitted and measured, of means (tilt, twist) and of the rim."""
    found = silhouette_weights()
    assert list(found["weights"].values()) == [1.85, -4.2, 0.52]
    errors = [list(found[name].values()) for name in found if name.startswith("standard error")]
    assert errors == [[1.8, 1.6], [0.8, 0.5], [18.0, 10.0]]


@pytest.mark.parametrize("file", learned_files())
def test_a_file_of_weights_says_which_script_fitted_it_to_which_data(file):
    found = learned(file)
    assert (ROOT / found["script"]).is_file()
    assert len(found["data"]) > 20
    assert len(found["model"]) > 20
    assert file.rpartition("/")[2] in (ROOT / found["script"]).read_text(encoding="utf-8")


@cache
def means_of_random_bodies() -> list[tuple[np.ndarray, np.ndarray]]:
    """What ``Silhouette.means`` gives of 40 turned ellipsoids, each under six lights."""
    found = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        n, mask = ellipsoid(64, tuple(rng.uniform(0.6, 1.0, 3)), rotation_by(rng.normal(size=3)))
        N, _ = lit(n, seed)
        found.append(silhouette_of(mask, mask).means(N[mask]))
    return found


def tilt_error_deg(weights: np.ndarray) -> float:
    """Root mean square error of the direction toward the camera that the weighted means give."""
    errors = []
    for level, means in means_of_random_bodies():
        facing = level + weights @ means
        errors.append(np.arccos(min(1.0, facing @ START[2] / np.linalg.norm(facing))))
    return float(np.degrees(np.sqrt(np.mean(np.square(errors)))))


@pytest.mark.parametrize("which", range(3))
@pytest.mark.parametrize("factor", [-1.0, 0.0, 2.0])
def test_each_weight_of_the_silhouettes_means_lowers_the_tilts_error(which, factor):
    weights = np.array(list(silhouette_weights()["weights"].values()))
    other = weights.copy()
    other[which] *= factor
    assert tilt_error_deg(weights) < 0.96 * tilt_error_deg(other)
