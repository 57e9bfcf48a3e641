"""Lights found one by one, each by the pixels that miss it; and what the methods make of them."""

import numpy as np
import pytest
from scipy import ndimage
from synthesis import joint_fit, problem_of_colours, solution_of

from huesphere.recover.depth.smoothness_prior import denoised
from huesphere.recover.geometry.sphere import on_sphere
from huesphere.recover.lights.from_shadows import SURELY_ONE_LIGHT, _Search, find_lights, relative_curl
from huesphere.recover.lights.model import Light
from huesphere.recover.lights.parameters import LIGHTS
from huesphere.recover.methods.table import METHODS
from huesphere.recover.parameters import overridden
from huesphere.render.dataset import CameraInfo, Observation
from huesphere.scenes.surfaces import depth_normals

AROUND = np.radians([15.0, 130.0, 200.0, 290.0])
TOWARD = np.stack([np.cos(AROUND), np.sin(AROUND), np.full(4, 0.75)], axis=-1)
TOWARD /= np.linalg.norm(TOWARD, axis=1, keepdims=True)
COLOURS = np.array([[0.8, 0.15, 0.05], [0.1, 0.6, 0.15], [0.05, 0.2, 0.7], [0.4, 0.4, 0.1]])
F = COLOURS.T @ TOWARD


def bumps(side=112):
    """(normals, mask) of a bumpy dome, steep at its rim."""
    y, x = np.mgrid[:side, :side] / (side / 2) - 1
    mask = x * x + y * y < 0.85
    depth = 0.75 * np.sqrt(np.maximum(1.05 - x * x - y * y, 0.05)) + 0.05 * np.sin(5 * x + 1) * np.cos(4 * y)
    return depth_normals(np.where(mask, depth * side / 2, 0.0), mask), mask


def wide_picture(noise=0.0):
    """(observation, normals, lit (H, W, 4)): attached shadows only."""
    normals, mask = bumps()
    mask = mask & np.isfinite(normals).all(axis=-1)
    cosine = np.where(mask[..., None], normals, 0.0) @ TOWARD.T
    rgb = np.maximum(cosine, 0.0) @ COLOURS
    scale = 0.9 / rgb.max()
    rgb = scale * rgb + noise * np.random.default_rng(3).standard_normal(rgb.shape)
    observation = Observation(np.where(mask[..., None], rgb, 0.0).astype(np.float32), mask, CameraInfo(known=False))
    return observation, normals, cosine > 0, scale


def angle_deg(a, b):
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1)))


def test_curl_tells_a_surface_from_its_mirror_image():
    normals, mask = bumps()
    a = TOWARD[0]
    mirrored = normals - 2 * (normals @ a)[..., None] * a
    facing = mask & (mirrored[..., 2] > 0.2)
    assert relative_curl(normals, facing) < 0.02
    assert relative_curl(mirrored, facing) > 0.1


@pytest.fixture(scope="module")
def wide():
    return wide_picture()


def test_all_lights_are_found_from_one_picture(wide):
    observation, _, lit, scale = wide
    all_lit = observation.mask & lit.all(axis=-1)
    assert 0.5 < all_lit.sum() / observation.mask.sum() < 0.8
    lights = find_lights(problem_of_colours(observation.rgb, observation.mask), solution_of(scale * F, all_lit))
    assert lights.complete
    assert len(lights.found) == 4
    for light in lights.found:
        nearest = int(np.argmax(TOWARD @ light.direction))
        assert angle_deg(light.direction, TOWARD[nearest]) < 0.5
        off = np.linalg.norm(light.colour - scale * COLOURS[nearest])
        assert off < 0.03 * scale * np.linalg.norm(COLOURS[nearest])


def search_with_frontal(count):
    """(search that has found three lights and a wrong one, directions, colours): ``count`` more have no shadow."""
    normals, mask = bumps()
    normals = np.where(mask[..., None], normals, [0.0, 0.0, 1.0])
    frontal = np.array([[0.03, 0.02, 1.0], [-0.3, -0.06, 1.0]])[:count]
    toward = np.concatenate([TOWARD[:3], frontal / np.linalg.norm(frontal, axis=1, keepdims=True)])
    colours = np.concatenate([COLOURS[:3], [[0.4, 0.4, 0.1], [0.1, 0.2, 0.5]][:count]])
    cosine = normals @ toward.T
    rgb = np.where(mask[..., None], np.maximum(cosine, 0) @ colours, 0.0)
    all_lit = mask & (cosine > 0).all(axis=-1)
    search = _Search(problem_of_colours(rgb, mask), solution_of(colours.T @ toward, all_lit))
    for direction, colour in zip([*toward[:3], TOWARD[3]], [*colours[:3], [0.3, 0.3, 0.3]]):
        search._add(Light(direction, np.asarray(colour), 100, 0.0, 1.0))
    return search, toward, colours


def test_a_light_without_a_shadow_is_what_is_missing_beside_the_others():
    search, toward, colours = search_with_frontal(1)
    found = search.with_inferred_light(SURELY_ONE_LIGHT)
    assert search.missing(found) < 1e-6
    assert np.allclose([light.direction for light in found], toward, atol=1e-6)
    assert np.allclose([light.colour for light in found], colours, atol=1e-6)


def test_two_lights_without_a_shadow_do_not_pass_for_one():
    search, *_ = search_with_frontal(2)
    assert search.with_inferred_light(LIGHTS.relative_light_error) is None


def test_no_light_is_found_where_no_pixel_misses_one():
    normals, mask = bumps()
    all_lit = mask & (normals @ TOWARD.T > 0).all(axis=-1)
    rgb = np.where(all_lit[..., None], normals @ F.T, 0.0)
    lights = find_lights(problem_of_colours(rgb, all_lit), solution_of(F, all_lit))
    assert lights.found == ()
    assert lights.missing == pytest.approx(1.0)
    assert not lights.complete


def test_a_light_that_too_few_pixels_miss_is_not_believed(wide):
    observation, _, lit, scale = wide
    all_lit = observation.mask & lit.all(axis=-1)
    with overridden(LIGHTS, least_support_px=10**6):
        lights = find_lights(problem_of_colours(observation.rgb, observation.mask), solution_of(scale * F, all_lit))
    assert lights.found == ()


def test_a_light_must_leave_the_rest_of_the_picture_possible():
    search, toward, colours = search_with_frontal(1)
    both = np.concatenate([colours[0], toward[0]])
    brighter, behind, negative = both.copy(), both.copy(), both.copy()
    brighter[:3] *= 4
    behind[3:] *= -1
    negative[1] = -0.5
    assert search.possible(np.array([both, brighter, behind, negative])).tolist() == [True, False, False, False]


def test_one_depth_a_pixel_beats_pixels_one_by_one(wide):
    observation, normals, lit, _ = wide
    mask = observation.mask & lit.all(axis=-1)
    grey = COLOURS.mean(axis=0)
    alike = (grey + 0.15 * (COLOURS - grey)).T @ TOWARD  # lights of nearly one colour: noise in one direction
    noise = 1e-3
    rgb = np.where(mask[..., None], normals @ alike.T, 0.0) + noise * np.random.default_rng(0).standard_normal(
        normals.shape
    )
    alone = np.full(normals.shape, np.nan)
    alone[mask] = on_sphere(rgb[mask], alike)[0]
    fit = joint_fit(rgb, mask, alone, 1.01 * alike, noise)
    before = np.median(angle_deg(alone[mask], normals[mask]))
    error = angle_deg(fit.normals[mask], normals[mask])
    assert np.median(error) < 0.65 * before
    assert 0.9 < np.median(fit.misfit[mask]) < 1.3
    assert np.linalg.norm(fit.F - alike) < 0.01 * np.linalg.norm(alike)
    quiet = denoised(fit)
    assert np.median(angle_deg(quiet.normals[mask], normals[mask])) < 0.8 * np.median(error)
    error = angle_deg(quiet.normals[mask], normals[mask])
    assert 0.6 < (error < 1.7 * quiet.uncertainty_deg[mask]).mean() < 1


def test_the_joint_fit_does_not_take_an_error_of_the_light_taken_out_for_shape(wide):
    observation, normals, lit, _ = wide
    mask = observation.mask & lit.all(axis=-1)
    rng = np.random.default_rng(1)
    taken = np.where(mask[..., None], 0.05 * COLOURS.mean(axis=0), 0.0)
    wrong = ndimage.gaussian_filter(rng.standard_normal(mask.shape), 6.0)
    wrong *= 0.15 / wrong[mask].std()
    F, noise = COLOURS.T @ TOWARD, 1e-3
    rgb = np.where(mask[..., None], normals @ F.T + wrong[..., None] * taken, 0.0)
    rgb += noise * rng.standard_normal(rgb.shape)
    alone = np.full(normals.shape, np.nan)
    alone[mask] = on_sphere(rgb[mask], F)[0]
    error, misfit = [], []
    for light in (np.zeros_like(taken), taken):
        fit = joint_fit(rgb, mask, alone, F, noise, removed=light)
        error.append(np.median(angle_deg(fit.normals[mask], normals[mask])))
        misfit.append(np.median(fit.misfit[mask]))
    assert error[1] < 0.7 * error[0]
    assert misfit[1] < 1.3 < misfit[0]


@pytest.mark.parametrize("method", ["knit", "auto"])
def test_methods_give_every_pixel(method, wide):
    observation, normals, _, _ = wide
    estimate = METHODS[method](observation)
    assert estimate.status == "ok"
    assert estimate.valid[observation.mask].all()
    error = angle_deg(estimate.normals[observation.mask], normals[observation.mask])
    assert np.median(error) < 0.5
    assert error.mean() < 1.5
    assert np.isfinite(estimate.uncertainty_deg[observation.mask]).all()
    assert estimate.diagnostics["lights"]["complete"]
    if method == "auto":
        assert any(step.startswith("every pixel") for step in estimate.diagnostics["auto"])
