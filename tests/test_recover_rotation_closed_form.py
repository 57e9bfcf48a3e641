"""Root and closed form: report 2.1, 3.1–3.4, and the claims of 3.2."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from synthesis import TWIN, angles_deg, dome

from huesphere.recover.geometry.root import roots, symmetric_root
from huesphere.recover.geometry.rotations import rotation_by
from huesphere.recover.geometry.slopes import centred_differences
from huesphere.recover.rotation.closed_form import (
    best_angle,
    closed_form,
    rotation_at,
    smoothness_matrix,
    smoothness_matrix_on_background,
    third_row,
    third_row_on_background,
)
from huesphere.recover.status import RecoveryFailure


def ball(size: int, *, octant: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Normals and mask of a hemisphere that faces the camera, or of its octant x, y, z > 0."""
    row, column = np.mgrid[:size, :size]
    if octant:
        x, y = (column - 0.05 * size + 0.5) / (0.9 * size), (0.95 * size - row - 0.5) / (0.9 * size)
    else:
        x, y = (column - (size - 1) / 2) / (0.45 * size), ((size - 1) / 2 - row) / (0.45 * size)
    inside = x * x + y * y < 0.998
    if octant:
        inside &= (x > 0) & (y > 0)
    n = np.stack([x, y, np.sqrt(np.maximum(1 - x * x - y * y, 0))], axis=-1)
    return np.where(inside[..., None], n, 0.0), inside


def error_deg(normals: np.ndarray, N: np.ndarray, inside: np.ndarray, rotation: np.ndarray) -> float:
    """Median error of n = rotation · N, the better of the two twins."""
    n = N[inside] @ rotation.T
    return min(float(np.median(angles_deg(n @ T, normals[inside]))) for T in (np.eye(3), TWIN))


matrices = hnp.arrays(float, (3, 3), elements=st.floats(-1, 1)).filter(lambda a: abs(np.linalg.det(a)) > 1e-2)


@given(matrices)
def test_a_root_of_C_gives_C_back_in_both_handednesses(G):
    C = G.T @ G
    for root, sign in zip(roots(C), (1, -1)):
        assert root.T @ root == pytest.approx(C, abs=1e-12)
        assert np.sign(np.linalg.det(root)) == sign


@given(matrices)
def test_every_root_is_an_orthogonal_matrix_times_the_symmetric_one(G):
    R = G @ np.linalg.inv(symmetric_root(G.T @ G))
    assert pytest.approx(np.eye(3), abs=1e-9) == R @ R.T


def test_an_indefinite_C_has_no_root():
    with pytest.raises(ValueError, match="positive definite"):
        symmetric_root(np.diag([1.0, 1.0, -1.0]))


def test_derivatives_are_taken_where_the_whole_stencil_is_inside():
    image = np.arange(49.0).reshape(7, 7) ** 2
    inside = np.ones((7, 7), bool)
    inside[3, 3] = False
    image[3, 3] = 1e9
    dx, dy, where = centred_differences(image, inside)
    assert where.sum() == 25 - 5  # the centre and its four neighbours
    assert np.abs(dx).max() < 1e6
    assert np.abs(dy).max() < 1e6


def test_the_y_derivative_grows_upward():
    _, dy, where = centred_differences(np.arange(5.0)[:, None] * np.ones(5), np.ones((5, 5), bool))
    assert dy[where] == pytest.approx(-1.0)  # row 0 is the top row


@pytest.mark.parametrize("seed", range(3))
def test_hemisphere_facing_the_camera_is_exact(seed):  # report 3.2, first claim
    n, inside = ball(96)
    N = n @ rotation_by(np.random.default_rng(seed).normal(size=3)).T
    attitude = closed_form(N, inside)
    assert error_deg(n, N, inside, attitude.rotation) < 1e-4
    assert attitude.negative_share == 0
    assert attitude.rotation @ attitude.rotation.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(attitude.rotation) == pytest.approx(1)


def octant_errors(size: int) -> tuple[float, float, float]:
    """Error of r3 in degrees on an octant: alone, on a background of known normal, and of normal found with r3."""
    n, inside = ball(size, octant=True)
    R = rotation_by(np.array([0.3, -0.7, 0.4]))
    N, facing = n @ R.T, R @ [0.0, 0.0, 1.0]
    alone, negative, *_ = third_row(smoothness_matrix(N, inside), N, inside)
    assert negative == 0  # report 3.2: the de-rotated n3 are all positive
    known, *_ = third_row(smoothness_matrix_on_background(N, inside, ~inside, facing), N, inside)
    found = third_row_on_background(N, inside, ~inside)
    return tuple(float(angles_deg(r, facing)) for r in (alone, known, found))


@pytest.mark.parametrize("size", [64, 160])
def test_octant_is_biased_and_a_black_background_helps(size):  # report 3.2, second and third claim
    alone, known, found = octant_errors(size)
    assert alone > 5
    assert known < alone - 10
    assert found < alone - 2


def test_alpha_is_where_the_integral_is_least():  # Eq. (18)
    n, inside = dome(64, elongation=1.3, bumps=0.2)
    N = n @ rotation_by(np.array([0, 0, 0.6])).T
    r3 = np.array([0.0, 0, 1])
    both = [best_angle(N, inside, r3, u1) for u1 in (np.array([1.0, 0, 0]), np.array([0, 1.0, 0]))]
    best = min(both, key=lambda angle: angle.integral)
    alpha = np.linspace(0, np.pi, 2001)
    assert best.integral <= min(angle.integral_at(alpha).min() for angle in both) + 1e-12
    assert error_deg(n, N, inside, rotation_at(best, r3)) < 0.1


@given(st.floats(-3, 3), st.floats(0.5, 3))
def test_alpha_solves_equation_19_in_the_first_quadrant(turn, elongation):
    n, inside = dome(24, elongation=elongation, bumps=0.3, cap=0.7)
    angle = best_angle(
        n @ rotation_by(np.array([0.2, 0.1, turn])).T, inside, np.array([0, 0, 1.0]), np.array([1.0, 0, 0])
    )
    assert 0 <= angle.alpha < np.pi / 2
    assert abs(angle.condition(np.array(angle.alpha))) <= 1e-12 * max(1.0, *map(abs, angle.abc))


def test_equation_19_is_half_the_slope_of_equation_18():
    n, inside = dome(48, elongation=1.3, bumps=0.2)
    N = n @ rotation_by(np.array([0.1, 0.2, 0.7])).T
    angle = best_angle(N, inside, np.array([0, 0, 1.0]), np.array([1.0, 0, 0]))
    assert abs(angle.abc[2]) > 0.1 * abs(angle.abc[1])  # else the next line says little
    alpha, step = np.linspace(0, np.pi / 2, 50), 1e-5
    slope = (angle.integral_at(alpha + step) - angle.integral_at(alpha - step)) / (2 * step)
    assert angle.condition(alpha) == pytest.approx(slope / 2, abs=1e-8)


def test_the_twin_is_as_integrable():
    n, inside = dome(64, elongation=1.3, bumps=0.2)
    a, b = (closed_form(normals, inside) for normals in (n, n @ TWIN))
    assert a.integral == pytest.approx(b.integral, rel=1e-9)


def test_lone_pixels_are_too_scattered():
    n, inside = ball(32)
    inside[::2] = False
    with pytest.raises(RecoveryFailure, match="too-scattered"):
        closed_form(n, inside)
