"""Which shell `auto` begins with, and what it does with the pixels that no light found explains."""

from functools import cache

import numpy as np
import pytest
from synthesis import angles_deg, dome, median_error, shade
from test_recover_interreflection_removal import ALBEDO, picture
from test_recover_methods import documented

from huesphere.recover.every_pixel.by_irradiance_map import by_map
from huesphere.recover.every_pixel.by_light_sets import knit
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.lights.model import Lights
from huesphere.recover.methods.initial import first_shell, settled
from huesphere.recover.methods.table import METHODS
from huesphere.recover.pixels.usable import usable_pixels
from huesphere.render.dataset import CameraInfo, Observation

NOISE = 1e-3
ROUND = np.arange(7) * 2 * np.pi / 7 + 0.3
TILT = np.radians(60 + 10 * np.cos(3 * ROUND))
TOWARD = np.stack([np.sin(TILT) * np.cos(ROUND), np.sin(TILT) * np.sin(ROUND), np.cos(TILT)], axis=-1)
COLOURS = np.random.default_rng(1).uniform(0.05, 1.0, (7, 3))
DOMINANT, HIDDEN = METHODS["weak-integrability"], METHODS["robust"]


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
    wrong = DOMINANT(observation)
    assert wrong.status == "ok"
    assert median_error(wrong, normals) > 10
    assert not settled(wrong, observation)
    steps: list[str] = []
    first = first_shell(observation, DOMINANT, HIDDEN, steps)
    assert first.method is HIDDEN
    assert settled(first.found, observation)
    assert all_lit[first.found.inlier].mean() > 0.9
    assert steps[0].startswith("shell: grown from patches")


def test_a_shell_that_noise_alone_is_left_of_stays():
    normals, mask = dome(96, elongation=1.15, cap=0.6)
    observation, _ = shade(normals, mask, COLOURS, directions=TOWARD, noise=NOISE, camera=CameraInfo(read_noise=NOISE))
    first = first_shell(observation, DOMINANT, lambda _: pytest.fail("no other shell needs to be asked"), [])
    assert first.method is DOMINANT
    assert first.removed is None
    assert first.doubt is None


def test_a_shell_that_light_between_the_parts_explains_stays():
    observation, _, _ = picture(ALBEDO)
    assert not settled(DOMINANT(observation), observation)
    first = first_shell(observation, DOMINANT, HIDDEN, [])
    assert first.method is DOMINANT
    assert first.removed is not None
    assert first.removed.albedo == pytest.approx(ALBEDO, abs=0.05)


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
    assert median_error(estimate, normals) < 0.5 * median_error(DOMINANT(observation), normals)
    shares = estimate.diagnostics["knit"]
    assert set(shares) <= documented()["knit"]
    assert sum(shares.values()) == pytest.approx(1.0)
    assert shares["mapped"] + shares["missing_lights"] > 0.5


def test_a_map_of_the_normal_is_nearer_than_the_surface_between():
    """From the true F and the pixels that see every light, no light known by itself."""
    observation, normals, all_lit, F = seldom_all_lit()
    pixels, none = usable_pixels(observation), Lights((), 1.0)
    start = np.where(all_lit[..., None], normals, np.nan)
    knitted = knit(pixels.rgb, pixels.usable, pixels.mask, start, F, none, NOISE)
    mapped, told = by_map(knitted, pixels, all_lit, F, np.zeros_like(pixels.rgb), NOISE, None)
    where = mapped.mapped
    before, after = (angles_deg(one.normals[where], normals[where]).mean() for one in (knitted, mapped))
    assert where.sum() > 0.2 * pixels.mask.sum()
    assert not (where & (mapped.explained | mapped.between)).any()
    assert after < 0.7 * before
    assert told["irradiance"]["explained"] > 0.75
    same = pixels.mask & ~where & ~mapped.between
    assert (mapped.normals[same] == knitted.normals[same]).all()


def test_a_map_is_not_made_where_all_pixels_see_every_light():
    normals, mask = dome(64, cap=0.3)
    observation, F = shade(normals, mask, COLOURS, directions=TOWARD)
    pixels = usable_pixels(observation)
    start = np.where(mask[..., None], normals, np.nan)
    knitted = knit(pixels.rgb, pixels.usable, mask, start, F, Lights((), 1.0), 0.0)
    mapped, told = by_map(knitted, pixels, mask, F, np.zeros_like(pixels.rgb), 0.0, None)
    assert mapped is knitted
    assert told == {}
