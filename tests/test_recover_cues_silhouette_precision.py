"""What the silhouette's rotation counts for: its errors by noise, by disagreement, and far from it."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_recover_cues_silhouette import START, ellipsoid, lit

from huesphere.recover.cues import silhouette as module
from huesphere.recover.cues.parameters import CUES
from huesphere.recover.cues.silhouette import Rim, SilhouetteRotation, silhouette_of, silhouette_weights

PRECISION = np.array([[900.0, 200.0, 0.0], [200.0, 500.0, -100.0], [0.0, -100.0, 300.0]])


@pytest.mark.parametrize("far_rad", [0.02, 0.2, 0.6])
def test_the_pull_is_the_downhill_derivative_of_the_loss(far_rad):
    found = SilhouetteRotation(START, PRECISION)
    axis = np.array([0.6, 0.0, 0.8])
    here = Rotation.from_rotvec(-far_rad * axis).as_matrix() @ START
    difference, weight = found.pull(here)
    np.testing.assert_allclose(difference, far_rad * axis, atol=1e-9)
    step = 1e-5

    def loss(t: float) -> float:  # along the difference, where small rotations add exactly
        return found.loss(Rotation.from_rotvec(t * axis).as_matrix() @ here)

    change = (loss(step) - loss(-step)) / (2 * step)
    assert -2 * axis @ weight @ difference == pytest.approx(change, rel=1e-5)


def test_beyond_a_few_standard_errors_the_pull_falls():
    found = SilhouetteRotation(np.eye(3), 1e4 * np.eye(3))  # 0.01 rad
    far = [1.0 * CUES.robust_width, 10.0 * CUES.robust_width]
    pulls = []
    for standard_errors in far:
        here = Rotation.from_rotvec([0.01 * standard_errors, 0.0, 0.0]).as_matrix()
        difference, weight = found.pull(here)
        pulls.append(np.linalg.norm(weight @ difference))
    assert pulls[1] / pulls[0] == pytest.approx(10 * 2 / 101, rel=1e-6)  # x / (1 + x²) at 10 over that at 1


def combined(turn: np.ndarray, of_means: np.ndarray, of_rim: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(small rotation from the means' rotation, precision) of both together, the rim being off it by ``turn``."""
    rim = Rim(Rotation.from_rotvec(turn).as_matrix() @ START, of_rim, 1.0, 0.0)
    rotation, precision = module._combined(START, of_means, rim)
    return Rotation.from_matrix(rotation @ START.T).as_rotvec(), precision


def test_means_and_rim_are_averaged_by_their_precision():
    turn = np.array([1e-3, -2e-3, 0.5e-3])
    of_rim = np.diag([400.0, 100.0, 900.0])
    found, precision = combined(turn, PRECISION, of_rim)
    np.testing.assert_allclose(found, np.linalg.inv(PRECISION + of_rim) @ of_rim @ turn, atol=1e-9)
    np.testing.assert_allclose(precision, PRECISION + of_rim)


def test_where_means_and_rim_disagree_their_precision_falls_as_the_square():
    """By the difference over its own standard error, the root of both variances."""
    of_means, of_rim = 100.0 * np.eye(3), 400.0 * np.eye(3)
    squared_error = 1 / 100 + 1 / 400
    times = 5.0
    turn = np.array([0.0, 0.0, times * np.sqrt(CUES.disagreement * squared_error)])
    _, precision = combined(turn, of_means, of_rim)
    np.testing.assert_allclose(precision, (of_means + of_rim) / times**2, rtol=1e-6)


def test_the_rims_error_by_noise_is_the_scatter_that_noise_makes(monkeypatch):
    """With the standard errors that were measured on scenes set to 0 what is left of the variance is noise's."""
    for name in ("standard error of rim, degrees", "standard error of rim, degrees for a misfit of 1"):
        for part in ("tilt", "twist"):
            monkeypatch.setitem(silhouette_weights()[name], part, 0.0)
    n, mask = ellipsoid(96, (1.0, 0.9, 0.9), np.eye(3))
    N, _ = lit(n, 2)
    silhouette, sigma = silhouette_of(mask, mask), 0.05
    clean = silhouette.rim(N[mask], 1e-12 * np.eye(3)).rotation
    turns, stated = [], 0.0
    for seed in range(60):
        noise = sigma * np.random.default_rng(seed).standard_normal(N[mask].shape)
        rim = silhouette.rim(N[mask] + noise, sigma**2 * np.eye(3))
        turns.append(Rotation.from_matrix(rim.rotation @ clean.T).as_rotvec())
        stated = np.linalg.inv(rim.precision)
    tilt = np.mean(np.square(turns)[:, :2])
    twist = np.mean(np.square(turns)[:, 2])
    assert stated[0, 0] == stated[1, 1]
    assert tilt / stated[0, 0] == pytest.approx(1.0, abs=0.35)
    assert twist < 1.2 * stated[2, 2]  # the mean of two rows: rather too careful
