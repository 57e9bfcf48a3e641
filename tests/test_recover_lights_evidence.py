"""What speaks for a light: the surface that the pixels that miss it have with those beside them."""

import numpy as np
import pytest
from test_recover_lights_from_shadows import COLOURS, TOWARD, F, angle_deg, bumps

from huesphere.recover.geometry.sphere import on_sphere
from huesphere.recover.lights.evidence import Core, measure, relative_curl, sharpness
from huesphere.recover.lights.model import Light
from huesphere.recover.lights.polish import equations_beside, loss_beside, polished
from huesphere.recover.lights.shadow_regions import ShadowRegions, sheets
from huesphere.recover.lights.sum_fit import fitted_to_sum


@pytest.fixture(scope="module")
def picture():
    """(normals (H, W, 3), mask (H, W), light seen (H, W, 4), colours (H, W, 3)) of a dome in attached shadows."""
    normals, mask = bumps()
    mask &= np.isfinite(normals).all(axis=-1)
    cosine = np.where(mask[..., None], normals, 0.0) @ TOWARD.T
    return np.where(mask[..., None], normals, [0.0, 0.0, 1.0]), mask, cosine > 0, np.maximum(cosine, 0.0) @ COLOURS


def test_a_true_light_has_evidence_and_its_mirror_image_has_none(picture):
    normals, mask, seen, _ = picture
    lit = mask & seen.all(axis=-1)
    own = mask & ~seen[..., 0] & seen[..., 1:].all(axis=-1)
    core = Core(relative_curl(normals, lit), 1e-9, None, False)
    true = measure(normals, own, lit, core, sharp=1.0, flat=False)
    mirrored = np.where(own[..., None], normals - 2 * (normals @ TOWARD[0])[..., None] * TOWARD[0], normals)
    false = measure(mirrored, own, lit, core, sharp=1.0, flat=False)
    assert true.score > 0.5 * own.sum()
    assert false.score < 0.1 * true.score


def test_pixels_without_a_border_to_those_that_see_the_light_are_no_evidence(picture):
    normals, mask, seen, _ = picture
    own = mask & ~seen[..., 0]
    core = Core(0.01, 1e-9, None, False)
    assert measure(normals, own, np.zeros_like(own), core, sharp=1.0, flat=False).score == 0


def test_sharp_are_colours_as_near_as_the_core_and_not_those_spread_over_the_tolerance():
    spread = np.random.default_rng(0).uniform(0, 1e-4, 500)
    assert sharpness(np.full(500, 1e-7), 1e-4, 1e-7) > 0.95
    assert sharpness(spread, 1e-4, 1e-7) < 0.3


def test_polishing_reaches_the_light_from_a_rough_guess(picture):
    _, mask, seen, rgb = picture
    own = mask & ~seen[..., 0] & seen[..., 1:].all(axis=-1)
    strangers = mask & ~seen[..., 1] & seen[..., [0, 2, 3]].all(axis=-1)
    rho = np.concatenate([rgb[own], rgb[strangers][: own.sum() // 4]])
    start = np.concatenate([1.15 * COLOURS[0], TOWARD[0] + [0.0, 0.08, 0.0]])
    end = polished(rho, F, start, 1e-2, 1e-7)
    assert angle_deg(end[3:], TOWARD[0]) < 1e-3
    assert np.allclose(end[:3], COLOURS[0], rtol=1e-3)


def test_regions_tell_which_lights_each_pixel_misses_even_three_at_once(picture):
    normals, mask, seen, rgb = picture
    lit = (mask & seen.all(axis=-1))[mask]
    lights = tuple(Light(a, b, 1, 0.0, 1.0) for a, b in zip(TOWARD, COLOURS))
    regions = ShadowRegions.of_core(rgb[mask], lit, F, 1e-6).with_lights(lights, lit)
    missed = [tuple(np.flatnonzero(~one)) for one in seen[mask]]
    found = [regions.sets[k] if k >= 0 else None for k in regions.label]
    assert np.mean([a == b for a, b in zip(missed, found)]) > 0.97
    assert np.median(angle_deg(regions.normals, normals[mask])) < 1e-4


def test_both_normals_of_a_flat_ellipsoid_are_sheets_of_it():
    rng = np.random.default_rng(0)
    n = rng.standard_normal((50, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    M = np.diag([1.0, 0.5, 1e-9])
    _, above, below = sheets(n @ M.T, M, on_sphere(n @ M.T, M)[0], 1e-6)
    assert (above[:, 2] >= 0).all() or (above[:, 2] <= 0).all()
    assert np.allclose(above * [1, 1, -1], below)


def test_the_sum_of_all_light_holds_colours_that_pixels_leave_open(picture):
    _, mask, seen, rgb = picture
    lights = np.hstack([COLOURS, TOWARD])
    pixels = []
    for k in range(4):
        own = mask & ~seen[..., k] & np.delete(seen, k, axis=-1).all(axis=-1)
        pixels.append((rgb[own][:300], F[None], np.array([0, min(300, own.sum())])))
    start = lights * np.array([1.1, 0.95, 1.0, 1.0])[:, None] ** np.array([1, 1, 1, 0, 0, 0])
    end = fitted_to_sum(pixels, F, start, 1e-3, 2e-3)
    total = np.einsum("ki,kj->ij", end[:, :3], end[:, 3:])
    assert np.linalg.norm(total - F) < 1e-3 * np.linalg.norm(F)
    assert np.allclose(end[:, :3], COLOURS, atol=5e-3)


def test_the_equations_are_the_slope_of_the_loss(picture):
    _, mask, seen, rgb = picture
    own = mask & ~seen[..., 0] & seen[..., 1:].all(axis=-1)
    pixels = (rgb[own][:200], F[None], np.array([0, 200]))
    both, width, step = np.concatenate([1.02 * COLOURS[0], TOWARD[0]]), 1e-2, 1e-6
    _, g = equations_beside(*pixels, both, width)
    for x in range(6):
        move = np.eye(6)[x] * step
        rise = loss_beside(*pixels, both + move, width) - loss_beside(*pixels, both - move, width)
        assert rise * 200 / (2 * step) == pytest.approx(2 * g[x] / width**2, rel=1e-2, abs=1e-2)
