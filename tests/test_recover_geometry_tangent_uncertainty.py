"""The stated angular error of a normal, against the errors that noise and a common rotation make."""

import numpy as np
import pytest
from synthesis import angles_deg

from huesphere.recover.geometry.rotations import rotation_by
from huesphere.recover.geometry.tangent_uncertainty import normal_uncertainty_deg, tangent_frames

M = np.array([[1.6, 0.3, -0.2], [0.1, 2.1, 0.4], [-0.5, 0.2, 1.2]])  # from colours to normals
NORMAL = np.array([0.3, -0.5, np.sqrt(1 - 0.34)])
NONE = np.zeros((3, 3))


def stated(length: float, colour: np.ndarray, rotation: np.ndarray, normal: np.ndarray = NORMAL) -> float:
    return float(normal_uncertainty_deg(normal[None], np.array([length]), M, colour, rotation)[0])


@pytest.mark.parametrize("length", [0.3, 1.0, 2.5])
def test_the_error_that_noise_makes_is_in_inverse_proportion_to_the_brightness(length):
    """A pixel whose M rho is short, as in half shadow, has the same noise over less colour."""
    sigma, rng = 0.002, np.random.default_rng(0)
    rho = np.linalg.solve(M, length * NORMAL)
    noisy = (rho + sigma * rng.standard_normal((60_000, 3))) @ M.T
    noisy /= np.linalg.norm(noisy, axis=1, keepdims=True)
    error = angles_deg(noisy, NORMAL).mean()
    assert stated(length, sigma**2 * np.eye(3), NONE) == pytest.approx(error, rel=0.02)


def test_noise_alike_in_all_channels_of_normals_gives_the_mean_of_a_rayleigh_distribution():
    """E|v| = σ √(π/2) of two equal independent Gaussians, here σ over the length of M rho."""
    sigma, length = 1e-3, 0.4
    colour = sigma**2 * np.linalg.inv(M) @ np.linalg.inv(M).T  # so that M rho has covariance sigma² 1
    assert stated(length, colour, NONE) == pytest.approx(np.degrees(sigma / length * np.sqrt(np.pi / 2)), rel=1e-9)


def test_the_error_that_a_common_rotation_makes_does_not_depend_on_the_brightness():
    covariance = np.radians(0.5) ** 2 * np.array([[1.0, 0.3, 0.0], [0.3, 2.0, -0.4], [0.0, -0.4, 0.5]])
    rng = np.random.default_rng(0)
    turns = rng.multivariate_normal(np.zeros(3), covariance, 4000)
    error = angles_deg(np.stack([rotation_by(turn) @ NORMAL for turn in turns]), NORMAL).mean()
    assert stated(1.0, NONE, covariance) == pytest.approx(error, rel=0.03)
    assert stated(0.2, NONE, covariance) == pytest.approx(stated(1.0, NONE, covariance), rel=1e-9)


def test_a_rotation_about_the_normal_does_not_move_it():
    assert stated(1.0, NONE, 0.01 * np.outer(NORMAL, NORMAL)) == pytest.approx(0.0, abs=1e-6)


def test_both_errors_add_in_squares_where_each_is_the_same_in_all_directions():
    colour = 1e-6 * np.linalg.inv(M) @ np.linalg.inv(M).T
    rotation = np.radians(0.1) ** 2 * np.eye(3)
    both = stated(0.5, colour, rotation)
    assert both == pytest.approx(np.hypot(stated(0.5, colour, NONE), stated(0.5, NONE, rotation)), rel=1e-9)


def test_an_error_along_one_tangent_and_one_along_another_add_as_they_point():
    """Noise across the view and a rotation about an oblique axis: the expected length depends on how they lie."""
    first, second = tangent_frames(NORMAL[None])
    along = (first[0] + second[0]) / np.sqrt(2)
    noise_along = 1e-6 * np.outer(along, along)
    colour = np.linalg.inv(M) @ noise_along @ np.linalg.inv(M).T
    for sign in (1.0, -1.0):
        axis = np.cross(NORMAL, first[0] + sign * second[0]) / np.sqrt(2)  # moves the normal along first ± second
        both = stated(1.0, colour, 1e-6 * np.outer(axis, axis))
        one = np.degrees(1e-3 * np.sqrt(2 / np.pi))  # E|x| of one Gaussian
        wanted = np.sqrt(2) * one if sign > 0 else np.degrees(1e-3 * np.sqrt(np.pi / 2))
        assert both == pytest.approx(wanted, rel=1e-6)


def test_tangent_frames_are_right_handed_with_the_normal_and_orthonormal():
    n = np.random.default_rng(0).standard_normal((200, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    n = n[n[:, 2] > -0.99]
    first, second = tangent_frames(n)
    frame = np.stack([first, second, n], axis=1)
    np.testing.assert_allclose(frame @ frame.swapaxes(1, 2), np.broadcast_to(np.eye(3), frame.shape), atol=1e-9)
    np.testing.assert_allclose(np.cross(first, second), n, atol=1e-9)
