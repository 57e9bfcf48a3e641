"""Slopes of a surface: derivatives of normals and slopes against differences, for parallel and converging rays."""

import numpy as np
import pytest

from huesphere.recover.geometry.rays import of_relief
from huesphere.recover.geometry.rotations import rotation_by
from huesphere.recover.geometry.slopes import (
    centred_differences,
    normals_by_slopes,
    normals_of_slopes,
    slopes_by_rotation,
)

RNG = np.random.default_rng(0)
SLOPE = RNG.normal(size=(30, 2))
RAYS = {"parallel": np.zeros((30, 2)), "perspective": 0.3 * RNG.normal(size=(30, 2))}


def slopes_of(n, ray):
    m = of_relief(n, ray)
    return -m[:, :2] / m[:, 2:]


@pytest.mark.parametrize("ray", RAYS.values(), ids=RAYS)
def test_slopes_and_normals_are_each_others_inverse(ray):
    n = normals_of_slopes(SLOPE, ray)
    assert np.linalg.norm(n, axis=1) == pytest.approx(1)
    assert slopes_of(n, ray) == pytest.approx(SLOPE)


@pytest.mark.parametrize("ray", RAYS.values(), ids=RAYS)
@pytest.mark.parametrize("axis", [0, 1])
def test_normals_change_by_slopes_as_differences_say(ray, axis):
    step = 1e-6 * np.eye(2)[axis]
    differences = (normals_of_slopes(SLOPE + step, ray) - normals_of_slopes(SLOPE - step, ray)) / 2e-6
    assert normals_by_slopes(SLOPE, ray)[..., axis] == pytest.approx(differences, abs=1e-8)


@pytest.mark.parametrize("ray", RAYS.values(), ids=RAYS)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_slopes_change_by_rotations_as_differences_say(ray, axis):
    slope = np.clip(SLOPE, -1, 1)  # far from edge on, where differences are no derivatives
    n, turn = normals_of_slopes(slope, ray), 1e-6 * np.eye(3)[axis]
    differences = (slopes_of(n @ rotation_by(turn).T, ray) - slopes_of(n @ rotation_by(-turn).T, ray)) / 2e-6
    assert slopes_by_rotation(slope, ray)[..., axis] == pytest.approx(differences, abs=1e-7)


def test_no_ray_means_parallel_rays():
    assert slopes_by_rotation(SLOPE, None) == pytest.approx(slopes_by_rotation(SLOPE, RAYS["parallel"]))


def test_centred_differences_are_exact_for_a_parabola_and_y_points_up():
    row, column = np.mgrid[:6, :7].astype(float)
    image = column**2 - 3 * row + 2 * row * column
    dx, dy, where = centred_differences(image, np.ones(image.shape, bool))
    assert where.sum() == 4 * 5
    assert dx[where] == pytest.approx((2 * column + 2 * row)[where])
    assert dy[where] == pytest.approx((3 - 2 * column)[where])
    assert (dx[~where] == 0).all()
