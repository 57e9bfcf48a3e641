"""Lights of a noisy picture found together with the surface, and what `robust` and `auto` make of them."""

from functools import cache

import numpy as np
import pytest
from synthesis import angles_deg, dome, shade
from test_recover_methods import documented
from test_recover_methods_initial import COLOURS, HIDDEN, NOISE, TOWARD, automatic, seldom_all_lit

from huesphere.recover.every_pixel.by_joint_lights import knit_lit, lights_of
from huesphere.recover.geometry.slopes import normals_by_slopes, normals_of_slopes
from huesphere.recover.geometry.sphere import fibonacci
from huesphere.recover.lights.bundle_adjustment import Bundle, F_by_lights, Lit, across, expected
from huesphere.recover.lights.lit_surface import LitSurface, lit_surface
from huesphere.recover.lights.search import LEFT_OVER, whole_picture
from huesphere.recover.methods.table import LARGEST_TURN_DEG
from huesphere.render.dataset import CameraInfo

OFF_DEG = 6.0  # that F is turned by, to begin with
DOUBT = np.radians(OFF_DEG) ** 2 * np.eye(3)


def turned(F: np.ndarray, degrees: float) -> np.ndarray:
    """F (3, 3) of normals that come out turned by so much about an axis across the view."""
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return F @ np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])


@cache
def found() -> LitSurface:
    observation, _, all_lit, F = seldom_all_lit()
    return lit_surface(observation.rgb, observation.mask, all_lit, turned(F, OFF_DEG), DOUBT, NOISE)


def test_the_lights_are_found_in_noise_and_undo_the_turn_of_what_was_known():
    _, normals, all_lit, F = seldom_all_lit()
    surface = found()
    cosine = TOWARD @ surface.toward.T
    assert np.degrees(np.arccos(np.clip(cosine.max(axis=1), -1, 1))).max() < 4.0  # every light that there is
    n = normals[all_lit]
    again = n @ F.T @ np.linalg.inv(surface.F).T
    assert np.median(angles_deg(again / np.linalg.norm(again, axis=1, keepdims=True), n)) < 1.0
    assert surface.explained > 0.9
    assert surface.loss < LEFT_OVER


def test_the_surface_is_right_where_no_light_is_seen_by_all():
    observation, normals, all_lit, _ = seldom_all_lit()
    others = observation.mask & ~all_lit
    assert np.median(angles_deg(found().normals[others], normals[others])) < 1.5
    assert np.isnan(found().normals[~observation.mask]).all()


def test_colours_come_in_the_units_of_the_picture():
    observation, _, all_lit, F = seldom_all_lit()
    dark = lit_surface(observation.rgb / 8, observation.mask, all_lit, turned(F, OFF_DEG) / 8, DOUBT, NOISE / 8)
    np.testing.assert_allclose(dark.F * 8, found().F, rtol=1e-6)
    np.testing.assert_allclose(dark.covariance * 64, found().covariance, rtol=1e-5)


def test_a_picture_that_no_lights_make_is_not_believed():
    observation, _, all_lit, F = seldom_all_lit()
    rng = np.random.default_rng(3)
    patchy = np.kron(rng.uniform(0.3, 1.0, (12, 12, 3)), np.ones((8, 8, 1)))  # paint of many colours
    by_all, told = whole_picture(observation.rgb * patchy, observation.mask, observation.mask, all_lit, F, DOUBT, NOISE)
    assert by_all is None
    assert not told["used"]
    assert told["loss"] > LEFT_OVER


def test_what_is_believed_brings_its_pixels_and_how_sure_they_are():
    observation, normals, all_lit, F = seldom_all_lit()
    mask = observation.mask
    by_all, told = whole_picture(observation.rgb, mask, mask, all_lit, turned(F, OFF_DEG), DOUBT, NOISE)
    assert by_all is not None
    assert told["turned_deg"] == pytest.approx(OFF_DEG, abs=1.0)
    assert all_lit[by_all.all_lit].mean() > 0.9
    assert by_all.all_lit[all_lit].mean() > 0.8
    stderr = np.degrees(np.sqrt(np.trace(by_all.covariance)))
    n = normals[all_lit]
    again = n @ F.T @ np.linalg.inv(by_all.F).T
    error = np.median(angles_deg(again / np.linalg.norm(again, axis=1, keepdims=True), n))
    assert error / 3 < stderr < 3.0


def test_robust_asks_the_whole_picture_where_the_rotation_is_in_doubt():
    normals, mask = dome(96, elongation=1.2, cap=0.85, bumps=0.25)
    mask[:, :30] = False  # the rest of an object: its outline is no rim
    noise = 3e-3
    camera = CameraInfo(read_noise=noise)
    observation, _ = shade(normals, mask, COLOURS, directions=TOWARD, noise=noise, camera=camera)
    estimate = HIDDEN(observation)
    told = estimate.diagnostics["whole_picture"]
    assert told["used"]
    assert set(told) <= documented()["whole_picture"]
    assert estimate.status == "ok"
    assert told["first_rotation_stderr_deg"] > LARGEST_TURN_DEG > estimate.diagnostics["rotation_stderr_deg"]
    assert np.median(angles_deg(estimate.normals[estimate.valid], normals[estimate.valid])) < 4.0  # 2 of single pixels
    F = np.array(estimate.diagnostics["F"])
    np.testing.assert_allclose(np.linalg.inv(F @ F.T), estimate.diagnostics["C"], rtol=1e-6)


def test_auto_gives_every_pixel_by_lights_found_together():
    observation, normals, _, _ = seldom_all_lit()
    estimate = automatic()
    assert estimate.status == "ok"
    assert estimate.diagnostics["whole_picture"]["used"]
    assert len(estimate.diagnostics["lights"]["found"]) >= len(TOWARD)
    shares = estimate.diagnostics["knit"]
    assert shares["missing_lights"] > 0.6
    error = angles_deg(estimate.normals[observation.mask], normals[observation.mask])
    assert np.median(error) < 1.5
    assert error.mean() < 2.5


def test_a_pixel_in_the_cast_shadow_of_one_light_is_told_so():
    observation, normals, _, _ = seldom_all_lit()
    truth = LitSurface(TOWARD, COLOURS, COLOURS.T @ TOWARD, normals, 1.0, 0.0, np.zeros((9, 9)))
    cosine = normals @ TOWARD.T
    seen = cosine > 0
    shadow = np.zeros(observation.mask.shape, bool)
    shadow[44:50, 44:50] = True
    seen[shadow, 2] = False
    rgb = np.where(observation.mask[..., None], np.where(seen, cosine, 0.0) @ COLOURS, 0.0)
    knitted = knit_lit(rgb, observation.mask, observation.mask, truth, NOISE)
    assert knitted.explained[observation.mask].all()
    wanted = ~seen @ (1 << np.arange(len(TOWARD)))
    assert (knitted.off[shadow] == wanted[shadow]).all()
    assert np.max(angles_deg(knitted.normals[shadow], normals[shadow])) < 0.1
    light = lights_of(truth, knitted).found[2]
    assert light.support == (~seen[..., 2] & observation.mask).sum()
    assert 0 < light.attached < 1


def test_derivatives_are_those_of_the_colours():
    rng = np.random.default_rng(0)
    toward, colour = fibonacci(40)[:3], rng.uniform(0.1, 1.0, (3, 3))

    def F_of(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return (b.T @ (a / np.linalg.norm(a, axis=1, keepdims=True))).ravel()

    change, step = F_by_lights(Lit(np.zeros((1, 2)), toward, colour, 0.0)), 1e-6
    for k in range(3):
        for channel in range(3):
            more = colour.copy()
            more[k, channel] += step
            np.testing.assert_allclose(
                (F_of(toward, more) - F_of(toward, colour)) / step, change[3 * k + channel], atol=1e-6
            )
        for i in range(2):
            moved = toward.copy()
            moved[k] += step * across(toward)[k, i]
            np.testing.assert_allclose(
                (F_of(moved, colour) - F_of(toward, colour)) / step, change[9 + 2 * k + i], atol=1e-5
            )
    slope, ray = rng.normal(size=(20, 2)), 0.2 * rng.normal(size=(20, 2))
    for i in range(2):
        there = normals_of_slopes(slope + step * np.eye(2)[i], ray)
        np.testing.assert_allclose(
            (there - normals_of_slopes(slope, ray)) / step, normals_by_slopes(slope, ray)[..., i], atol=1e-5
        )


def test_what_is_expected_of_F_weighs_turns_and_stretches_apart():
    rng = np.random.default_rng(0)
    F, turn = rng.normal(size=(3, 3)), np.diag([1e-3, 2e-3, 4e-3])
    known = expected(F, turn, 0.05)
    omega = np.array([0.3, -0.2, 0.5])
    by_turn = -F @ np.cross(np.eye(3), omega)  # F (𝟙 − [ω]×), for [ω]× v = ω × v
    assert by_turn.ravel() @ known.precision @ by_turn.ravel() == pytest.approx(omega @ np.linalg.solve(turn, omega))
    stretch = np.array([[0.1, 0.2, 0.0], [0.2, -0.1, 0.3], [0.0, 0.3, 0.4]])
    longer = (F @ stretch).ravel()
    assert longer @ known.precision @ longer == pytest.approx((stretch**2).sum() / 0.05**2)


def test_each_step_of_the_fit_leaves_less():
    observation, _, all_lit, _ = seldom_all_lit()
    bundle = Bundle(observation.rgb, observation.mask, all_lit, NOISE, 600)
    n = bundle.cells.smoothed(bundle.cells.N, 1.0)  # any start of the right shape
    start = Lit(-0.1 * n[:, :2], TOWARD, COLOURS / observation.rgb.max(), np.inf)
    losses = [bundle.fit(start, 0.1, 1e-2, steps, tied=True).loss for steps in (1, 3, 9)]
    assert losses[0] > losses[1] > losses[2]
