"""The grid of depths: least squares on slopes against dense matrices, interpolation, degrees of freedom."""

import numpy as np
import pytest

from huesphere.recover.geometry.depth_grid import DepthGrid, variation_within_cells

RNG = np.random.default_rng(0)


def region(shape=(7, 9)):
    inside = np.ones(shape, bool)
    inside[:2, :3] = inside[5:, 7:] = inside[3, 4] = False
    return inside


def grid_of(inside, block=1):
    return DepthGrid(np.zeros((*inside.shape, 3)), inside, block)


def slope_operator(grid):
    """(2P, U): slopes of the cells by the depths at the corners, x then y of each cell."""
    D = np.zeros((2 * len(grid), grid.unknowns))
    for cell, corners in enumerate(grid.corners):
        for axis in range(2):
            D[2 * cell + axis, corners] += grid.gradient[axis]
    return D


def random_weights(count):
    A = RNG.normal(size=(count, 2, 3))
    return A @ A.swapaxes(1, 2) + 0.1 * np.eye(2)


@pytest.mark.parametrize("shape", [(7, 9), (9, 7)])  # the band runs along the shorter side
def test_slopes_are_those_of_the_dense_least_squares_solution(shape):
    grid = grid_of(region(shape) if shape == (7, 9) else region((7, 9)).T)
    W, wanted, D = random_weights(len(grid)), RNG.normal(size=(len(grid), 2, 2)), slope_operator(grid)
    root = np.linalg.cholesky(W).swapaxes(1, 2)
    rows = np.concatenate([np.einsum("pij,pju->piu", root, D.reshape(len(grid), 2, -1)).reshape(-1, grid.unknowns)])
    expected = D @ np.linalg.lstsq(rows, np.einsum("pij,pjk->pik", root, wanted).reshape(-1, 2), rcond=None)[0]
    found = grid.least_squares_slopes(W, np.ones(len(grid)), wanted)
    assert found.reshape(-1, 2) == pytest.approx(expected, abs=2e-2 * np.abs(wanted).max())  # twist is weighted 1e-3


def test_a_plane_is_found_exactly_whatever_the_weights():
    grid = grid_of(region())
    tilt = np.broadcast_to([0.3, -0.7], (len(grid), 2))
    found = grid.least_squares_slopes(random_weights(len(grid)), np.ones(len(grid)), tilt[..., None])[..., 0]
    assert found == pytest.approx(tilt, abs=1e-5)


def test_a_slope_is_per_pixel_whatever_the_side_of_a_cell_and_y_points_up():
    grid = grid_of(np.ones((12, 12), bool), 3)
    row, column = np.divmod(np.arange(5 * 5), 5)  # corners, numbered by rows
    z = 0.5 * 3 * column - 0.25 * 3 * row
    assert (slope_operator(grid) @ z).reshape(-1, 2) == pytest.approx(np.broadcast_to([0.5, 0.25], (16, 2)))


def test_the_factor_with_bonds_is_of_the_form_that_is_documented():
    grid = grid_of(region())
    W, bonds = random_weights(len(grid)), RNG.uniform(0.5, 2, sum(map(len, grid.pairs)))
    right, D = RNG.normal(size=(len(grid), 2, 1)), slope_operator(grid)
    form = np.zeros((2 * len(grid),) * 2)
    for cell in range(len(grid)):
        form[2 * cell : 2 * cell + 2, 2 * cell : 2 * cell + 2] = W[cell]
    for bond, (one, other) in zip(bonds, np.concatenate(grid.pairs)):
        for axis in range(2):
            difference = np.zeros(2 * len(grid))
            difference[2 * one + axis], difference[2 * other + axis] = -1, 1
            form += bond * np.outer(difference, difference)
    expected = D @ np.linalg.pinv(D.T @ form @ D, hermitian=True) @ D.T @ right.ravel()
    found = grid.solve(grid.factor(W[:, 0, 0], W[:, 0, 1], W[:, 1, 1], bonds=bonds), right)
    assert found.ravel() == pytest.approx(expected, abs=5e-3 * np.abs(expected).max())


def test_a_form_that_is_not_positive_definite_raises():
    grid = grid_of(region())
    one = np.ones(len(grid))
    with pytest.raises(np.linalg.LinAlgError):
        grid.factor(-one, 0 * one, -one)


def test_cells_hold_means_over_their_pixels_inside_and_few_pixels_make_no_cell():
    image, inside = RNG.normal(size=(6, 6, 2)), np.ones((6, 6), bool)
    inside[0, 0] = False
    inside[3:, 3:5] = False  # six of nine pixels
    grid = DepthGrid(image, inside, 3, ray=image)
    assert grid.where.tolist() == [[True, True], [True, False]]
    assert grid.count.tolist() == [8, 9, 9]
    assert grid.mean[0] == pytest.approx(image[:3, :3].reshape(9, 2)[1:].mean(axis=0))
    assert grid.ray == pytest.approx(grid.mean)


def test_freedom_counts_what_noise_leaves():
    """Σ squares of white residuals that remain after the fit has that expectation, and three more for a rotation."""
    inside = np.ones((8, 9), bool)
    inside[:, 4] = False  # two pieces
    grid = grid_of(inside)
    D = slope_operator(grid)
    assert grid.pieces == 2
    assert grid.freedom == D.shape[0] - np.linalg.matrix_rank(D) - 3


def test_interpolation_is_exact_for_a_linear_image():
    grid = grid_of(np.ones((5, 6), bool))
    row, column = np.nonzero(grid.where)
    at = np.array([[1.25, 3.5], [2.5, 0.75]])
    found = grid.interpolated((2.0 * row - column)[:, None], at)
    assert found[:, 0] == pytest.approx(2 * at[0] - at[1])


def test_cells_near_the_edge_are_told_by_the_pixels():
    grid = grid_of(np.ones((20, 20), bool), 2)
    assert grid.well_within(4).sum() == 6 * 6
    assert grid.well_within(1).sum() == 8 * 8


def test_colours_do_not_vary_within_cells_of_a_plane_and_do_on_a_curve():
    grid = grid_of(np.ones((9, 9), bool))
    _, column = np.nonzero(grid.where)
    J = np.broadcast_to(np.array([[1.0, 0], [1.0, 0], [1.0, 0]]), (len(grid), 3, 2))
    inner = grid.well_within(1)
    linear = np.stack([0.1 * column, 0.0 * column], axis=-1)
    curved = np.stack([0.1 * (column - 4.0) ** 2, 0.0 * column], axis=-1)
    assert variation_within_cells(grid, linear, J)[inner] == pytest.approx(0, abs=1e-12)
    # Neighbours' mean of x² is x² + 2/3; a quarter of that difference is taken.
    assert variation_within_cells(grid, curved, J)[inner] == pytest.approx(0.1 * 2 / 3 / 4)
