"""Normals on the sphere, lights found one by one, and every pixel knitted together."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from huesphere.recover.depth.joint_fit import fit_jointly
from huesphere.recover.depth.smoothness_prior import quieted
from huesphere.recover.every_pixel.by_light_sets import knit
from huesphere.recover.geometry.sphere import on_sphere
from huesphere.recover.lights.from_shadows import ONE_LIGHT, SURELY_ONE, _Search, find_lights, folds, relative_curl
from huesphere.recover.lights.model import Light, Lights, without
from huesphere.recover.methods.table import METHODS
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


@given(st.integers(0, 2**32 - 1), st.booleans())
@settings(max_examples=30, deadline=None)
def test_nearest_on_the_sphere_is_the_nearest(seed, flat):
    rng = np.random.default_rng(seed)
    M = rng.normal(size=(3, 3))
    if flat:
        M[2] = M[0] + M[1]
    rho = rng.normal(size=(5, 3))
    n, distance = on_sphere(rho, M)
    assert np.allclose(np.linalg.norm(n, axis=1), 1)
    assert np.allclose(np.linalg.norm(rho - n @ M.T, axis=1), distance)
    others = rng.normal(size=(4000, 3))
    others /= np.linalg.norm(others, axis=1, keepdims=True)
    nearest = np.linalg.norm(rho[:, None] - others @ M.T, axis=2).min(axis=1)
    assert (distance <= nearest + 1e-9).all()


def test_a_colour_on_the_ellipsoid_gives_its_normal():
    normals, mask = bumps()
    n = normals[mask]
    found, distance = on_sphere(n @ F.T, F)
    assert angle_deg(found, n).max() < 1e-5
    assert distance.max() < 1e-9


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=50, deadline=None)
def test_folds_are_one_ellipsoid(seed):
    rng = np.random.default_rng(seed)
    a = rng.normal(size=3)
    a /= np.linalg.norm(a)
    b = rng.uniform(0.1, 0.6, 3)
    M = F - np.outer(b, a)
    if np.linalg.cond(M) > 100 or abs(1 - a @ np.linalg.solve(F, b)) < 0.05:
        return
    C = np.linalg.inv(M @ M.T)
    found = folds(F, b, a)
    assert len(found) >= 2
    for colour, plane in found:
        other = F - np.outer(colour, plane)
        assert np.allclose(np.linalg.inv(other @ other.T), C, rtol=1e-5, atol=1e-5 * np.abs(C).max())


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
    lights = find_lights(observation.rgb.astype(float), observation.mask, all_lit, scale * F, 0.0)
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
    search = _Search(rgb, mask, mask & (cosine > 0).all(axis=-1), colours.T @ toward, 0.0)
    for direction, colour in zip([*toward[:3], TOWARD[3]], [*colours[:3], [0.3, 0.3, 0.3]]):
        search._add(Light(direction, np.asarray(colour), 100, 0.0, 1.0))
    return search, toward, colours


def test_a_light_without_a_shadow_is_what_is_missing_beside_the_others():
    search, toward, colours = search_with_frontal(1)
    found = search.with_the_rest(SURELY_ONE)
    assert search.missing(found) < 1e-6
    assert np.allclose([light.direction for light in found], toward, atol=1e-6)
    assert np.allclose([light.colour for light in found], colours, atol=1e-6)


def test_two_lights_without_a_shadow_do_not_pass_for_one():
    search, *_ = search_with_frontal(2)
    assert search.with_the_rest(ONE_LIGHT) is None


def test_every_pixel_is_knitted(wide):
    observation, normals, lit, scale = wide
    mask = observation.mask
    all_lit = mask & lit.all(axis=-1)
    rgb = observation.rgb.astype(float)
    lights = find_lights(rgb, mask, all_lit, scale * F, 0.0)
    start = np.where(all_lit[..., None], normals, np.nan)
    whole = knit(rgb, mask, mask, start, scale * F, lights, 0.0)
    error = angle_deg(whole.normals[mask], normals[mask])
    assert np.isfinite(whole.normals[mask]).all()
    assert (whole.explained & mask).sum() > 0.97 * mask.sum()
    assert np.median(error) < 0.05
    assert error.mean() < 0.5
    off = np.stack([(whole.off >> j) & 1 for j in range(len(lights.found))], axis=-1).astype(bool)
    order = [int(np.argmax(TOWARD @ light.direction)) for light in lights.found]
    agree = (off == ~lit[..., order]).all(axis=-1)
    assert agree[whole.explained].mean() > 0.95


def test_without_lights_the_rest_is_bridged(wide):
    observation, normals, lit, scale = wide
    all_lit = observation.mask & lit.all(axis=-1)
    start = np.where(all_lit[..., None], normals, np.nan)
    rgb = observation.rgb.astype(float)
    whole = knit(rgb, observation.mask, observation.mask, start, scale * F, Lights((), 1.0), 0.0)
    assert np.isfinite(whole.normals[observation.mask]).all()
    assert (whole.off[~whole.explained] == -1).all()
    assert (whole.off[whole.explained] == 0).all()
    assert np.median(angle_deg(whole.normals[all_lit], normals[all_lit])) < 1e-3


def test_a_light_that_is_gone_leaves_its_matrix():
    lights = find_lights_of_truth()
    assert np.allclose(without(F, lights, (0, 2)), COLOURS[[1, 3]].T @ TOWARD[[1, 3]])


def find_lights_of_truth():
    from huesphere.recover.lights.model import Light

    return tuple(Light(a, b, 100, 0.0, 1.0) for a, b in zip(TOWARD, COLOURS))


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
    off, none = np.where(mask, 0, -1), np.zeros_like(rgb)
    fit = fit_jointly(rgb, mask, alone, mask, off, 1.01 * alike, Lights((), 1.0), none, noise)
    before = np.median(angle_deg(alone[mask], normals[mask]))
    error = angle_deg(fit.normals[mask], normals[mask])
    assert np.median(error) < 0.65 * before
    assert 0.9 < np.median(fit.misfit[mask]) < 1.3
    assert np.linalg.norm(fit.F - alike) < 0.01 * np.linalg.norm(alike)
    quiet = quieted(fit)
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
    off = np.where(mask, 0, -1)
    error, misfit = [], []
    for light in (np.zeros_like(taken), taken):
        fit = fit_jointly(rgb, mask, alone, mask, off, F, Lights((), 1.0), light, noise)
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
