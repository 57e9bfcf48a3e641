"""Large pictures: what a reduced picture is, and that at full size every pixel has the normal of its own colour."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy import ndimage
from synthesis import angles_deg, dome, light_colours, shade

import huesphere.recover.methods.calling as calling
from huesphere.recover.depth import integration
from huesphere.recover.depth.integration import depth_from_slopes
from huesphere.recover.full_size import normals as full_size
from huesphere.recover.full_size.picture import reduced
from huesphere.recover.geometry.reduction import filled, reduction_of
from huesphere.recover.geometry.sphere import on_sphere
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.methods.table import METHODS
from huesphere.recover.reasons import Reason
from huesphere.render.dataset import CameraInfo, KnownLights, Observation

GELS = light_colours("gels")
FEW = 2500  # pixels, to which pictures of these tests are reduced
RNG = np.random.default_rng(3)


@cache
def body(size: int = 150) -> tuple[np.ndarray, np.ndarray]:
    """(normals, mask) of a body with fine bumps."""
    return dome(size, elongation=0.9, bumps=0.04, cap=0.99)


@cache
def recovered(method: str, noise: float, few: int = FEW) -> tuple[Estimate, Observation, np.ndarray]:
    """(estimate on a reduced picture, picture, true normals)."""
    n, mask = body()
    observation = shade(n, mask, GELS, noise=noise)[0]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calling, "MOST_PIXELS", few)
        return METHODS[method](observation), observation, n


# ---- the reduced picture ---------------------------------------------------------------------------------------------


def test_a_small_picture_is_not_reduced_and_a_large_one_to_few_enough_blocks():
    mask = np.ones((100, 130), bool)
    assert reduction_of(mask, mask.sum()) is None
    for most in (200, 1000, 6000):
        by = reduction_of(mask, most)
        assert by.on_object(mask).sum() <= 1.15 * most
        assert by.blocks == (-(-100 // by.factor), -(-130 // by.factor))


@pytest.mark.parametrize("shape", [(90, 120), (91, 118), (97, 101)])
def test_blocks_lie_about_the_middle_and_are_interpolated_linearly(shape):
    by = reduction_of(np.ones(shape, bool), 500)
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    ones = by.blockwise(np.ones(shape))
    assert ones.sum() == shape[0] * shape[1]
    assert np.abs(np.array(by.before) - (np.array(by.blocks) * by.factor - shape) / 2).max() <= 0.5
    whole = ones == by.factor**2
    plane = by.blockwise(2 * y - 3 * x) / np.maximum(ones, 1)
    back = by.linear(filled(plane, whole)[..., None], slice(None))[..., 0]
    inner = (slice(2 * by.factor, -2 * by.factor),) * 2
    assert np.allclose(back[inner], (2 * y - 3 * x)[inner], atol=1e-9)
    rows = slice(7, 23)
    assert np.array_equal(by.linear(plane[..., None], rows), by.linear(plane[..., None], slice(None))[rows])
    assert np.array_equal(by.nearest(plane, rows), by.nearest(plane, slice(None))[rows])


def test_a_block_has_the_mean_colour_and_says_what_is_clipped_or_not_finite():
    rgb = RNG.uniform(0.1, 0.5, (60, 60, 3)).astype(np.float32)
    mask = np.zeros((60, 60), bool)
    mask[:40] = True
    by = reduction_of(np.ones((60, 60), bool), 400)
    assert by.factor == 3
    rgb[0, 0], rgb[3:6, 3:6], rgb[6, 6, 1] = np.nan, np.nan, 0.95
    camera = CameraInfo(
        saturation=0.9, read_noise=0.003, full_well=1000.0, bits=8, projection="perspective", focal_px=90
    )
    lights = KnownLights(np.array([[30.0, 60.0, 90.0]]), np.zeros((0, 3)))
    small = reduced(Observation(rgb, mask, camera, lights), by)
    assert np.allclose(small.rgb[4, 4], rgb[12:15, 12:15].mean(axis=(0, 1)), atol=1e-6)
    assert np.allclose(small.rgb[0, 0], np.nanmean(rgb[:3, :3], axis=(0, 1)), atol=1e-6)
    assert np.isnan(small.rgb[1, 1]).all()
    assert small.rgb[2, 2].max() >= small.camera.saturation
    assert small.mask[:13].all()
    assert not small.mask[13:].any()  # a third of the pixels of block row 13 are on the object
    assert small.camera == replace(camera, read_noise=0.001, full_well=9000.0, bits=9, focal_px=30)
    assert np.allclose(small.lights.positions, [[10, 20, 30]])


# ---- back at full size -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["weak-integrability", "knit"])
def test_without_noise_every_all_lit_pixel_has_the_normal_of_its_own_colour(method):
    estimate, observation, n = recovered(method, 0.0)
    assert estimate.normals.shape == observation.rgb.shape
    assert estimate.steps[-1].startswith("size: ")
    assert estimate.diagnostics["reduction"]["factor"] >= 2
    lit = estimate.reason == Reason.ALL_LIT
    own = on_sphere(observation.rgb[lit].astype(float), estimate.solution.F)[0]
    assert np.quantile(angles_deg(estimate.normals[lit].astype(float), own), 0.99) < 0.02
    assert np.median(angles_deg(estimate.normals[lit].astype(float), n[lit])) < 0.3
    assert np.array_equal(estimate.inlier, lit)
    assert (estimate.valid <= observation.mask).all()
    assert np.isfinite(estimate.normals[estimate.valid]).all()
    assert np.isfinite(estimate.uncertainty_deg[estimate.valid]).all()
    assert np.isnan(estimate.normals[~estimate.valid]).all()


def test_it_is_the_answer_of_the_whole_picture_within_the_stated_error():
    estimate, _, _ = recovered("knit", 0.0)
    whole, _, _ = recovered("knit", 0.0, few=10**9)
    assert "reduction" not in whole.diagnostics
    both = estimate.valid & whole.valid
    assert both.sum() > 0.97 * whole.valid.sum()
    turn = angles_deg(estimate.normals[both].astype(float), whole.normals[both].astype(float))
    stated = np.hypot(estimate.uncertainty_deg, whole.uncertainty_deg)[both]
    assert (turn < stated).mean() > 0.75  # of errors, 55 % are to be within the stated ones and 85 % within twice them
    assert (turn < 2 * stated).mean() > 0.9


def test_in_noise_the_detail_is_kept_that_is_not_noise():
    estimate, observation, n = recovered("weak-integrability", 0.01)
    lit = estimate.reason == Reason.ALL_LIT
    error = np.median(angles_deg(estimate.normals[lit].astype(float), n[lit]))
    own = on_sphere(observation.rgb[lit].astype(float), estimate.solution.F)[0]
    assert error < 0.8 * np.median(angles_deg(own, n[lit]))
    assert 0.5 < np.median(estimate.uncertainty_deg[lit]) / error < 3


def test_the_variance_of_a_normal_is_that_of_many_draws():
    F = GELS[:3].T @ np.array([[0.4, 0.0, 0.9], [-0.2, 0.3, 0.93], [-0.2, -0.3, 0.93]])
    n = np.array([[0.0, 0.0, 1.0], [0.48, -0.6, 0.64]])
    for one in n:
        drawn = F @ one + 1e-4 * RNG.standard_normal((20_000, 3))
        found = on_sphere(drawn, F)[0]
        assert ((found - one) ** 2).sum(axis=1).mean() == pytest.approx(
            1e-8 * full_size._variance(one[None], F)[0], rel=0.05
        )


def test_clipped_black_and_missing_pixels_say_so():
    n, mask = body()
    observation = shade(n, mask, GELS)[0]
    rgb = observation.rgb.copy()
    rgb[70:74, 70:74], rgb[80:84, 70:74], rgb[90:94, 70:74] = np.nan, 1.5, 0.0
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calling, "MOST_PIXELS", FEW)
        whole = Observation(rgb, mask, CameraInfo(saturation=1.2))
        found = METHODS["weak-integrability"](whole)
        filled_in = METHODS["knit"](whole)
    assert (found.reason[70:74, 70:74] == Reason.NOT_FINITE).all()
    assert (found.reason[80:84, 70:74] == Reason.SATURATED).all()
    assert (found.reason[90:94, 70:74] == Reason.DARK).all()
    assert not found.valid[70:74, 70:74].any()
    gap = np.zeros_like(mask)
    gap[70:74, 70:74] = gap[80:84, 70:74] = gap[90:94, 70:74] = True
    assert filled_in.valid[gap].all()
    assert (filled_in.reason[gap] >= Reason.INTERPOLATED).all()
    assert np.median(angles_deg(filled_in.normals[gap].astype(float), n[gap])) < 3


def test_a_failure_stays_one_and_every_pixel_of_the_object_has_a_reason():
    mask = ndimage.binary_dilation(np.zeros((90, 90), bool) | (np.hypot(*np.mgrid[-45:45, -45:45]) < 40))
    grey = Observation((mask[..., None] * RNG.uniform(0.2, 0.8, (90, 90, 1)) * np.ones(3)).astype(np.float32), mask)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calling, "MOST_PIXELS", 1000)
        found = METHODS["weak-integrability"](grey)
    assert found.verdict == "failed"
    assert found.normals.shape == (90, 90, 3)
    assert np.array_equal(found.reason > 0, mask)


# ---- depth -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_the_depth_of_blocks_refined_is_that_of_one_system(monkeypatch, noise):
    y, x = np.mgrid[:160, :170] / 25.0
    mask = np.hypot(x - 3.4, y - 3.2) < 2.9
    mask[:, 165:] = True  # a second part
    known = mask & (np.hypot(x - 2.4, y - 2.7) > 0.4)
    p, q = 0.6 * np.cos(2 * x + y) + 0.3 * np.cos(25 * x), -0.3 * np.cos(2 * x + y) + 0.1
    p, q = p + noise * RNG.standard_normal(p.shape), q + noise * RNG.standard_normal(p.shape)
    one_system = depth_from_slopes(p, q, known, mask)
    monkeypatch.setattr(integration, "MOST_AT_ONCE", 4000)
    found = depth_from_slopes(p, q, known, mask)
    assert np.array_equal(np.isfinite(found), mask)
    assert np.nanstd(found - one_system) < 0.02 * np.nanstd(one_system)
    part = ndimage.label(mask)[0]
    assert np.abs(ndimage.mean(np.nan_to_num(found), part, [1, 2])).max() < 1e-3
