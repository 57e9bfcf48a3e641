"""Labels that geometry forbids: a colour may fit a set of lights that the normal it gives would see from behind."""

import numpy as np
import pytest
from synthesis import problem_of_colours
from test_recover_lights_from_shadows import COLOURS, TOWARD, F, angle_deg, wide_picture

from huesphere.recover.every_pixel.by_light_sets import LabelledPixels, label_by_light_sets
from huesphere.recover.lights.model import Light, Lights

PATCH = (slice(50, 58), slice(50, 58))  # in the middle of the dome, where all lights are seen


@pytest.fixture(scope="module")
def picture():
    return wide_picture()


def painted(picture, n: np.ndarray, missed: tuple[int, ...]) -> LabelledPixels:
    """The labels of the dome with a patch of the colour of ``n`` (3,).

    The colour is that of a pixel that misses the lights ``missed`` and sees the others from either side.
    """
    observation, normals, lit, scale = picture
    M = F - sum((np.outer(COLOURS[j], TOWARD[j]) for j in missed), np.zeros((3, 3)))
    rgb = observation.rgb.astype(np.float64)
    rgb[PATCH] = scale * M @ n
    start = np.where((observation.mask & lit.all(axis=-1))[..., None], normals, np.nan)
    start[PATCH] = np.nan
    lights = Lights(tuple(Light(a, scale * b, 100, 0.0, 1.0) for a, b in zip(TOWARD, COLOURS)), 0.0)
    return label_by_light_sets(problem_of_colours(rgb, observation.mask), start, scale * F, lights)


def direction(around_deg: float, z: float) -> np.ndarray:
    around, across = np.radians(around_deg), np.sqrt(1 - z * z)
    return np.array([across * np.cos(around), across * np.sin(around), z])


def assert_unexplained(labelled: LabelledPixels) -> None:
    assert not labelled.explained[PATCH].any()
    assert (labelled.missed[PATCH] == -1).all()
    assert (labelled.normals[PATCH][..., 2] > 0.3).all()


def test_a_possible_label_is_taken(picture):
    """The same colours with nothing against them: a light that the surface faces, behind something."""
    n = direction(310.0, 0.8)
    assert (TOWARD @ n > 0).all()
    labelled = painted(picture, n, (0,))
    assert (labelled.missed[PATCH] == 0b1).all()
    assert angle_deg(labelled.normals[PATCH], n).max() < 0.1


def test_no_label_turns_a_pixel_away_from_the_camera(picture):
    n = direction(207.0, -0.08)
    assert (TOWARD[1:] @ n > 0).all()
    assert_unexplained(painted(picture, n, (0,)))


def test_no_label_has_a_light_seen_from_behind(picture):
    n = direction(290.0, 0.3)
    assert TOWARD[1] @ n < -0.2
    assert (TOWARD[[0, 2, 3]] @ n > 0).all()
    assert_unexplained(painted(picture, n, (0,)))


@pytest.mark.xfail(strict=True, reason="the cost of one light seen from behind does not exceed the limit on costs")
def test_no_pixel_is_all_lit_that_would_see_a_light_from_behind(picture):
    assert_unexplained(painted(picture, direction(290.0, 0.3), ()))
