"""Objects of one hue with any brightness: the curl of colour directions, the albedo, the joint fit, the method."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from synthesis import angles_deg, dome, problem_of_colours

from huesphere.recover.geometry.rotations import TWIN
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.methods.table import METHODS
from huesphere.recover.uniform_hue.albedo import log_albedo
from huesphere.recover.uniform_hue.fit import cues_of, fit
from huesphere.recover.uniform_hue.picture import picture_of
from huesphere.recover.uniform_hue.posterior import posterior
from huesphere.render.dataset import Observation

F = np.array([[0.5, 0.1, 0.6], [-0.4, 0.3, 0.6], [0.0, -0.5, 0.6]])
METHOD = METHODS["uniform-hue"].load()  # the estimate before it is judged


def patches(size: int, seed: int = 0) -> np.ndarray:
    """(size, size) albedo from .3 to 1 in squares of sixteen pixels."""
    values = np.random.default_rng(seed).uniform(0.3, 1.0, (size // 16 + 1, size // 16 + 1))
    return values.repeat(16, 0).repeat(16, 1)[:size, :size]


@cache
def wavy(size: int = 48, noise: float = 5e-4) -> tuple[Observation, np.ndarray, np.ndarray]:
    """(observation, normals, albedo) of a dome with waves and patches; every pixel is taken to see every light."""
    normals, mask = dome(size, elongation=1.1, bumps=0.25, cap=0.93)
    albedo = patches(size)
    rgb = (normals @ F.T) * albedo[..., None] + noise * np.random.default_rng(1).normal(size=normals.shape)
    return Observation(np.where(mask[..., None], rgb, 0).astype(np.float32), mask), normals, albedo


@cache
def estimate() -> Estimate:
    return METHOD(wavy()[0])


def bas_relief(depth: float, right: float, up: float) -> np.ndarray:
    """The matrix that takes normals to those, not unit, of z' = depth · z + right · x + up · y, up to a factor."""
    return np.array([[depth, 0, -right], [0, depth, -up], [0, 0, 1.0]])


# ---- laws ------------------------------------------------------------------------------------------------------------


def test_curls_vanish_at_the_truth_for_any_albedo_and_any_bas_relief_transformation():
    observation, _, _ = wavy(noise=0.0)
    picture = picture_of(problem_of_colours(observation.rgb, observation.mask))
    G = np.linalg.inv(picture.W @ F)
    wrong = np.median(np.abs(picture.curl.residual(G @ np.array([[1, 0.2, 0], [0, 1, 0], [0, 0.3, 1.0]]))))
    for transformation in (np.eye(3), bas_relief(2.0, 0.2, -0.1), bas_relief(0.5, 0, 0.3), TWIN):
        assert np.median(np.abs(picture.curl.residual(transformation @ G))) < 0.05 * wrong


def test_curls_say_nothing_of_the_bas_relief_transformation():
    observation, _, _ = wavy()
    curl = picture_of(problem_of_colours(observation.rgb, observation.mask)).curl
    G = np.linalg.inv(F) + 0.2 * np.random.default_rng(0).normal(size=(3, 3))
    bounded = curl.residual(bas_relief(1.5, 0.1, -0.2) @ G)  # but for slopes that are bounded where h is nearly 0
    assert np.median(np.abs(bounded - curl.residual(G))) < 0.02 * np.median(np.abs(bounded))


@pytest.mark.parametrize("cue", ["curl", "spread", "template", "steps"])
def test_derivatives_of_a_cue_are_its_differences(cue):
    observation, _, _ = wavy()
    found = next(c for c in cues_of(picture_of(problem_of_colours(observation.rgb, observation.mask))) if c.name == cue)
    rng = np.random.default_rng(3)
    x = np.append((np.eye(3) + 0.2 * rng.normal(size=(3, 3))).ravel(), [0.3, 0.1])
    along, step = rng.normal(size=11), 1e-6
    residual, J = found.linearised(x)
    assert residual == pytest.approx(found.residual(x))
    differences = (found.residual(x + step * along) - found.residual(x - step * along)) / (2 * step)
    assert J @ along == pytest.approx(differences, abs=1e-6 * np.abs(differences).max())


def test_a_depth_that_is_off_looks_like_shading():
    """To first order log |Gρ| of a surface taken to be deeper by 1 + s is − s n3² apart from a constant."""
    n = np.random.default_rng(0).normal(size=(50, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    flat = log_albedo(n, np.diag([1.0, 1.0, 1 / 1.001]), -0.001)[0]
    assert flat == pytest.approx(np.zeros(50), abs=2e-6)


@pytest.mark.parametrize("name", ["exposure", "channels", "albedo"])
def test_normals_do_not_depend_on(name):
    observation, _, _ = wavy()
    rgb = observation.rgb
    other = {
        "exposure": rgb * np.float32(0.25),
        "channels": rgb[..., [2, 0, 1]],
        "albedo": rgb * patches(48, seed=5)[..., None].astype(np.float32),
    }[name]
    before, after = estimate(), METHOD(replace(observation, rgb=other))
    both = before.valid & after.valid
    turned = angles_deg(before.normals[both].astype(float), after.normals[both].astype(float))
    # Directions are the same whatever the albedo is; what its own steps say of the depth is not.
    assert np.median(turned) < (1.5 if name == "albedo" else 0.02)


# ---- accuracy --------------------------------------------------------------------------------------------------------


def test_normals_and_albedo_of_a_wavy_dome_of_patches():
    _, normals, albedo = wavy()
    found = estimate()
    given = found.valid
    error = angles_deg(found.normals[given].astype(float), normals[given])
    assert np.median(error) < 2.0
    assert np.std(np.log(found.albedo[given] / albedo[given])) < 0.06
    assert np.median(error) < 1.5 * np.median(found.uncertainty_deg[given])
    assert np.median(found.uncertainty_deg[given]) < 6


def test_it_is_better_than_the_matrix_of_the_silhouette_on_a_flattened_body():
    normals, mask = dome(48, bumps=0.15, cap=0.93)
    flat = normals * np.array([0.6, 0.6, 1.0])  # 0.6 times as deep
    flat /= np.linalg.norm(flat, axis=-1, keepdims=True)
    rgb = (flat @ F.T) * patches(48)[..., None] + 5e-4 * np.random.default_rng(1).normal(size=flat.shape)
    observation = Observation(np.where(mask[..., None], rgb, 0).astype(np.float32), mask)
    errors = []
    for method in ("uniform-hue", "silhouette-matrix"):
        found = METHODS[method].load()(observation)
        errors.append(np.median(angles_deg(found.normals[found.valid].astype(float), flat[found.valid])))
    assert errors[0] < 3.0 < 8.0 < errors[1]


def test_what_fixed_the_ambiguity_is_told():
    observation, _, _ = wavy()
    known = posterior(fit(picture_of(problem_of_colours(observation.rgb, observation.mask))))
    assert min(known.by_cue["depth"], key=known.by_cue["depth"].get) == "steps"
    assert "curl" not in known.by_cue["depth"]
    assert known.by_cue["depth"]["steps"] < 0.15
    told = estimate().diagnostics["uniform_hue"]
    assert told["depth"]["by"] == "steps"
    assert set(told) == {"scales", "log_depth", "shading", "depth", "lean_deg"}


# ---- verdict and refusals --------------------------------------------------------------------------------------------


def test_a_free_brightness_is_never_trusted_and_says_why():
    found = METHODS["uniform-hue"](wavy()[0])
    assert found.verdict == "doubtful"
    assert any("the brightness is free at every pixel" in doubt for doubt in found.doubts)


def test_without_a_silhouette_it_is_refused():
    observation, _, _ = wavy()
    middle = slice(16, 32)
    found = METHOD(Observation(observation.rgb[middle, middle], observation.mask[middle, middle]))
    assert found.status == "no-silhouette"
    assert not found.valid.any()


def test_colours_in_a_plane_are_refused():
    observation, _, _ = wavy()
    grey = replace(observation, rgb=np.repeat(observation.rgb[..., 1:2], 3, axis=-1))
    assert METHOD(grey).status == "rank-deficient-colours"
