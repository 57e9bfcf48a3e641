"""Slopes, integrability and shading, on surfaces known in closed form."""

import numpy as np
from test_eval_fabricated_run import bump, rotation

from huesphere.eval import slopes


def test_slopes_are_the_derivatives_of_depth():
    depth, normals, mask = bump(128)
    p, q = slopes.slopes(normals)
    inner = np.zeros_like(mask)
    inner[2:-2, 2:-2] = mask[2:-2, 2:-2] & mask[4:, 2:-2] & mask[:-4, 2:-2] & mask[2:-2, 4:] & mask[2:-2, :-4]
    z_x = (np.roll(depth, -1, axis=1) - np.roll(depth, 1, axis=1)) / 2
    z_y = -(np.roll(depth, -1, axis=0) - np.roll(depth, 1, axis=0)) / 2  # rows grow downwards, y upwards
    assert np.median(np.abs(p - z_x)[inner]) < 1e-3
    assert np.median(np.abs(q - z_y)[inner]) < 1e-3


def test_a_surface_is_integrable_and_turned_normals_are_not():
    _, normals, mask = bump(128)
    true = slopes.integrability_error(normals, mask)
    turned = slopes.integrability_error(normals @ rotation("x", 20).T, mask)
    assert np.nanmedian(true) < 1e-4
    assert np.nanmedian(turned) > 30 * np.nanmedian(true)


def test_the_twin_is_as_integrable_as_the_surface():
    _, normals, mask = bump(64)
    a = slopes.integrability_error(normals, mask)
    b = slopes.integrability_error(normals * [-1, -1, 1], mask)
    np.testing.assert_array_equal(a, b)


def test_derivatives_do_not_reach_over_the_edge_of_the_mask():
    _, normals, mask = bump(32)
    mask = mask & (np.arange(32) < 20)
    error = slopes.integrability_error(normals, mask)
    assert np.isnan(error[:, 19:]).all()
    assert np.isfinite(error[16, 18])


def test_unrotated_normals_are_the_true_ones_up_to_an_orthogonal_matrix():
    _, normals, mask = bump(64)
    F = np.array([[0.9, 0.1, 0.5], [0.2, 0.7, 0.6], [-0.3, 0.2, 0.8]])
    N = slopes.unrotated_normals(normals @ F.T, np.linalg.inv(F @ F.T))[mask]
    np.testing.assert_allclose(np.linalg.norm(N, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(N[:50] @ N[:50].T, normals[mask][:50] @ normals[mask][:50].T, atol=1e-12)


def test_what_faces_away_from_the_light_is_black_and_what_is_unknown_stays_unknown():
    shading = slopes.shade(np.array([[[-1.0, 0.0, 0.1], [np.nan, 0.0, 1.0], [1.0, 0.0, 1.0]]]) / np.sqrt(2))
    np.testing.assert_allclose(shading, [[0.0, np.nan, 1.0]])
