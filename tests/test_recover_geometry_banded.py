"""Band matrices eliminated from both ends, against dense matrices; the threads change nothing."""

import numpy as np
import pytest

from huesphere.recover.geometry import banded
from huesphere.recover.geometry.banded import FLOATING, Part, factor_banded


def random_part(unknowns, band, seed):
    """A part whose forms are single entries, diagonally dominant, with the dense matrix (U, U) that it adds up to."""
    rng = np.random.default_rng(seed)
    row, column = np.array([(i, j) for i in range(unknowns) for j in range(max(0, i - band), i + 1)]).T
    values = np.where(row == column, 2.0 + band, rng.uniform(-0.5, 0.5, len(row)))
    dense = np.zeros((unknowns, unknowns))
    dense[row, column] = dense[column, row] = values
    ints = row[:, None].astype(np.int32), column[:, None].astype(np.int32)
    return Part(values[:, None], np.ones((1, 1)), *ints), dense


@pytest.mark.parametrize(("unknowns", "band"), [(30, 3), (40, 10), (12, 11), (12, 20), (5, 1), (1, 1)])
@pytest.mark.parametrize("sides", [1, 4])
def test_the_solution_is_that_of_the_dense_matrix_and_the_right_sides_stay(unknowns, band, sides):
    part, dense = random_part(unknowns, band, seed=unknowns)
    dense += np.diag(0.25 * np.diag(dense) + FLOATING * np.diag(dense).mean())
    right = np.random.default_rng(1).normal(size=(sides, unknowns))
    kept = right.copy()
    found = factor_banded([part], unknowns, damping=0.25).solve(right)
    assert found == pytest.approx(np.linalg.solve(dense, right.T).T, abs=1e-12)
    assert (right == kept).all()


def test_parts_add_up_and_forms_share_their_products():
    part, dense = random_part(20, 4, seed=2)
    chain = np.arange(19, dtype=np.int32)[:, None]
    weights = np.random.default_rng(3).uniform(0.5, 1.5, (19, 2))
    products = np.array([[1.0, -1.0, 1.0], [0.5, 0.25, 0.5]])  # entries (i, i), (i + 1, i), (i + 1, i + 1)
    pairs = Part(weights, products, np.hstack([chain, chain + 1, chain + 1]), np.hstack([chain, chain, chain + 1]))
    for i, (diagonal, beside, following) in enumerate(weights @ products):
        dense[i, i] += diagonal
        dense[i + 1, i + 1] += following
        dense[[i, i + 1], [i + 1, i]] += beside
    dense += FLOATING * np.diag(dense).mean() * np.eye(20)
    right = np.random.default_rng(4).normal(size=(2, 20))
    found = factor_banded([part, pairs], 20, damping=0.0).solve(right)
    assert found == pytest.approx(np.linalg.solve(dense, right.T).T, abs=1e-12)


@pytest.mark.parametrize("where", [0, 11, 23])  # in the first part, the separator, the last part
def test_a_matrix_that_is_not_positive_definite_raises(where):
    part, _ = random_part(24, 4, seed=5)
    bad = Part(
        np.where((part.rows == where) & (part.columns == where), -1.0, part.weights),
        part.products,
        part.rows,
        part.columns,
    )
    with pytest.raises(np.linalg.LinAlgError):
        factor_banded([bad], 24, damping=0.0)


def test_threads_change_no_bit(monkeypatch):
    part, _ = random_part(400, 30, seed=6)
    right = np.random.default_rng(7).normal(size=(3, 400))
    solutions = []
    for least in (0.0, np.inf):
        monkeypatch.setattr(banded, "LEAST_WORK_FOR_THREADS", least)
        solutions.append(factor_banded([part], 400, damping=1e-3).solve(right))
    assert (solutions[0] == solutions[1]).all()
