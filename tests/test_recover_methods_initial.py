"""Which shell `auto` begins with."""

from functools import cache

import numpy as np
import pytest
from synthesis import dome, median_error, shade
from test_recover_interreflection_removal import ALBEDO, picture
from test_recover_methods import documented

from huesphere.recover.io.estimate import Estimate
from huesphere.recover.methods.initial import Restartable, initial_estimate, residual_is_white
from huesphere.recover.methods.robust import recover_robust_near
from huesphere.recover.methods.table import METHODS
from huesphere.recover.methods.weak import recover_weak_integrability_near
from huesphere.render.dataset import CameraInfo, Observation

pytestmark = pytest.mark.usefixtures("as_the_method_says")  # the verdict has tests of its own

NOISE = 1e-3
ROUND = np.arange(7) * 2 * np.pi / 7 + 0.3
TILT = np.radians(60 + 10 * np.cos(3 * ROUND))
TOWARD = np.stack([np.sin(TILT) * np.cos(ROUND), np.sin(TILT) * np.sin(ROUND), np.cos(TILT)], axis=-1)
COLOURS = np.random.default_rng(1).uniform(0.05, 1.0, (7, 3))
WEAK, ROBUST = METHODS["weak-integrability"], METHODS["robust"]
DOMINANT, HIDDEN = Restartable(WEAK, recover_weak_integrability_near), Restartable(ROBUST, recover_robust_near)


def not_asked(*_):
    pytest.fail("no other ellipsoid needs to be asked")


@cache
def seldom_all_lit() -> tuple[Observation, np.ndarray, np.ndarray, np.ndarray]:
    """(a dome of which three tenths see all of seven lights, its normals, which pixels these are, F)."""
    normals, mask = dome(96, elongation=1.15, cap=0.9)
    observation, F = shade(normals, mask, COLOURS, directions=TOWARD, noise=NOISE, camera=CameraInfo(read_noise=NOISE))
    return observation, normals, (normals @ TOWARD.T > 0).all(axis=-1) & mask, F


@cache
def automatic() -> Estimate:
    return METHODS["auto"](seldom_all_lit()[0])


def test_a_shell_whose_misfit_neighbours_share_gives_way_to_one_that_holds_noise_alone():
    observation, normals, all_lit, _ = seldom_all_lit()
    wrong = WEAK(observation)
    assert wrong.status == "ok"
    assert median_error(wrong, normals) > 10
    assert not residual_is_white(wrong, observation)
    first = initial_estimate(observation, DOMINANT, HIDDEN)
    assert first.method is HIDDEN
    assert residual_is_white(first.found, observation)
    assert all_lit[first.found.inlier].mean() > 0.9
    assert first.steps[0].startswith("ellipsoid: grown from patches")


def test_a_shell_that_noise_alone_is_left_of_stays():
    normals, mask = dome(96, elongation=1.15, cap=0.6)
    observation, _ = shade(normals, mask, COLOURS, directions=TOWARD, noise=NOISE, camera=CameraInfo(read_noise=NOISE))
    first = initial_estimate(observation, DOMINANT, Restartable(not_asked, not_asked))
    assert first.method is DOMINANT
    assert first.removal is None
    assert first.doubt is None


def test_a_shell_that_light_between_the_parts_explains_stays():
    observation, _, _ = picture(ALBEDO)
    assert not residual_is_white(WEAK(observation), observation)
    first = initial_estimate(observation, DOMINANT, HIDDEN)
    assert first.method is DOMINANT
    assert first.removal is not None
    assert first.removal.albedo == pytest.approx(ALBEDO, abs=0.05)


def test_a_shell_that_nothing_explains_is_given_with_a_doubt():
    """A surface of two materials: an ellipsoid each, none of them half of the object, and one between them."""
    normals, mask = dome(96, elongation=1.15, cap=0.6)
    observation, _ = shade(normals, mask, COLOURS, directions=TOWARD, noise=NOISE, camera=CameraInfo(read_noise=NOISE))
    row, column = np.mgrid[:96, :96]
    paint = 1 + 0.25 * np.sin(row / 4) * np.sin(column / 5)
    painted = Observation((observation.rgb * paint[..., None]).astype(np.float32), mask, observation.camera)
    estimate = METHODS["auto"](painted)
    assert estimate.status != "ok"
    assert estimate.message


@pytest.mark.slow
def test_auto_goes_on_from_it_to_every_pixel():
    observation, normals, _, _ = seldom_all_lit()
    estimate = automatic()
    mask = observation.mask
    assert estimate.status == "ok"
    assert estimate.valid[mask].all()
    assert median_error(estimate, normals) < 0.5 * median_error(WEAK(observation), normals)
    shares = estimate.diagnostics["knit"]
    assert set(shares) <= documented()["knit"]
    assert sum(shares.values()) == pytest.approx(1.0)
    assert shares["mapped"] + shares["missing_lights"] > 0.5
