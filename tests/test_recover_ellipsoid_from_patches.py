"""The search from patches to the chosen ellipsoid: the noise it assumes, its small grid, and what it refuses."""

import numpy as np
import pytest
from synthesis import dome, shade
from test_recover_ellipsoid_candidates import COLOURS, WIDE, problem_of

from huesphere.recover.ellipsoid import from_patches
from huesphere.recover.ellipsoid.from_patches import LEAST_NOISE, choose_ellipsoid, find_candidates
from huesphere.recover.ellipsoid.parameters import ELLIPSOID
from huesphere.recover.parameters import overridden
from huesphere.recover.status import RecoveryFailure
from huesphere.render.dataset import CameraInfo

NOISE = 3e-3
UNKNOWN = CameraInfo(known=False)


@pytest.fixture(scope="module")
def scene():
    """(problem, all-lit, true C): a dome under four lights 63–65° off axis; 30 % of the pixels see all of them."""
    normals, mask = dome(112, elongation=1.1, bumps=0.15, cap=0.95)
    observation, F = shade(normals, mask, COLOURS, directions=WIDE, noise=NOISE)
    return problem_of(observation.rgb, mask, 0.0), (normals @ WIDE.T > 0).all(axis=-1) & mask, np.linalg.inv(F @ F.T)


def error(C: np.ndarray, true: np.ndarray) -> float:
    return float(np.linalg.norm(C - true) / np.linalg.norm(true))


def test_the_chosen_ellipsoid_is_that_of_the_all_lit_pixels(scene):
    problem, all_lit, true = scene
    chosen = choose_ellipsoid(problem, UNKNOWN)
    assert error(chosen.refitted.fit.C, true) < 0.05
    assert chosen.share == pytest.approx(all_lit.sum() / problem.usable.sum(), rel=0.15)
    assert chosen.margin > 0
    assert chosen.silhouette is not None


def test_on_block_means_it_is_the_same_ellipsoid_refitted_at_full_size(scene):
    problem, all_lit, true = scene
    with overridden(ELLIPSOID, working_area_px=3000):
        search = find_candidates(problem, UNKNOWN)
        chosen = choose_ellipsoid(problem, UNKNOWN)
    assert search.block == 2
    assert search.grid.problem.noise == pytest.approx(search.noise / 2)
    assert chosen.refitted.inlier.shape == problem.usable.shape
    assert error(chosen.refitted.fit.C, true) < 0.05
    assert (chosen.refitted.inlier & ~all_lit).sum() < 0.2 * chosen.refitted.inlier.sum()


def test_noise_that_a_camera_reports_is_used_and_else_it_is_measured(scene):
    problem, _, _ = scene
    reported = find_candidates(problem, CameraInfo(read_noise=5e-3, known=True))
    assert (reported.noise, reported.known_noise) == pytest.approx((5e-3, 5e-3))
    measured = find_candidates(problem, UNKNOWN)
    assert measured.noise == pytest.approx(NOISE, rel=0.2)
    assert measured.known_noise == 0.0


def test_no_less_noise_is_assumed_than_rounding(scene):
    problem, _, _ = scene
    found = find_candidates(problem, CameraInfo(read_noise=1e-9, known=True))
    assert found.noise == pytest.approx(LEAST_NOISE * problem.rgb[problem.usable].max())


def test_where_little_grows_more_noise_is_tried(scene, monkeypatch):
    problem, _, _ = scene
    tried = []
    grow = from_patches.grow_candidates
    monkeypatch.setattr(from_patches, "grow_candidates", lambda p, **k: tried.append(p.noise) or grow(p, **k))
    find_candidates(problem, CameraInfo(read_noise=NOISE, known=True))
    assert len(tried) == 1
    with overridden(ELLIPSOID, least_support=2.0, noise_factors=(1.0, 3.0)):
        find_candidates(problem, CameraInfo(read_noise=NOISE, known=True))
    assert tried[1:] == pytest.approx([NOISE, 3 * NOISE])


def test_colours_of_no_surface_are_refused():
    mask = np.ones((60, 60), bool)
    rgb = np.random.default_rng(0).uniform(0.0, 1.0, (60, 60, 3))
    with pytest.raises(RecoveryFailure, match="no-dominant-shell"):
        choose_ellipsoid(problem_of(rgb, mask, 0.0), CameraInfo(read_noise=1e-3, known=True))
