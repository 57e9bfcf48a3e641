"""The gather operator of a relief: against closed forms, its own rates, and rays on the same mesh."""

from pathlib import Path

import numba
import numpy as np
import pytest

from huesphere.render import relief
from huesphere.render.backend import choose_backend, load_mitsuba
from huesphere.render.relief import ReliefKernel, apply_kernel, build_kernel, gather_without_kernel, open_sky
from huesphere.scenes.depth_maps.read import read_depth_map
from huesphere.scenes.surfaces import DepthGrid, depth_mesh, depth_normals

MOZART = Path(__file__).parents[2] / "shared" / "data" / "mozart" / "mozart_depth.npz"


def grid_xy(side):
    """x and y, (side, side), of pixel centres on [−1, 1]², border included, and the step between them."""
    axis = np.linspace(-1, 1, side)
    return axis[None, :] + 0 * axis[:, None], -axis[:, None] + 0 * axis[None, :], 2 / (side - 1)


def normals_of(z_x, z_y):
    n = np.stack([-z_x, -z_y, np.ones_like(z_x)], axis=-1)
    return n / np.linalg.norm(n, axis=-1, keepdims=True)


def waves(side):
    """A smooth relief with valleys that see far: depth, mask, exact normals, step."""
    x, y, step = grid_xy(side)
    z = 0.3 * np.sin(4 * x + 1) * np.cos(3 * y) + 0.1 * np.sin(7 * y - 2 * x)
    z_x = 1.2 * np.cos(4 * x + 1) * np.cos(3 * y) - 0.2 * np.cos(7 * y - 2 * x)
    z_y = -0.9 * np.sin(4 * x + 1) * np.sin(3 * y) + 0.7 * np.cos(7 * y - 2 * x)
    return z, np.ones((side, side), bool), normals_of(z_x, z_y), step


def ones(mask):
    return np.ones((mask.sum(), 1), np.float32)


def dense(kernel: ReliefKernel) -> np.ndarray:
    size = len(kernel.start) - 1
    out = np.zeros((size, size))
    np.add.at(out, (np.repeat(np.arange(size), np.diff(kernel.start)), kernel.index), kernel.weight)
    return out


# ---- closed forms --------------------------------------------------------------------------------------------------


def test_a_plane_gives_itself_no_light_and_sees_the_whole_sky():
    x, y, step = grid_xy(21)
    mask = x**2 + y**2 < 0.9
    for z_x, z_y in ((0.0, 0.0), (1.7, -0.4), (0.3, 5.0)):
        normals = normals_of(np.full_like(x, z_x), np.full_like(x, z_y))
        kernel = build_kernel(z_x * x + z_y * y + 1000, mask, normals, step=step, azimuths=64)
        assert len(kernel.index) == 0
        assert np.abs(kernel.sky[:, 0] - 1).max() < 2e-3  # kinks of the quadrature: steep planes meet the zenith
        assert np.abs(kernel.sky[:, 1:] - 2 / 3 * normals[0, 0]).max() < 2e-3


def test_walls_of_a_groove_see_each_other_as_the_catalogue_says():
    # A differential element and a rectangle at right angles to it, b along the common edge from the element's foot,
    # a high, c away: F = (atan(1/Y) − Y/√(X² + Y²) atan(1/√(X² + Y²))) / 2π, X = a/b, Y = c/b (Howell, catalogue, B-4).
    half, length = 24, 101
    x = np.arange(-half, half + 1.0)
    depth = np.abs(x)[None, :] + np.zeros((length, 1))
    mask = np.ones(depth.shape, bool)
    slope = np.sign(x)[None, :] + np.zeros((length, 1))
    values = gather_without_kernel(depth, mask, normals_of(slope, 0 * slope), ones(mask), azimuths=512).reshape(
        depth.shape
    )
    row = 30
    high, away = half * np.sqrt(2), np.abs(x) * np.sqrt(2)

    def quarter(b):
        root = np.hypot(high / b, away / b)
        return (np.arctan2(b, away) - away / b / root * np.arctan(1 / root)) / (2 * np.pi)

    expected = quarter(row) + quarter(length - 1 - row)
    wall = x != 0
    assert np.abs(values[row] - expected)[wall].max() < 2e-4


def spherical_bowl(side, half_angle=np.pi / 3):
    """A cap of the unit sphere, open to the camera: radius of its mouth, distance from the axis, then as `waves`."""
    x, y, step = grid_xy(side)
    mouth = np.sin(half_angle)
    x, y, step = x * mouth, y * mouth, step * mouth
    radius = np.hypot(x, y)
    z = -np.sqrt(1 - np.minimum(radius, mouth) ** 2)
    return mouth, radius, z, radius <= mouth * (1 + 1e-12), normals_of(-x / z, -y / z), step


def test_in_a_spherical_bowl_every_point_receives_the_same():
    # cosθ cosθ′ / π r² = 1 / 4πR² between any two points of a sphere: K T is the integral of T over 4πR².
    errors = []
    for side in (33, 65, 129):
        mouth, radius, z, mask, normals, step = spherical_bowl(side)
        light = np.maximum(1 - (radius / mouth) ** 2, 0) ** 2  # nothing at the rim, which is a staircase
        values = gather_without_kernel(z, mask, normals, light[mask][:, None], step=step, azimuths=32)[:, 0]
        r = (np.arange(20000) + 0.5) / 20000 * mouth
        expected = np.mean((1 - (r / mouth) ** 2) ** 2 * 2 * np.pi * r / np.sqrt(1 - r**2)) * mouth / (4 * np.pi)
        errors.append(np.sqrt(np.mean((values / expected - 1)[(radius < 0.7 * mouth)[mask]] ** 2)))
    assert errors[-1] < 5e-4
    assert errors[1] < errors[0] / 3
    assert errors[2] < errors[1] / 3


def test_a_bowl_sees_the_sky_through_its_mouth():
    _, radius, z, mask, normals, step = spherical_bowl(129)
    sky = open_sky(z, mask, normals, step=step, azimuths=48)
    bottom = (radius == 0)[mask]
    # The rim is seen 60° off the axis; the staircase cuts it by up to a pixel.
    assert sky[bottom, 0] == pytest.approx(np.sin(np.pi / 3) ** 2, abs=1e-2)
    assert sky[bottom, 3] == pytest.approx(2 / 3 * (1 - np.cos(np.pi / 3) ** 3), abs=1e-2)
    assert np.abs(sky[bottom, 1:3]).max() < 2e-3


# ---- laws ----------------------------------------------------------------------------------------------------------


def test_surface_and_sky_fill_the_hemisphere():
    kernel = build_kernel(*waves(49)[:3], step=waves(49)[3], azimuths=128)
    filled = apply_kernel(kernel, np.ones((49 * 49, 1)))[:, 0]
    assert filled.max() <= 1
    assert filled.mean() > 0.05
    assert np.abs(filled + kernel.sky[:, 0] - 1).reshape(49, 49)[1:-1, 1:-1].max() < 2e-3


def test_light_takes_both_ways_alike():
    z, mask, normals, step = waves(65)
    kernel = build_kernel(z, mask, normals, step=step, azimuths=64)
    x, y, _ = grid_xy(65)
    area = (1 / normals[..., 2]).ravel()
    f, g = np.exp(-8 * ((x - 0.4) ** 2 + y**2)).ravel(), np.exp(-8 * ((x + 0.3) ** 2 + (y - 0.2) ** 2)).ravel()
    there = np.sum(area * f * apply_kernel(kernel, g[:, None])[:, 0])
    back = np.sum(area * g * apply_kernel(kernel, f[:, None])[:, 0])
    assert there == pytest.approx(back, rel=5e-3)


def test_scale_and_height_of_the_origin_do_not_matter():
    z, mask, normals, step = waves(33)
    small = gather_without_kernel(z, mask, normals, ones(mask), step=step)
    large = gather_without_kernel(100 * z + 7, mask, normals, ones(mask), step=100 * step)
    assert np.abs(small - large).max() < 1e-6


def test_entries_are_positive_and_rows_hold_less_than_a_hemisphere():
    z, mask, normals, step = waves(33)
    kernel = build_kernel(z, mask, normals, step=step, azimuths=16)
    assert kernel.weight.min() > 0
    assert 0.1 < dense(kernel).sum(axis=1).max() <= 1


def test_rows_asked_for_are_those_of_the_whole_and_progress_is_told():
    z, mask, normals, step = waves(40)
    values = np.random.default_rng(0).random((mask.sum(), 2))
    whole = gather_without_kernel(z, mask, normals, values, step=step, seed=3)
    chosen = np.array([5, 17, 900, 1599])
    told: list[float] = []
    few = gather_without_kernel(z, mask, normals, values, step=step, seed=3, rows=chosen, report=told.append)
    assert np.array_equal(few, whole[chosen])
    assert told == sorted(told)
    assert told[-1] == 1


@pytest.mark.parametrize("azimuths", [11, 23])
def test_coarse_strides_far_off_cost_less_than_a_fifth_of_the_sampling_error(monkeypatch, azimuths):
    z, mask, normals, step = waves(240)
    x, y, _ = grid_xy(240)
    mask &= x**2 + y**2 < 0.9
    light = (0.5 + 0.5 * np.sin(9 * x) * np.sin(7 * y))[mask][:, None]
    near, far = (gather_without_kernel(z, mask, normals, light, step=step, azimuths=azimuths, seed=s) for s in (0, 1))
    sampling = np.sqrt(np.mean((near - far) ** 2) / 2)
    monkeypatch.setattr(relief, "FINE", 10_000)
    every = gather_without_kernel(z, mask, normals, light, step=step, azimuths=azimuths, seed=0)
    difference = np.sqrt(np.mean((every - near) ** 2))
    assert 0 < difference < 0.2 * sampling


def test_the_stored_operator_and_the_direct_one_are_the_same_bits():
    z, mask, normals, step = waves(40)
    values = np.random.default_rng(0).random((mask.sum(), 3))
    stored = apply_kernel(build_kernel(z, mask, normals, step=step, seed=3), values)
    assert np.array_equal(stored, gather_without_kernel(z, mask, normals, values, step=step, seed=3))


def test_the_seed_decides_and_the_number_of_threads_does_not():
    z, mask, normals, step = waves(40)
    first = build_kernel(z, mask, normals, step=step, seed=1)
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        again = build_kernel(z, mask, normals, step=step, seed=1)
    finally:
        numba.set_num_threads(threads)
    assert np.array_equal(first.weight, again.weight)
    assert np.array_equal(first.index, again.index)
    other = build_kernel(z, mask, normals, step=step, seed=2)
    assert len(other.weight) != len(first.weight) or not np.array_equal(first.weight, other.weight)


def test_what_is_off_the_mask_neither_shines_nor_hides():
    # Two facing walls, the valley between them cut away, go on seeing each other; light that lay in it is gone.
    x, _, step = grid_xy(41)
    depth, mask, normals = np.abs(x), np.ones(x.shape, bool), normals_of(np.sign(x), 0 * x)
    kept = np.abs(x) > 0.3
    holed = np.where(kept, depth, np.nan)
    high, low = (np.abs(x) > 0.5).astype(float), (np.abs(x) < 0.25).astype(float)
    light = np.stack([high, low], axis=-1)
    whole = gather_without_kernel(depth, mask, normals, light[mask], step=step, azimuths=128).reshape(41, 41, 2)
    cut = gather_without_kernel(holed, kept, normals, light[kept], step=step, azimuths=128)
    far = np.abs(x) > 0.7
    assert cut[far[kept], 0].mean() == pytest.approx(whole[far, 0].mean(), rel=3e-3)
    assert whole[far, 1].mean() > 0.01
    assert cut[:, 1].max() == 0


def test_a_wall_hides_what_is_behind_it():
    x, _, step = grid_xy(61)
    depth = np.abs(x) + np.maximum(0, 0.2 - 2 * np.abs(x))  # a ridge in the middle of a groove
    mask = np.ones(x.shape, bool)
    behind = ((x > 0.02) & (x < 0.15)).reshape(-1, 1)
    seen = gather_without_kernel(depth, mask, depth_normals(depth, mask, step), behind, step=step, azimuths=64).reshape(
        61, 61
    )
    assert seen[:, (x[0] < -0.02) & (x[0] > -0.15)].max() == 0
    assert seen[:, x[0] < -0.5].min() > 0


def test_an_empty_mask_has_an_empty_operator():
    z, mask, normals, step = waves(8)
    kernel = build_kernel(z, ~mask, normals, step=step)
    assert kernel.start.tolist() == [0]
    assert gather_without_kernel(z, ~mask, normals, np.zeros((0, 2)), step=step).shape == (0, 2)


def test_what_makes_no_sense_is_refused():
    z, mask, normals, _ = waves(8)
    with pytest.raises(ValueError, match="expected \\(H, W\\)"):
        build_kernel(z, mask, normals[:, :, :2])
    with pytest.raises(ValueError, match="n_z > 0"):
        build_kernel(z, mask, -normals)
    with pytest.raises(ValueError, match="not finite"):
        build_kernel(np.where(z > 0, np.nan, z), mask, normals)
    with pytest.raises(ValueError, match="azimuths: got 0"):
        build_kernel(z, mask, normals, azimuths=0)


# ---- rates ---------------------------------------------------------------------------------------------------------


def test_the_error_falls_faster_than_the_number_of_azimuths_grows():
    z, mask, normals, step = waves(49)
    light = np.maximum(normals @ np.array([0.6, 0.0, 0.8]), 0)[mask][:, None]
    truth = gather_without_kernel(z, mask, normals, light, step=step, azimuths=1024, seed=9)
    counts = np.array([8, 16, 32, 64])
    errors = [
        np.sqrt(np.mean((gather_without_kernel(z, mask, normals, light, step=step, azimuths=n) - truth) ** 2))
        for n in counts
    ]
    assert np.polyfit(np.log(counts), np.log(errors), 1)[0] < -1.3  # rays: −0.76


def test_the_error_of_the_mesh_falls_with_the_square_of_the_step():
    def at_common_points(side):
        z, mask, normals, step = waves(side)
        values = gather_without_kernel(z, mask, normals, (1 + z)[mask][:, None], step=step, azimuths=96).reshape(
            side, side
        )
        skip = (side - 1) // 16
        return values[::skip, ::skip][2:-2, 2:-2]

    truth = at_common_points(129)
    errors = [np.sqrt(np.mean((at_common_points(side) - truth) ** 2)) for side in (17, 33, 65)]
    assert errors[1] < errors[0] / 2.8
    assert errors[2] < errors[1] / 2.8


# ---- rays on the same mesh -----------------------------------------------------------------------------------------


def gather_by_rays(depth, mask, step, values, chosen, rays):
    """K values at the pixels ``chosen``, by Embree: two independent estimates (2, m, C)."""
    backend = choose_backend()
    if not backend.vectorised:
        pytest.skip(f"rays need LLVM or CUDA: {backend.reason}")
    from huesphere.render.gather import apply_operator
    from huesphere.render.raycast import ray_caster
    from huesphere.scenes.quadrature import fibonacci_lattice

    mesh, _ = depth_mesh(DepthGrid(depth, mask), step)
    # A tenth of the renderer's own offset: what rays lose next to their points is 2e-3 of all at the renderer's.
    caster = ray_caster(load_mitsuba(backend), mesh, 0.001 * step)
    points = caster.vertex_points(chosen)
    out = []
    for seed in range(2):
        shift = np.random.default_rng(seed).random((len(chosen), 2), dtype=np.float32)
        hits = caster.hemisphere_hits(points, slice(0, len(chosen)), fibonacci_lattice(rays), shift)[0]
        out.append(apply_operator(hits, mesh, np.ones((1, values.shape[1])), values, rays))
    return np.stack(out)


def compare_with_rays(depth, mask, step, *, every, rays, azimuths):
    """(relief, mean of rays, RMS of their own error), all in units of the direct light's mean; clear of the rim."""
    normals = depth_normals(depth, mask, step)
    light = np.maximum(normals[mask] @ (np.array([0.5, 0.2, 1.0]) / np.sqrt(1.29)), 0)[:, None]
    inside = mask.copy()
    for shift in ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, -1), (1, -1), (-1, 1)):
        inside &= np.roll(mask, shift, (0, 1))
    inside[[0, -1]] = inside[:, [0, -1]] = False
    chosen = np.flatnonzero(inside[mask])[::every]
    cast = gather_by_rays(depth, mask, step, light, chosen, rays) / light.mean()
    relief = gather_without_kernel(depth, mask, normals, light, step=step, azimuths=azimuths)[chosen] / light.mean()
    return relief, cast.mean(axis=0), np.sqrt(np.mean((cast[0] - cast[1]) ** 2) / 4)


def test_rays_on_the_same_smooth_mesh_agree():
    z, mask, _, step = waves(64)
    relief, cast, error = compare_with_rays(z, mask, step, every=3, rays=4096, azimuths=128)
    assert relief.mean() == pytest.approx(cast.mean(), rel=2e-3)
    assert np.sqrt(np.mean((relief - cast) ** 2)) < 1.5 * error + 2e-4


def test_rays_on_a_scanned_relief_agree():
    if not MOZART.is_file():
        pytest.skip("the range scan is not part of the project, and not beside it")
    grid = read_depth_map(MOZART)
    relief, cast, error = compare_with_rays(grid.depth, grid.mask, 1.0, every=16, rays=4096, azimuths=64)
    assert relief.mean() == pytest.approx(cast.mean(), rel=3e-3)
    assert np.sqrt(np.mean((relief - cast) ** 2)) < 1.5 * error + 3e-4
