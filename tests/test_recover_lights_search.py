"""Joint estimation of lights and shape: when it is believed, and what `robust` and `auto` make of it."""

import numpy as np
import pytest
from synthesis import angles_deg, dome, problem_of_colours, shade, solution_of
from test_recover_lights_lit_surface import OFF_DEG, turned
from test_recover_methods import documented
from test_recover_methods_initial import COLOURS, NOISE, ROBUST, TOWARD, automatic, seldom_all_lit

from huesphere.recover.lights.parameters import LIGHTS
from huesphere.recover.lights.search import estimate_jointly
from huesphere.recover.methods.parameters import METHOD
from huesphere.render.dataset import CameraInfo

pytestmark = pytest.mark.usefixtures("as_the_method_says")  # the verdict has tests of its own


def test_a_picture_that_no_lights_make_is_not_believed():
    observation, _, all_lit, F = seldom_all_lit()
    rng = np.random.default_rng(3)
    patchy = np.kron(rng.uniform(0.3, 1.0, (12, 12, 3)), np.ones((8, 8, 1)))  # paint of many colours
    problem = problem_of_colours(observation.rgb * patchy, observation.mask, NOISE)
    found, diagnostics = estimate_jointly(problem, solution_of(F, all_lit, OFF_DEG))
    assert found is None
    assert not diagnostics["used"]
    assert diagnostics["loss"] > LIGHTS.believed_loss


def test_what_is_believed_brings_its_pixels_and_how_sure_they_are():
    observation, normals, all_lit, F = seldom_all_lit()
    problem = problem_of_colours(observation.rgb, observation.mask, NOISE)
    found, diagnostics = estimate_jointly(problem, solution_of(turned(F, OFF_DEG), all_lit, OFF_DEG))
    assert found is not None
    by_all = found.solution
    assert diagnostics["turned_deg"] == pytest.approx(OFF_DEG, abs=1.0)
    assert all_lit[by_all.inlier].mean() > 0.9
    assert by_all.inlier[all_lit].mean() > 0.8
    stderr = by_all.rotation_stderr_deg
    n = normals[all_lit]
    again = n @ F.T @ np.linalg.inv(by_all.F).T
    error = np.median(angles_deg(again / np.linalg.norm(again, axis=1, keepdims=True), n))
    assert error / 3 < stderr < 3.0


def test_robust_asks_the_whole_picture_where_the_rotation_is_in_doubt():
    normals, mask = dome(96, elongation=1.2, cap=0.85, bumps=0.25)
    mask[:, :30] = False  # the rest of an object: its silhouette is no occluding contour
    noise = 3e-3
    camera = CameraInfo(read_noise=noise)
    observation, _ = shade(normals, mask, COLOURS, directions=TOWARD, noise=noise, camera=camera)
    estimate = ROBUST(observation)
    diagnostics = estimate.diagnostics["whole_picture"]
    assert diagnostics["used"]
    assert set(diagnostics) <= documented()["whole_picture"]
    assert estimate.status == "ok"
    assert (
        diagnostics["first_rotation_stderr_deg"]
        > METHOD.undetermined_rotation_deg
        > estimate.diagnostics["rotation_stderr_deg"]
    )
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
