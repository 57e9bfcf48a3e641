"""Pairs of neighbouring pixels: each pair once, the form that the Laplacian is of, and the pieces they connect."""

import numpy as np
import pytest
from scipy import ndimage

from huesphere.recover.geometry.neighbours import components, edges_within, laplacian


@pytest.fixture(params=range(4))
def mask(request) -> np.ndarray:
    return np.random.default_rng(request.param).random((9, 12)) < 0.6


def test_every_pair_of_neighbours_is_there_once_to_the_right_or_upward(mask):
    edges, (row, column) = edges_within(mask), np.nonzero(mask)
    right = (row[edges.j] == row[edges.i]) & (column[edges.j] == column[edges.i] + 1)
    up = (row[edges.j] == row[edges.i] - 1) & (column[edges.j] == column[edges.i])
    assert (np.where(edges.upward, up, right)).all()
    pairs = {(min(pair), max(pair)) for pair in zip(edges.i.tolist(), edges.j.tolist())}
    assert len(pairs) == len(edges.i) == (mask[:, 1:] & mask[:, :-1]).sum() + (mask[1:] & mask[:-1]).sum()


def test_the_laplacian_with_degrees_on_its_diagonal_is_that_of_the_weighted_squares(mask):
    edges, count = edges_within(mask), int(mask.sum())
    rng = np.random.default_rng(1)
    weight, z = rng.uniform(0.1, 2.0, len(edges.i)), rng.normal(size=count)
    degree = np.bincount(edges.i, weight, count) + np.bincount(edges.j, weight, count)
    A = laplacian(edges, weight, degree)
    assert z @ (A @ z) == pytest.approx((weight * (z[edges.j] - z[edges.i]) ** 2).sum(), rel=1e-12)
    assert abs(A - A.T).max() == 0


def test_components_are_those_of_an_image_labelled_by_its_4_neighbours(mask):
    edges = edges_within(mask)
    found = components(edges, int(mask.sum()), np.ones(len(edges.i), bool))
    labelled = ndimage.label(mask)[0][mask] - 1
    assert (found[:, None] == found).tolist() == (labelled[:, None] == labelled).tolist()
    alone = components(edges, int(mask.sum()), np.zeros(len(edges.i), bool))
    assert len(np.unique(alone)) == mask.sum()
