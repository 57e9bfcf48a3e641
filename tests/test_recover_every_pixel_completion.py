"""Every pixel's uncertainty: noise by the matrix of the lights that the pixel sees, and the rotation common to all."""

import numpy as np
import pytest
from synthesis import angles_deg, dome, problem_of_colours, shade, solution_of

from huesphere.recover.every_pixel.completion import complete
from huesphere.recover.every_pixel.parameters import EVERY_PIXEL
from huesphere.recover.reasons import Reason

NOISE = 2e-3
TOWARD = np.array([[0.6, 0.2, 1.0], [-0.5, 0.4, 1.0], [0.0, -0.6, 1.0]])
TOWARD /= np.linalg.norm(TOWARD, axis=1, keepdims=True)
COLOURS = np.array([[1.0, 0.2, 0.15], [0.15, 1.0, 0.25], [0.2, 0.15, 1.0]])


def completed(turn_deg: float, *, noise: float = NOISE, missed: bool = False):
    """(completion, normals, mask, a patch) of a shallow dome that sees every light; no light is known by itself.

    In the patch, if ``missed``, something hides the third light.
    """
    normals, mask = dome(64, cap=0.5)
    patch = np.zeros(mask.shape, bool)
    patch[24:34, 24:34] = True
    hidden = np.zeros((*mask.shape, 3), bool)
    hidden[patch, 2] = missed
    observation, F = shade(normals, mask, COLOURS, directions=TOWARD, hidden=hidden, noise=noise)
    problem = problem_of_colours(observation.rgb, mask, noise)
    solution = solution_of(F, mask & ~patch if missed else mask, turn_deg)
    return complete(problem, solution, search=False), normals, mask, patch


def test_the_rotations_error_is_in_every_pixels_uncertainty():
    """It is common to all pixels and independent of their noise: squares add."""
    turn = 2.0
    (without, _, mask, _), (with_turn, *_) = completed(0.0), completed(turn)
    added = np.sqrt(with_turn.uncertainty_deg[mask] ** 2 - without.uncertainty_deg[mask] ** 2)
    np.testing.assert_allclose(added, with_turn.solution.rotation_stderr_deg, rtol=1e-6)
    assert with_turn.solution.rotation_stderr_deg == pytest.approx(np.sqrt(3) * turn)


def test_without_an_error_of_the_rotation_the_uncertainty_is_that_of_noise():
    found, normals, mask, _ = completed(0.0)
    assert (found.reason[mask] == Reason.ALL_LIT).all()
    error = angles_deg(found.normals[mask], normals[mask]).mean()
    assert 1.0 < found.uncertainty_deg[mask].mean() / error < 1.6  # residuals count besides noise: rather too careful


def test_twice_the_noise_is_twice_the_uncertainty():
    once, twice = (completed(0.0, noise=noise) for noise in (NOISE, 2 * NOISE))
    mask = once[2]
    assert np.median(twice[0].uncertainty_deg[mask] / once[0].uncertainty_deg[mask]) == pytest.approx(2.0, rel=0.05)


def test_a_pixel_that_nothing_explains_has_the_error_of_interpolation():
    found, _, mask, patch = completed(0.0, missed=True)
    inner = np.zeros_like(patch)
    inner[26:32, 26:32] = True
    assert (found.uncertainty_deg[inner] == EVERY_PIXEL.interpolated_error_deg).all()
    assert found.uncertainty_deg[mask & ~patch].max() < 3.0
    assert np.isnan(found.uncertainty_deg[~mask]).all()


def test_no_uncertainty_exceeds_that_of_interpolation():
    found, _, mask, _ = completed(40.0)
    assert (found.uncertainty_deg[mask] == EVERY_PIXEL.interpolated_error_deg).all()
