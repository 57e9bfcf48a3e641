"""Depth over gaps: against a dense solution, exact surfaces, the published model, and an occlusion."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import null_space

import huesphere.recover.depth.integration as depth_module
from huesphere.recover.depth.integration import depth_from_normals, depth_from_slopes, rise
from huesphere.recover.geometry.neighbours import edges_within


def relief(size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(z, p, q, mask) of an analytic relief in an ellipse, in pixels."""
    row, column = np.mgrid[:size, :size]
    x, y, k = (column - size / 2) / size, (size / 2 - row) / size, 6 * np.pi
    z = size * (0.06 * np.cos(k * x) * np.cos(0.7 * k * y) - 0.8 * (x * x + 0.6 * y * y))
    p = -0.06 * k * np.sin(k * x) * np.cos(0.7 * k * y) - 1.6 * x
    q = -0.06 * 0.7 * k * np.cos(k * x) * np.sin(0.7 * k * y) - 0.96 * y
    return z, p, q, (x / 0.4) ** 2 + (y / 0.45) ** 2 < 1


def gaps_in(mask: np.ndarray, seed: int = 0) -> np.ndarray:
    """About a tenth of the mask: discs, and a slanted band that cuts it in two."""
    rng, size = np.random.default_rng(seed), len(mask)
    row, column = np.mgrid[:size, :size]
    gap = np.abs(column - 0.6 * size + 0.5 * (row - size / 2)) < 0.012 * size
    for _ in range(14):
        a, b = rng.uniform(0.1, 0.9, 2) * size
        gap |= (row - a) ** 2 + (column - b) ** 2 < (rng.uniform(0.01, 0.05) * size) ** 2
    return gap & mask


def off(depth: np.ndarray, z: np.ndarray, where: np.ndarray) -> float:
    """RMS difference over ``where``, the mean difference over all aside."""
    error = depth - z
    return float(np.sqrt(np.mean((error - np.nanmean(error))[where] ** 2)))


@pytest.mark.parametrize("model", ["coupled", "poisson", "harris"])
@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_without_gaps_it_is_the_dense_least_squares_solution(model, noise):
    _, p, q, mask = relief(22)
    p, q = (image + noise * np.random.default_rng(0).standard_normal(p.shape) for image in (p, q))
    edges, count = edges_within(mask), int(mask.sum())
    D = np.zeros((len(edges.i), count))
    D[np.arange(len(D)), edges.j], D[np.arange(len(D)), edges.i] = 1, -1
    z = np.linalg.lstsq(D, rise(p[mask], q[mask], np.ones(count, bool), edges))[0]
    found = depth_from_slopes(p, q, mask, mask, model=model)[mask]
    assert np.abs(found - (z - z.mean())).max() < 1e-8


def test_multigrid_and_factorisation_agree(monkeypatch):
    _, p, q, mask = relief(96)
    known = mask & ~gaps_in(mask)
    direct = depth_from_slopes(p, q, known, mask)
    monkeypatch.setattr(depth_module, "DIRECT_UP_TO", 100)
    multigrid = depth_from_slopes(p, q, known, mask)
    assert np.abs(direct - multigrid)[mask].max() < 1e-4


@settings(max_examples=15, deadline=None)
@given(st.floats(-3, 3), st.floats(-3, 3), st.integers(0, 1000))
def test_a_plane_is_exact_over_any_gaps(a, b, seed):
    rng = np.random.default_rng(seed)
    mask = rng.random((18, 20)) < 0.9
    known = mask & (rng.random(mask.shape) < 0.7)
    p, q = np.full(mask.shape, a), np.full(mask.shape, b)
    row, column = np.mgrid[:18, :20]
    for model in ("coupled", "harris"):
        found = depth_from_slopes(p, q, known, mask, model=model)
        edges = edges_within(mask)
        plane = (a * column - b * row)[mask]
        step = (found[mask][edges.j] - found[mask][edges.i]) - (plane[edges.j] - plane[edges.i])
        reached = _reached(edges, known[mask])
        assert np.abs(step[reached[edges.i]]).max(initial=0.0) < 1e-4


def _reached(edges, known: np.ndarray) -> np.ndarray:
    """Pixels whose piece of the mask holds a known slope; nothing can be said of others."""
    reached = known.copy()
    for _ in range(len(known)):
        grown = reached.copy()
        np.logical_or.at(grown, edges.i, reached[edges.j])
        np.logical_or.at(grown, edges.j, reached[edges.i])
        if (grown == reached).all():
            break
        reached = grown
    return reached


def test_coupled_slopes_cross_gaps_better_than_a_membrane():
    z, p, q, mask = relief(128)
    gap = gaps_in(mask)
    coupled, poisson = (depth_from_slopes(p, q, mask & ~gap, mask, model=m) for m in ("coupled", "poisson"))
    assert off(coupled, z, gap) < off(poisson, z, gap) / 3
    assert off(coupled, z, mask & ~gap) < 0.1


def test_coupled_is_the_published_model_where_gaps_count_little():
    _, p, q, mask = relief(64)
    known = mask & ~gaps_in(mask)
    edges = edges_within(mask)
    flat = tuple(np.where(known, image, 0.0)[mask] for image in (p, q))
    published = depth_module._harris(*flat, known[mask], edges, gap_weight=1e-5)
    ours = depth_from_slopes(p, q, known, mask)[mask]
    assert np.abs((published - published.mean()) - ours).max() < 2e-3


def thin_plate(p, q, known, mask) -> np.ndarray:
    """z (P,) by dense algebra: slopes that vary least over all pairs that touch a gap, no difference of depth amiss.

    Harris' energy with a smoothness so small that depths and slopes agree exactly.
    """
    edges, count = edges_within(mask), int(mask.sum())
    pairs, rows = np.arange(len(edges.i)), np.eye(count)
    step, mean = rows[edges.j] - rows[edges.i], (rows[edges.j] + rows[edges.i]) / 2
    agree = np.zeros((len(pairs), 3 * count))
    agree[:, :count], agree[~edges.upward, count : 2 * count] = step, -mean[~edges.upward]
    agree[edges.upward, 2 * count :] = -mean[edges.upward]
    held = np.concatenate([np.pad(rows[known[mask]], ((0, 0), (count * k, count * (2 - k)))) for k in (1, 2)])
    wanted = np.concatenate([np.zeros(len(pairs)), p[mask & known], q[mask & known]])
    touch = ~(known[mask][edges.i] & known[mask][edges.j])
    turn = np.concatenate([np.pad(step[touch], ((0, 0), (count * k, count * (2 - k)))) for k in (1, 2)])
    equal = np.concatenate([agree, held])
    particular = np.linalg.lstsq(equal, wanted)[0]
    free = null_space(equal)
    z = (particular - free @ np.linalg.lstsq(turn @ free, turn @ particular)[0])[:count]
    return z - z.mean()


def test_a_gap_is_bridged_as_by_a_thin_plate():
    """x³ is a thin plate, Δ²z = 0, and its slope no membrane: with a smoothness of 1 the bridge is off by 5 %."""
    row, column = np.mgrid[:13, :13]
    x, y = column - 6.0, 6.0 - row
    p, q, mask = 0.06 * x**2, np.zeros_like(x), np.ones(x.shape, bool)
    known = (np.abs(x) > 3) | (np.abs(y) > 3)
    found = depth_from_slopes(p, q, known, mask)
    height = np.ptp(found[~known])
    assert np.abs(found[mask] - thin_plate(p, q, known, mask)).max() < 1e-3 * height
    assert off(found, 0.02 * x**3, ~known) < 0.05 * height


def test_depth_converges_as_the_grid_is_refined():
    errors = []
    for size in (32, 64, 128):
        z, p, q, mask = relief(size)
        errors.append(off(depth_from_slopes(p, q, mask, mask), z, mask) / size)
    assert np.log2(errors[0] / errors[1]) > 1.7  # second order: the rise is a trapezium
    assert np.log2(errors[1] / errors[2]) > 1.7


def test_depth_may_jump_where_the_robust_model_is_asked():
    row, column = np.mgrid[:64, :64]
    x, y = column - 31.5, 31.5 - row  # two sheets that touch at one point only, as the blades of scissors
    z, q = np.where(x < 0, 0.2 * y, -0.2 * y), np.where(x < 0, 0.2, -0.2)
    mask = np.ones((64, 64), bool)
    robust, plain = (depth_from_slopes(np.zeros((64, 64)), q, mask, mask, model=m) for m in ("robust", "coupled"))
    assert off(plain, z, mask) > 1.5
    assert off(robust, z, mask) < 0.05


def test_pieces_of_the_object_have_mean_zero_each_and_invalid_normals_are_gaps():
    n = np.zeros((20, 31, 3))
    n[..., 2] = 1.0
    mask = np.ones((20, 31), bool)
    mask[:, 15] = False
    valid = np.ones_like(mask)
    n[3:6, 3:6], valid[3:6, 3:6] = np.nan, False
    depth = depth_from_normals(n, valid, mask)
    assert np.isnan(depth[~mask]).all()
    assert np.abs(depth[mask]).max() < 1e-6


def test_normals_of_a_cap_give_its_depth_toward_the_camera():
    """A sphere's normal is position over radius: z = √(R² − x² − y²), x to the right and y up."""
    row, column = np.mgrid[:40, :40]
    x, y, radius = column - 19.5, 19.5 - row, 30.0
    mask = (x - 4) ** 2 + (y + 3) ** 2 < 14**2  # not about the middle, where x and y could change places
    z = np.sqrt(radius**2 - x**2 - y**2)
    n = np.stack([x, y, z], axis=-1) / radius
    assert off(depth_from_normals(n, mask, mask), z, mask) < 0.01


def test_a_normal_nearly_edge_on_has_no_slope_that_counts():
    """It is a gap, bridged by the slopes about it, and not a cliff."""
    n, mask = np.zeros((15, 15, 3)), np.ones((15, 15), bool)
    n[...] = [-0.6, 0.0, 0.8]
    n[7, 7] = [-np.sqrt(1 - 0.01**2), 0.0, 0.01]
    depth = depth_from_normals(n, mask, mask)
    np.testing.assert_allclose(np.diff(depth, axis=1), 0.75, atol=1e-6)


def test_a_wrong_model_or_shape_is_named():
    n, mask = np.zeros((4, 4, 3)), np.ones((4, 4), bool)
    with pytest.raises(ValueError, match="expected one of coupled"):
        depth_from_normals(n, mask, mask, model="magic")
    with pytest.raises(ValueError, match="do not agree"):
        depth_from_normals(n, mask[:2], mask)


def test_without_any_known_slope_depth_is_flat():
    mask = np.ones((6, 7), bool)
    nothing = np.full(mask.shape, np.nan)
    for model in ("coupled", "poisson", "robust", "harris"):
        assert depth_from_slopes(nothing, nothing, ~mask, mask, model=model) == pytest.approx(0.0, abs=1e-9)
