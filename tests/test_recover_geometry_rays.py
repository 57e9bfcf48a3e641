"""Pictures in perspective: a solid seen from near by, of which each ray's point, normal and depth are known."""

from dataclasses import replace

import numpy as np
import pytest
from synthesis import TWIN, median_error
from test_recover_interreflection_removal import ALBEDO, TRUE_F, hills

from huesphere.recover.cues.linear_integrability import judge_integrability, likely_rotations
from huesphere.recover.geometry.blocks import block_means
from huesphere.recover.geometry.rays import height_of, of_relief, of_surface, rays
from huesphere.recover.geometry.rotations import rotation_by
from huesphere.recover.interreflection.removal import remove_interreflection
from huesphere.recover.io.picture import read_picture
from huesphere.recover.methods.table import METHODS
from huesphere.recover.rotation.tangents import tangent_rotation
from huesphere.recover.rotation.weak_form import curl_image, weak_rotation
from huesphere.recover.run import with_depth
from huesphere.render.dataset import CameraInfo, Observation, write_observation
from huesphere.render.relief import gather_without_kernel

START = rotation_by(np.array([0.15, -0.1, 0.2]))


def ellipsoid_seen(side=96, field_of_view=50.0, *, hollow=False, cap=0.35):
    """(camera, t (H, W), normals (H, W, 3), inside (H, W)) of a slanting ellipsoid off the axis, or of its inside.

    t is the depth of each pixel's point along the axis. ``cap``: least cosine of the normals to the line of sight.
    """
    focal = side / 2 / np.tan(np.radians(field_of_view) / 2)
    camera = CameraInfo(projection="perspective", focal_px=focal)
    row, column = np.indices((side, side)) + 0.5
    r = np.stack([column - side / 2, side / 2 - row, np.full((side, side), -focal)], axis=-1) / focal
    far = 1.15 / np.tan(np.radians(field_of_view) / 2) + 0.6
    turn = rotation_by(np.array([0.5, 0.7, 0.3]))
    A = turn @ np.diag([1.0, 1.7, 1.3]) @ turn.T
    centre = np.array([0.12, -0.08, -far])
    aa, ab, bb = (np.einsum("...i,ij,...j->...", u, A, v) for u, v in ((r, r), (r, centre), (centre, centre)))
    root = ab**2 - aa * (bb - 1)
    hit = root > 0
    t = np.where(hit, (ab + (1 if hollow else -1) * np.sqrt(np.maximum(root, 0))) / aa, np.nan)
    n = (t[..., None] * r - centre) @ A * (-1 if hollow else 1)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore"):
        inside = hit & (-(n * r).sum(axis=-1) / np.linalg.norm(r, axis=-1) > cap)
    return camera, t, np.where(inside[..., None], n, 0.0), inside


def picture(noise=0.0, **how):
    """(observation, true normals, t) of it under three coloured lights."""
    camera, t, n, inside = ellipsoid_seen(**how)
    rgb = np.where(inside[..., None], np.maximum(n @ TRUE_F.T, 0), 0.0)
    rgb = 0.9 * rgb / rgb.max() + noise * np.random.default_rng(1).standard_normal(rgb.shape)
    camera = replace(camera, read_noise=noise)
    return Observation(rgb.astype(np.float32), inside, camera), n, t


def turn_deg(found, wanted):
    return float(np.degrees(np.linalg.norm(found - wanted) / np.sqrt(2)))


def test_the_relief_has_the_slopes_of_its_normals():
    camera, t, n, inside = ellipsoid_seen(192)
    ray = rays(camera, t.shape)
    m = of_relief(n, ray)
    Z = -camera.focal_px * np.log(t)
    whole = inside[1:-1, :-2] & inside[1:-1, 2:] & inside[:-2, 1:-1] & inside[2:, 1:-1]
    p, q = (Z[1:-1, 2:] - Z[1:-1, :-2]) / 2, (Z[:-2, 1:-1] - Z[2:, 1:-1]) / 2
    m = m[1:-1, 1:-1][whole]
    steep = 1 + (m[:, 0] / m[:, 2]) ** 2 + (m[:, 1] / m[:, 2]) ** 2
    assert np.abs((p[whole] + m[:, 0] / m[:, 2]) / steep).max() < 5e-3
    assert np.abs((q[whole] + m[:, 1] / m[:, 2]) / steep).max() < 5e-3
    assert np.allclose(of_surface(of_relief(n[inside], ray[inside]), ray[inside]), n[inside])


def test_rays_go_through_pixel_centres_and_blocks_through_their_middles():
    camera = CameraInfo(projection="perspective", focal_px=10.0)
    ray = rays(camera, (4, 6))
    assert ray[0, 0] == pytest.approx([-0.25, 0.15])
    assert np.allclose(ray.mean(axis=(0, 1)), 0)
    assert np.allclose(block_means(ray, 2), rays(replace(camera, focal_px=5.0), (2, 3)))
    assert rays(CameraInfo(), (4, 6)) is None
    assert rays(CameraInfo(projection="perspective"), (4, 6)) is None


def test_a_region_of_a_picture_in_perspective_keeps_its_rays(tmp_path):
    observation, _, _ = picture()
    write_observation(tmp_path / "near.exr", observation)
    cut, _ = read_picture(tmp_path / "near.exr", region=(20, 30, 60, 80))
    assert cut.rgb.shape == observation.rgb.shape
    inside = np.zeros_like(observation.mask)
    inside[30:80, 20:60] = True
    assert np.array_equal(cut.mask, observation.mask & inside)


def test_the_curl_vanishes_along_rays_and_not_along_the_axis():
    camera, _, n, inside = ellipsoid_seen()
    along, across = (np.nanmedian(curl_image(n, inside, ray)) for ray in (rays(camera, inside.shape), None))
    assert along < 0.1 * across


@pytest.mark.parametrize("field_of_view", [20.0, 60.0])
@pytest.mark.parametrize("hollow", [False, True])
def test_the_weak_form_is_exact_in_perspective_and_tells_bump_from_dent(field_of_view, hollow):
    camera, _, n, inside = ellipsoid_seen(field_of_view=field_of_view, hollow=hollow)
    weak = weak_rotation(n @ START, inside, [np.eye(3)], rays(camera, inside.shape))
    assert turn_deg(weak.rotation, START) < 0.05  # and not its twin
    assert turn_deg(weak.twin, TWIN @ START) < 40
    assert weak.twin_ratio > 1.5
    assert weak.converged
    parallel = weak_rotation(n @ START, inside, [np.eye(3)])
    assert min(turn_deg(parallel.rotation, T @ START) for T in (np.eye(3), TWIN)) > 0.3


def test_far_from_the_camera_twins_are_alike():
    camera, _, n, inside = ellipsoid_seen(field_of_view=0.5)
    weak = weak_rotation(n @ START, inside, [np.eye(3)], rays(camera, inside.shape))
    assert weak.twin_ratio < 1.3
    assert min(turn_deg(weak.rotation, T @ START) for T in (np.eye(3), TWIN)) < 0.1


@pytest.mark.parametrize("hand", [1.0, -1.0])
def test_tangents_are_exact_in_perspective(hand):
    camera, _, n, inside = ellipsoid_seen()
    ray = rays(camera, inside.shape)
    N, noise = hand * n @ START, 1e-6 * np.eye(3)
    found = tangent_rotation(N, inside, noise, [hand * TWIN], ray)
    assert turn_deg(found.rotation, hand * START) < 0.1
    assert found.converged
    assert found.twin_ratio > 1.5
    assert turn_deg(tangent_rotation(N, inside, noise, [hand * np.eye(3)]).rotation, hand * START) > 0.3


def test_a_shell_is_judged_by_the_surface_that_its_rays_see():
    camera, _, n, inside = ellipsoid_seen(field_of_view=60)
    ray = rays(camera, inside.shape)
    along, across = (judge_integrability(n @ START, inside, np.eye(3), noise=1e-4, ray=r).curl for r in (ray, None))
    assert along < 0.5 * across
    best = likely_rotations(n @ START, inside, np.eye(3), noise=1e-4, count=1, ray=ray)[0]
    assert turn_deg(best, START) < 6  # directions are 4° apart


@pytest.mark.parametrize("method", ["weak-integrability", "robust", "auto"])
def test_normals_are_as_right_in_perspective(method):
    observation, n, _ = picture()
    estimate = METHODS[method](observation)
    blind = METHODS[method](replace(observation, camera=CameraInfo()))
    assert estimate.status == "ok"
    assert median_error(estimate, n) < 0.1
    assert median_error(blind, n) > 4 * median_error(estimate, n)


def test_depth_and_F_are_fitted_together_along_rays():
    observation, n, _ = picture(3e-3, side=128)
    alone, jointly = (METHODS[method](observation) for method in ("weak-integrability", "auto"))
    assert jointly.diagnostics["joint"]["used"]
    assert jointly.diagnostics["joint"]["misfit"] == pytest.approx(1.18, abs=0.06)  # noise
    assert median_error(jointly, n) < 0.7 * median_error(alone, n)


def test_depth_is_that_of_the_points_up_to_one_factor():
    observation, _, t = picture()
    estimate = with_depth(METHODS["weak-integrability"](observation), observation)
    told = observation.mask & np.isfinite(estimate.depth)
    ratio = (observation.camera.focal_px - estimate.depth[told]) / t[told]
    assert told.sum() == observation.mask.sum()
    assert ratio.std() < 1e-3 * ratio.mean()
    assert np.median(estimate.depth[told]) == pytest.approx(0, abs=0.05 * observation.camera.focal_px)


def test_a_bowl_sends_itself_the_same_light_from_wherever_it_is_seen():
    """A patch fills its share of a sphere from any point of the inside: that ties angles to distances."""
    sums, side, half = [], 96, np.radians(40)
    for field_of_view in (25.0, 60.0):
        focal = side / 2 / np.tan(np.radians(field_of_view) / 2)
        row, column = np.indices((side, side)) + 0.5
        r = np.stack([column - side / 2, side / 2 - row, np.full((side, side), -focal)], axis=-1) / focal
        centre = np.array([0.2, -0.15, -1.5 / np.tan(np.radians(field_of_view) / 2)])
        rr, rc = (r * r).sum(axis=-1), r @ centre
        t = (rc + np.sqrt(np.maximum(rc**2 - rr * (centre @ centre - 1), 0))) / rr
        away = t[..., None] * r - centre
        mask = (np.abs(np.linalg.norm(away, axis=-1) - 1) < 1e-9) & (
            away @ centre > np.cos(half) * np.linalg.norm(centre)
        )
        height = np.where(mask, height_of(-focal * np.log(t / t[mask].mean()), focal), 0.0)
        normals = np.where(mask[..., None], -away, [0.0, 0.0, 1.0])
        filled = gather_without_kernel(height, mask, normals, np.ones((mask.sum(), 1)), azimuths=24, focal_px=focal)
        assert filled.std() < 0.01 * filled.mean()
        sums.append(filled.mean())
    share = (1 - np.cos(half)) / 2
    assert sums == pytest.approx([share, share], rel=0.07)  # less what the border's half pixels would send


def test_light_of_the_parts_is_taken_out_along_rays():
    relief, m, inside = hills()
    camera = CameraInfo(projection="perspective", focal_px=60.0)
    n = of_surface(m, rays(camera, inside.shape))
    height = np.where(inside, height_of(relief - relief[inside].mean(), camera.focal_px), 0.0)
    normals = np.where(inside[..., None], n, [0.0, 0.0, 1.0])
    direct = np.maximum(n[inside] @ TRUE_F.T, 0)
    total = direct.copy()
    for _ in range(10):
        total = direct + ALBEDO * gather_without_kernel(
            height, inside, normals, total, azimuths=48, focal_px=camera.focal_px
        )
    rgb = np.zeros((*inside.shape, 3), np.float32)
    rgb[inside] = 0.9 * total / total.max()
    observation = Observation(rgb, inside, camera)
    plain = METHODS["weak-integrability"](observation)
    clean, _, removal = remove_interreflection(observation, METHODS["weak-integrability"])
    assert removal is not None
    assert removal.albedo == pytest.approx(ALBEDO, abs=0.03)
    assert median_error(clean, n) < 0.3 * median_error(plain, n)
