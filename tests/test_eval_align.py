"""Alignment of normal maps: what an unknown rotation costs must come out exactly."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_eval_fabricated_run import rotation

from huesphere.eval.align import TWIN, best_orthogonal


def directions(count: int = 200, seed: int = 0) -> np.ndarray:
    n = np.random.default_rng(seed).normal(size=(count, 3))
    n[:, 2] = np.abs(n[:, 2])
    return n / np.linalg.norm(n, axis=1, keepdims=True)


@given(st.floats(-180, 180), st.floats(-180, 180), st.booleans(), st.integers(0, 50))
def test_any_orthogonal_transformation_is_undone(about_x: float, about_z: float, mirrored: bool, seed: int):
    truth = directions(seed=seed)
    turn = rotation("x", about_x) @ rotation("z", about_z) @ np.diag([1.0, 1.0, -1.0 if mirrored else 1.0])
    Q = best_orthogonal(truth @ turn.T, truth)
    np.testing.assert_allclose(Q, turn.T, atol=1e-12)


def test_a_proper_alignment_never_mirrors():
    truth = directions()
    Q = best_orthogonal(truth @ np.diag([1.0, 1.0, -1.0]), truth, proper=True)
    assert np.linalg.det(Q) == pytest.approx(1.0)


def test_the_alignment_is_orthogonal_for_normals_on_one_line():
    line = np.tile([0.0, 0.0, 1.0], (10, 1))
    Q = best_orthogonal(line, line)
    np.testing.assert_allclose(Q @ Q.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(line @ Q.T, line, atol=1e-12)


def test_the_twin_turns_slopes_over():
    p, q = 0.3, -0.7
    n = TWIN @ [-p, -q, 1.0]
    assert (-n[0] / n[2], -n[1] / n[2]) == (-p, -q)
