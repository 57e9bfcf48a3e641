"""The likeliest rotation: exact without noise, within its own error with it, and not led astray by a lost light."""

import numpy as np
import pytest
from synthesis import TWIN, aligned_error, dome, light_colours, median_error, mozart, needs_mozart, shade

from huesphere.recover.geometry.rotations import rotation_by, turn_between
from huesphere.recover.methods.table import METHODS
from huesphere.recover.rotation.tangents import tangent_rotation
from huesphere.recover.status import RecoveryFailure
from huesphere.render.dataset import CameraInfo

pytestmark = pytest.mark.usefixtures("as_the_method_says")  # the verdict has tests of its own

START = rotation_by(np.array([0.15, -0.1, 0.2]))


def turned(n: np.ndarray, seed: int, noise: float) -> np.ndarray:
    """Normals in a frame turned from the camera's by START, with noise."""
    return (n + noise * np.random.default_rng(seed).standard_normal(n.shape)) @ START


@pytest.mark.parametrize("hand", [1.0, -1.0])
def test_without_noise_the_rotation_is_exact(hand):
    n, inside = dome(96, elongation=1.2, bumps=0.15)
    found = tangent_rotation(hand * turned(n, 0, 0.0), inside, 1e-6 * np.eye(3), [hand * np.eye(3)])
    assert np.degrees(turn_between(found.rotation, hand * START)) < 0.1
    assert found.converged


def test_where_detail_is_all_that_is_left_the_steps_settle():
    """Bumps of a few pixels are no planes: hundreds of times what noise there is, shared by neighbours."""
    bumpy, inside = dome(160, elongation=1.2, bumps=0.3)
    rows, columns = np.indices(inside.shape)
    slope = 0.3 * np.stack([np.sin(columns / 1.7) * np.cos(rows / 2.1), np.cos(columns / 2.3) * np.sin(rows / 1.9)], -1)
    n = np.where(inside[..., None], bumpy - np.concatenate([slope, np.zeros_like(slope[..., :1])], -1), np.nan)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    found = tangent_rotation(turned(n, 0, 0.0), inside, 1e-8 * np.eye(3), [np.eye(3)])
    assert found.misfit > 30
    assert found.converged
    assert np.degrees(turn_between(found.rotation, START)) < 5


def test_the_error_is_within_what_is_said_of_it():
    """Tangents at the noisy normals themselves would turn it by several of its standard errors."""
    n, inside = dome(96, elongation=1.2, bumps=0.1, cap=0.6)
    ratios, misfits = [], []
    for seed in range(6):
        found = tangent_rotation(turned(n, seed, 0.03), inside, 0.03**2 * np.eye(3), [np.eye(3)])
        ratios.append(turn_between(found.rotation, START) / np.sqrt(np.trace(found.covariance)))
        misfits.append(found.misfit)  # one scatters by 0.04
    assert np.mean(misfits) == pytest.approx(1, abs=0.15)
    assert np.sqrt(np.mean(np.square(ratios))) < 1.6


def test_neighbours_that_misfit_together_hardly_count():
    n, inside = dome(120, elongation=1.2, bumps=0.1, cap=0.8)
    strangers = inside & (np.indices(inside.shape)[1] > 88)
    n = np.where(strangers[..., None], n @ rotation_by(np.array([0.1, 0.1, 0.1])).T, n)
    found = tangent_rotation(turned(n, 0, 0.02), inside, 0.02**2 * np.eye(3), [np.eye(3)])
    assert strangers.sum() > 0.1 * inside.sum()
    assert np.degrees(turn_between(found.rotation, START)) < 3.0


def test_the_best_of_several_starts_is_kept():
    n, inside = dome(96, elongation=1.2, bumps=0.15)
    wrong = [rotation_by(np.array([0.0, 0.9, 0.0])), -np.eye(3)]
    found = tangent_rotation(turned(n, 0, 0.01), inside, 1e-4 * np.eye(3), [*wrong, np.eye(3)])
    assert np.degrees(turn_between(found.rotation, START)) < 1.5


def test_the_twin_is_no_other_rotation_and_a_reflection_is():
    assert turn_between(START, TWIN @ START) == pytest.approx(0, abs=1e-6)
    assert turn_between(START, -START) == pytest.approx(np.pi)
    assert turn_between(START, np.eye(3)) == pytest.approx(np.linalg.norm([0.15, -0.1, 0.2]))


def test_scattered_pixels_have_no_tangents():
    inside = np.zeros((64, 64), bool)
    inside[::9, ::9] = True
    with pytest.raises(RecoveryFailure, match="too-scattered"):
        tangent_rotation(np.ones((64, 64, 3)), inside, np.eye(3), [np.eye(3)])


@needs_mozart
@pytest.mark.parametrize(("lights", "noise"), [("natural", 3e-4), ("natural", 3e-3), ("gels", 3e-4), ("gels", 3e-3)])
def test_robust_on_mozart_is_as_good_as_the_best_alignment(lights, noise):
    """Under natural lights at 3e-3 the weakest colour has as much noise as signal in every pixel: only means tell."""
    normals, mask, _ = mozart()
    observation, _ = shade(normals, mask, light_colours(lights), noise=noise, camera=CameraInfo(read_noise=noise))
    estimate = METHODS["robust"](observation)
    assert estimate.status == "ok"
    assert median_error(estimate, normals) < 1.1 * aligned_error(estimate, normals)
    stated = np.median(estimate.uncertainty_deg[estimate.valid])
    assert 0.7 < stated / median_error(estimate, normals) < 2
