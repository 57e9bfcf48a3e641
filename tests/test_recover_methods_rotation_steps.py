"""The rotation of `weak-integrability`, and what the silhouette adds to it."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from huesphere.recover.cues.silhouette import SilhouetteRotation
from huesphere.recover.geometry.rotations import turn_between
from huesphere.recover.methods.records import FittedRotation
from huesphere.recover.methods.rotation_steps import with_silhouette

TRUE = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix()
SILHOUETTE = SilhouetteRotation(TRUE, np.eye(3) / np.radians(2.0) ** 2)


def turned(degrees: float, stderr_deg: float) -> FittedRotation:
    """A rotation so far from TRUE, with that standard error about each axis."""
    matrix = Rotation.from_rotvec(np.radians(degrees) * np.array([0.6, 0.8, 0.0])).as_matrix() @ TRUE
    return FittedRotation(matrix, np.radians(stderr_deg) ** 2 * np.eye(3), converged=True)


@pytest.mark.parametrize("stderr_deg", [2.0, 6.0])
def test_an_uncertain_rotation_is_the_mean_of_both_by_their_precision(stderr_deg):
    first = turned(4.0, stderr_deg)
    found = with_silhouette(first, SILHOUETTE)
    share = 2.0**2 / (2.0**2 + stderr_deg**2)
    assert np.degrees(turn_between(found.matrix, TRUE)) == pytest.approx(4.0 * share, rel=1e-3)
    assert np.degrees(np.sqrt(np.trace(found.covariance) / 3)) == pytest.approx(2.0 * np.sqrt(1 - share), rel=1e-3)


def test_a_certain_rotation_stays_as_it_is():
    first = turned(4.0, 0.5)
    assert with_silhouette(first, SILHOUETTE) is first
    assert with_silhouette(turned(4.0, 5.0), None).matrix == pytest.approx(turned(4.0, 5.0).matrix)


def test_two_rotations_that_contradict_each_other_are_less_certain_together():
    close, far = (with_silhouette(turned(off, 5.0), SILHOUETTE) for off in (4.0, 40.0))
    assert np.trace(far.covariance) > 4 * np.trace(close.covariance)


def test_the_other_of_the_two_solutions_is_meant_as_well_and_a_mirrored_one_is_not():
    first = turned(4.0, 6.0)
    other = with_silhouette(first.twin(), SILHOUETTE)
    assert turn_between(other.matrix, with_silhouette(first, SILHOUETTE).twin().matrix) < 1e-6
    mirrored = FittedRotation(-first.matrix, first.covariance, converged=True)
    assert with_silhouette(mirrored, SILHOUETTE) is mirrored
