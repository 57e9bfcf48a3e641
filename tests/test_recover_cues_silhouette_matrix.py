"""The inflated outline, the matrix that is regressed on it, and the method ``silhouette-matrix``."""

from dataclasses import replace

import numpy as np
import pytest
from synthesis import angles_deg

from huesphere.recover.cues.inflated_outline import inflated, membrane
from huesphere.recover.cues.silhouette_matrix import matrix_to_template
from huesphere.recover.io.estimate import read_estimate, write_estimate
from huesphere.recover.methods.table import METHODS
from huesphere.render.dataset import Observation, write_observation

F = np.array([[0.5, 0.1, 0.6], [-0.4, 0.3, 0.6], [0.0, -0.5, 0.6]])
METHOD = METHODS["silhouette-matrix"]


def ball(size: int = 40, noise: float = 0.0) -> tuple[Observation, np.ndarray, np.ndarray]:
    """(observation, normals, albedo) of a ball of patches, every pixel all-lit: colours may be negative."""
    y, x = (0.5 - np.indices((size, size)) / (size - 1)) * 2.3 * np.array([1, -1])[:, None, None]
    mask = x**2 + y**2 < 1
    normals = np.dstack([x, y, np.sqrt(np.where(mask, 1 - x**2 - y**2, 1))])
    albedo = np.random.default_rng(0).uniform(0.3, 1.0, (8, 8)).repeat(5, 0).repeat(5, 1)[:size, :size]
    rgb = (normals @ F.T) * albedo[..., None] + noise * np.random.default_rng(1).normal(size=normals.shape)
    return Observation(np.where(mask[..., None], rgb, 0).astype(np.float32), mask), normals, albedo


def test_over_a_disc_the_membrane_is_that_of_a_half_ball():
    """∇²h = −4 over a disc of radius R: h = R² − r²; the grid's disc is between the pixels' centres and their edges."""
    row, column = np.indices((61, 61)) - 30
    squared = row**2 + column**2
    h = membrane(squared <= 25**2)
    inside = squared < 15**2
    assert np.sqrt(h[inside] + squared[inside]) == pytest.approx(25.5, abs=0.3)


def test_the_template_of_a_deeper_surface_is_that_with_its_depth_stretched():
    mask = ball(30)[0].mask
    n, deep = inflated(mask)[mask], inflated(mask, np.log(2.0))[mask]
    slopes, deep_slopes = (m[:, :2] / np.maximum(m[:, 2:], 1e-9) for m in (n, deep))
    assert deep_slopes == pytest.approx(2 * slopes, rel=1e-6)
    assert np.linalg.norm(n, axis=1) == pytest.approx(1.0)


def test_the_matrix_is_exact_where_the_template_is_right():
    rng = np.random.default_rng(2)
    n = rng.normal(size=(400, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    d = n @ F.T
    G = matrix_to_template(d / np.linalg.norm(d, axis=1, keepdims=True), n)
    assert abs(np.linalg.det(G)) == pytest.approx(1.0)
    assert np.cbrt(np.linalg.det(F)) * np.linalg.inv(F) == pytest.approx(G, abs=1e-9)


def test_the_matrix_forgives_a_fifth_of_wrong_normals():
    rng = np.random.default_rng(3)
    n = rng.normal(size=(1000, 3)) + np.array([0, 0, 1.5])
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    wrong = n.copy()
    wrong[:200] = n[rng.permutation(200)] * [-1, -1, 1]
    d = n @ F.T
    G = matrix_to_template(d / np.linalg.norm(d, axis=1, keepdims=True), wrong)
    found = d @ G.T
    assert np.median(angles_deg(found / np.linalg.norm(found, axis=1, keepdims=True), n)) < 2


def test_normals_of_a_patchy_ball_and_its_albedo():
    observation, normals, albedo = ball()
    found = METHOD(observation)
    assert found.verdict == "doubtful", "its template is a guess"
    given = found.valid
    assert given.sum() > 0.95 * observation.mask.sum()
    error = angles_deg(found.normals[given].astype(float), normals[given])
    assert np.median(error) < 2.5  # a disc of 20 pixels' radius is known to half a pixel, and its rim to less
    assert np.median(error) < np.nanmedian(found.uncertainty_deg)
    ratio = found.albedo[given] / albedo[given]
    assert np.std(np.log(ratio)) < 0.05
    assert np.isnan(found.albedo[~given]).all()
    assert np.median(found.albedo[given]) == pytest.approx(1.0, rel=1e-3)


@pytest.mark.parametrize("name", ["albedo", "exposure", "channels"])
def test_normals_do_not_depend_on(name):
    observation, _, _ = ball()
    rgb = observation.rgb
    other = {
        "albedo": rgb * np.linspace(0.5, 2, 40, dtype=np.float32)[:, None, None],
        "exposure": rgb * np.float32(0.25),
        "channels": rgb[..., [2, 0, 1]],
    }[name]
    before, after = (METHOD.load()(replace(observation, rgb=colours)) for colours in (rgb, other))
    both = before.valid & after.valid
    turned = angles_deg(before.normals[both].astype(float), after.normals[both].astype(float))
    # The whitening weighs pixels by their brightness, which decides only which are too dark to take part.
    assert np.median(turned) < (0.3 if name == "albedo" else 1e-3)


def test_an_object_without_a_silhouette_is_refused_in_one_line():
    observation, _, _ = ball()
    middle = slice(14, 26)
    cut = Observation(observation.rgb[middle, middle], observation.mask[middle, middle])
    found = METHOD.load()(cut)
    assert (found.status, found.verdict) == ("no-silhouette", "failed")
    assert found.message == (
        "over half of the object's border is the edge of the picture; "
        "give the object's mask, with background about it: the method needs the whole outline"
    )


def test_the_albedo_survives_the_way_to_disk(tmp_path):
    observation, _, _ = ball(24)
    path = tmp_path / "observation.exr"
    write_observation(path, observation)
    found = replace(METHOD.load()(observation), method="silhouette-matrix")
    write_estimate(tmp_path, found, path)
    read = read_estimate(tmp_path, "silhouette-matrix")[0]
    assert np.array_equal(read.albedo, found.albedo, equal_nan=True)


def test_a_large_picture_gets_its_normals_and_albedo_pixel_by_pixel():
    observation, normals, albedo = ball()
    found = METHOD(observation, most_pixels=300)
    given = found.valid
    assert given.sum() > 0.9 * observation.mask.sum()
    assert np.median(angles_deg(found.normals[given].astype(float), normals[given])) < 4
    assert np.std(np.log(found.albedo[given] / albedo[given])) < 0.1
