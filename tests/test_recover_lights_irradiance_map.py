"""Lights that are wide or many: the harmonics of irradiance, the bent ellipsoid, the map from normal to colour."""

from functools import cache

import numpy as np
import pytest
from synthesis import dome, median_error, problem_of_colours
from test_recover_methods import documented

from huesphere.configs.load import load_config
from huesphere.eval.metrics import angular_error_deg
from huesphere.recover.ellipsoid.lack_of_fit import lack_of_fit
from huesphere.recover.geometry.harmonics import Harmonics, clamped_cosine
from huesphere.recover.geometry.sphere import fibonacci
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.lights.irradiance_map import fit_irradiance
from huesphere.recover.methods.table import METHODS
from huesphere.render.dataset import CameraInfo, Observation, read_observation, read_truth
from huesphere.render.run import render_config

GELS = np.array([[1, 0.15, 0.1], [0.15, 1, 0.2], [0.1, 0.2, 1], [0.9, 0.8, 0.1], [0.8, 0.15, 0.9]])
MOZART_PLACES = np.array([[0.5, 0.2, 1], [-0.5, 0.2, 1], [0, -0.5, 1], [0.3, 0.5, 1], [-0.2, 0.4, 1]])
HALF_ANGLE = 35.0  # degrees, of each light's disc
ROUND = np.arange(5) * 2 * np.pi / 5 + 0.4
TILT = np.radians([30, 45, 38, 50, 34])
MIDDLES = np.stack([np.sin(TILT) * np.cos(ROUND), np.sin(TILT) * np.sin(ROUND), np.cos(TILT)], axis=-1)


@cache
def under(half_angle: float, size: int = 72, noise: float = 0.0) -> tuple[Observation, np.ndarray]:
    """(a dome under five gels, each a disc on the sky; its normals (H, W, 3)), no shadow but the surface's own."""
    n, mask = dome(size, elongation=1.2, cap=0.97)
    sky = fibonacci(3000)
    rgb = np.zeros((*mask.shape, 3))
    for middle, colour in zip(MIDDLES, GELS, strict=True):
        disc = sky[sky @ middle > np.cos(np.radians(half_angle))] if half_angle else middle[None]
        rgb[mask] += np.maximum(n[mask] @ disc.T, 0).mean(axis=1)[:, None] * colour
    rgb /= rgb.max()
    rgb[mask] += noise * np.random.default_rng(0).standard_normal((mask.sum(), 3))
    return Observation(rgb.astype(np.float32), mask, CameraInfo(read_noise=noise, known=True)), n


@cache
def found(method: str, half_angle: float) -> Estimate:
    return METHODS[method](under(half_angle)[0])


def test_harmonics_are_orthogonal_and_as_long_as_clamped_cosine_leaves_them():
    degrees = (0, 1, 2, 4, 6)
    values, _ = Harmonics(degrees).at(fibonacci(40_000))
    lengths = np.concatenate([np.full(2 * degree + 1, abs(clamped_cosine(degree))) for degree in degrees])
    gram = values.T @ values * 4 * np.pi / len(values)
    assert gram == pytest.approx(np.diag(lengths**2), abs=1e-3)


def test_nine_numbers_hold_all_but_a_percent_of_the_energy_of_one_light():
    """Basri and Jacobs 2003, Table 1: 99.22 % for orders 0 to 2, 99.81 % to 4, 99.93 % to 6."""
    n = fibonacci(40_000)
    shading = np.maximum(n @ MIDDLES[0], 0)
    for degrees, energy in (((0, 1, 2), 0.9922), ((0, 1, 2, 4), 0.9981), ((0, 1, 2, 4, 6), 0.9993)):
        values, _ = Harmonics(degrees).at(n)
        rest = shading - values @ np.linalg.lstsq(values, shading)[0]
        assert 1 - (rest**2).sum() / (shading**2).sum() == pytest.approx(energy, abs=1e-4)


def test_the_gradient_is_that_of_the_values():
    harmonics, n, step = Harmonics((0, 1, 2, 4)), fibonacci(50), 1e-5
    _, gradients = harmonics.at(n)
    for axis in range(3):
        move = step * np.eye(3)[axis]
        change = (harmonics.at(n + move)[0] - harmonics.at(n - move)[0]) / (2 * step)
        assert gradients[..., axis] == pytest.approx(change, abs=1e-6)


@pytest.mark.parametrize(("half_angle", "bent"), [(0.0, False), (HALF_ANGLE, True)])
def test_a_shell_is_bent_under_wide_lights_alone(half_angle, bent):
    observation, _ = under(half_angle)
    estimate = found("weak-integrability", half_angle)
    bend = lack_of_fit(observation.rgb, estimate.inlier, np.array(estimate.diagnostics["C"]))
    assert bend.significant == bent


def test_the_map_finds_the_normals_beyond_a_core_that_is_known():
    """From a start that is wrong by the more the farther it is from the core."""
    observation, n = under(HALF_ANGLE, 96)
    mask = observation.mask
    core = mask & (n[..., 2] > 0.9)
    start = n + np.where(core, 0.0, 0.9 - n[..., 2])[..., None] * np.array([0.3, 0.2, 0.6])
    start /= np.maximum(np.linalg.norm(start, axis=-1, keepdims=True), 1e-9)
    fit = fit_irradiance(problem_of_colours(observation.rgb, mask), start, core)
    beyond = mask & ~core
    before, after = (angular_error_deg(one[beyond], n[beyond]).mean() for one in (start, fit.normals))
    assert before > 6
    assert after < 2


@pytest.mark.slow
def test_auto_takes_the_map_under_wide_lights():
    observation, n = under(HALF_ANGLE)
    estimate = found("auto", HALF_ANGLE)
    assert estimate.status in ("ok", "uncertain", "little-explained")
    assert set(estimate.diagnostics["irradiance"]) <= documented()["irradiance"]
    assert (estimate.valid == observation.mask).all()
    mask = observation.mask
    assert angular_error_deg(estimate.normals[mask], n[mask]).mean() < 3
    assert median_error(estimate, n) < 0.5 * median_error(found("weak-integrability", HALF_ANGLE), n)


@pytest.mark.slow
def test_auto_says_so_where_neither_lights_nor_a_map_explain_the_picture():
    """Three gels and a sky: no pixel sees all the light whole, and terminators are sharp."""
    n, mask = dome(72, cap=0.97)
    sky = fibonacci(2000)
    sky = sky[sky[:, 1] > 0]
    rgb = np.zeros((*mask.shape, 3))
    rgb[mask] = np.maximum(n[mask] @ MIDDLES[:3].T, 0) @ GELS[:3]
    up = sky[:, 1:2]
    colours = (up * [0.2, 0.35, 0.8] + (1 - up) * [0.6, 0.55, 0.4]) * 2 / len(sky)
    rgb[mask] += np.maximum(n[mask] @ sky.T, 0) @ colours
    estimate = METHODS["auto"](Observation((rgb / rgb.max()).astype(np.float32), mask, CameraInfo()))
    assert estimate.status != "ok"
    assert estimate.message


@pytest.mark.slow
def test_wide_lights_are_not_the_light_of_a_hollow(tmp_path, mi):
    """What discs of light lack of an ellipsoid a hollow's own light explains four times better: inside out, 75°."""
    places = 30 * MOZART_PLACES / np.linalg.norm(MOZART_PLACES, axis=1, keepdims=True)
    gels = [f"{{gaussian: {{centre: {nm}, sigma: 30}}}}" for nm in (610, 540, 460, 580, 500)]
    lights = [
        f"{{kind: sphere, position: {place.tolist()}, radius: 15, intensity: 300, spectrum: {gel}}}"
        for place, gel in zip(places, gels, strict=True)
    ]
    changes = ["shape={kind: ellipsoid}", f"lights=[{', '.join(lights)}]", "camera.resolution=[64,64]"]
    config = load_config("mozart_5gels", overrides=[*changes, "render.transport=[direct]"])
    render_config(config, tmp_path, progress=lambda *_: None, log=lambda _: None)
    folder = tmp_path / "mozart_5gels/direct"
    estimate = METHODS["auto"](read_observation(folder / "observation.exr"))
    assert median_error(estimate, read_truth(folder / "truth.exr").normals) < 6
