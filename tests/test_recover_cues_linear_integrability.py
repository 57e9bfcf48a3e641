"""Integrability that is linear in the rotation: its curl is small for surfaces only, and its rotations are right."""

import numpy as np
import pytest
from synthesis import TWIN, dome

from huesphere.recover.cues.linear_integrability import (
    curl_under_rotation,
    judge_integrability,
    likely_rotations,
    off_axis_deg,
)
from huesphere.recover.geometry.root import symmetric_root
from huesphere.recover.geometry.rotations import rotation_by

NORMALS, MASK = dome(96, elongation=1.2, bumps=0.2, cap=0.85)
F = np.array([[0.50, 0.20, 0.70], [-0.30, 0.40, 0.60], [0.10, -0.45, 0.55]])
C = np.linalg.inv(F @ F.T)
RGB = np.where(MASK[..., None], NORMALS @ F.T, 0.0)
ROTATION = np.linalg.inv(symmetric_root(C) @ F)  # n = R C^½ ρ, Eqs. (11), (12)
WRONG = C + 0.5 * np.linalg.norm(C) * np.diag([1.0, 0.0, 0.0])


def angle_deg(A: np.ndarray, B: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip((np.trace(A @ B.T) - 1) / 2, -1, 1))))


def test_the_normals_of_a_surface_are_integrable_under_its_rotation():
    assert curl_under_rotation(ROTATION, RGB, MASK, C) < 0.03
    assert curl_under_rotation(TWIN @ ROTATION, RGB, MASK, C) < 0.03  # the convex/concave ambiguity


def test_under_another_rotation_they_are_not():
    right = curl_under_rotation(ROTATION, RGB, MASK, C)
    for vector in ([0.4, 0.0, 0.0], [0.0, 0.4, 0.0], [0.0, 0.0, 0.4]):
        assert curl_under_rotation(rotation_by(np.array(vector)) @ ROTATION, RGB, MASK, C) > 4 * right


def test_the_right_ellipsoid_is_integrable_and_a_wrong_one_is_less_so():
    right, wrong = (judge_integrability(RGB, MASK, one, noise=1e-3) for one in (C, WRONG))
    assert right.frontal
    assert right.curl < 0.05
    assert right.off_axis_deg < 5
    assert wrong.curl > 2 * right.curl or not wrong.frontal


def test_the_curl_of_the_best_rotation_is_no_larger_than_that_of_the_true_one():
    judgement = judge_integrability(RGB, MASK, C, noise=1e-3)
    assert judgement.curl < curl_under_rotation(ROTATION, RGB, MASK, C) + 0.02  # r3 is on a grid of 6°


def test_one_of_the_likely_rotations_is_right_or_its_twin():
    found = likely_rotations(RGB, MASK, C, noise=1e-3, count=3)
    best = min(angle_deg(R, turn @ ROTATION) for R in found for turn in (np.eye(3), TWIN))
    assert best < 8
    for R in found:
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-9)


def test_likely_rotations_are_as_many_of_either_chirality_and_apart():
    found = likely_rotations(RGB, MASK, C, noise=1e-3, count=3)
    chirality = np.array([np.linalg.det(R) for R in found])
    assert (chirality > 0).sum() == (chirality < 0).sum()
    for sign in (1, -1):
        r3 = np.array([R[2] for R, det in zip(found, chirality) if det * sign > 0])
        cosine = np.abs(r3 @ r3.T)[np.triu_indices(len(r3), 1)]
        assert (np.degrees(np.arccos(np.minimum(cosine, 1))) >= 12.0 - 1e-6).all()


def test_normals_over_the_whole_sphere_face_no_camera():
    rng = np.random.default_rng(0)
    n = rng.standard_normal((60, 60, 3))
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    judgement = judge_integrability(n, np.ones((60, 60), bool), np.eye(3), noise=1e-3)
    assert not judgement.frontal
    assert judgement.curl == 1.0


def test_too_few_pixels_are_as_bad_as_chance():
    few = np.zeros_like(MASK)
    few[45:49, 45:49] = True
    assert judge_integrability(RGB, few, C, noise=1e-3).curl == 1.0
    assert curl_under_rotation(ROTATION, RGB, few, C) == 1.0
    assert likely_rotations(RGB, few, C, noise=1e-3, count=3) == []


def test_exposure_changes_nothing():
    one, other = judge_integrability(RGB, MASK, C, noise=1e-3), judge_integrability(5 * RGB, MASK, C / 25, noise=5e-3)
    assert (other.curl, other.normalised_curl, other.off_axis_deg) == pytest.approx(
        (one.curl, one.normalised_curl, one.off_axis_deg), rel=1e-6
    )


def test_the_off_axis_angle_is_that_of_the_nearest_few():
    cosine = np.cos(np.radians([50.0, 10.0, 20.0, 30.0, 40.0]))
    assert off_axis_deg(cosine, fewest=1) == pytest.approx(10.0)
    assert off_axis_deg(cosine) == pytest.approx(30.0)
    assert off_axis_deg(np.cos(np.radians(np.arange(1, 1001) / 20))) == pytest.approx(4 / 20)  # 0.4 % of 1000
