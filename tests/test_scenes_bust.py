"""The built-in bust: a closed, smooth surface with exact normals and the slopes of a scanned relief."""

from itertools import product

import numpy as np
import pytest
import trimesh

from huesphere.scenes.bust import HAIR, HEAD, TORSO, _distance_grid, bust_distance, bust_mesh, joined_distance
from huesphere.scenes.mesh import Mesh

SIDE = 256  # pixels of the picture in which slopes are counted


@pytest.fixture(scope="module")
def bust() -> Mesh:
    return bust_mesh()


@pytest.fixture(scope="module")
def visible_normals(bust: Mesh) -> np.ndarray:
    """Normals (P, 3) of the surface nearest the camera at the centres of the pixels it covers: a z-buffer."""
    pixel = (bust.vertices[:, :2] * [1, -1] + 1) * SIDE / 2 - 0.5  # (V, 2), column and row
    corner = pixel[bust.faces]  # (F, 3, 2)
    lowest = np.ceil(corner.min(axis=1)).astype(int)
    a, ab, ac = corner[:, 0], corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    hits = []
    for offset in product(range(4), repeat=2):
        centre = lowest + offset
        inside = (centre <= corner.max(axis=1)).all(axis=1) & (np.abs(area) > 1e-12)
        face, ap = np.flatnonzero(inside), (centre - a)[inside]
        u = (ap[:, 0] * ac[face, 1] - ap[:, 1] * ac[face, 0]) / area[face]
        v = (ab[face, 0] * ap[:, 1] - ab[face, 1] * ap[:, 0]) / area[face]
        weight = np.stack([1 - u - v, u, v], axis=1)
        hit = weight.min(axis=1) >= 0
        weight, face = weight[hit, :, None], face[hit]
        depth = (weight * bust.vertices[bust.faces[face]]).sum(axis=1)[:, 2]
        normal = (weight * bust.normals[bust.faces[face]]).sum(axis=1)
        hits.append(np.column_stack([centre[face] @ [1, SIDE], depth, normal]))
    found = np.concatenate(hits)
    found = found[np.lexsort((-found[:, 1], found[:, 0]))]
    nearest = np.unique(found[:, 0], return_index=True)[1]
    return found[nearest, 2:] / np.linalg.norm(found[nearest, 2:], axis=1, keepdims=True)


def test_mesh_has_the_declared_form(bust: Mesh) -> None:
    assert bust.vertices.dtype == bust.normals.dtype == np.float64
    assert bust.faces.dtype == bust.material.dtype == np.int32
    assert bust.normals.shape == bust.vertices.shape
    assert bust.material.shape == (len(bust.faces),)
    assert not bust.material.any()
    assert 60_000 < len(bust.faces) < 250_000


def test_surface_is_closed_and_faces_look_outward(bust: Mesh) -> None:
    surface = trimesh.Trimesh(bust.vertices, bust.faces, process=False)
    assert surface.is_watertight
    assert surface.is_winding_consistent
    assert surface.volume > 0
    assert surface.body_count == 1


def test_bust_fills_the_picture_with_a_margin(bust: Mesh) -> None:
    low, high = bust.vertices[:, :2].min(axis=0), bust.vertices[:, :2].max(axis=0)
    assert np.all((low > -0.96) & (high < 0.96))
    assert np.abs(low + high).max() < 0.05
    assert (high - low).max() > 1.8


def test_vertices_lie_on_the_zero_of_the_distance(bust: Mesh) -> None:
    distance = np.abs(bust_distance(bust.vertices))
    assert np.quantile(distance, 0.99) < 1e-6
    assert distance.max() < 1e-3


def test_normals_are_unit_and_agree_with_the_facets(bust: Mesh) -> None:
    assert np.linalg.norm(bust.normals, axis=1) == pytest.approx(1.0, abs=1e-12)
    a, b, c = np.moveaxis(bust.vertices[bust.faces], 1, 0)
    facet = np.cross(b - a, c - a)
    area = np.linalg.norm(facet, axis=1)
    mean = bust.normals[bust.faces].mean(axis=1)
    cosine = (facet * mean).sum(axis=1) / np.maximum(area * np.linalg.norm(mean, axis=1), 1e-300)
    angle = np.rad2deg(np.arccos(np.clip(cosine, -1, 1)))
    large = area > 0.05 * np.median(area)  # slivers have no direction to speak of
    assert np.median(angle[large]) < 1.0
    assert np.mean(angle[large] < 10) > 0.97


def test_slopes_are_those_of_a_scanned_relief(visible_normals: np.ndarray) -> None:
    # The Mozart range scan of the shape-from-shading literature: 0.53, 0.89, 1.36, 1.68 at the same quantiles.
    slope = np.hypot(visible_normals[:, 0], visible_normals[:, 1]) / visible_normals[:, 2].clip(1e-6)
    half, three_quarters, nine_tenths, most = np.quantile(slope, [0.5, 0.75, 0.9, 0.95])
    assert 0.45 < half < 0.6
    assert 0.75 < three_quarters < 1.0
    assert 1.2 < nine_tenths < 1.6
    assert 1.6 < most < 2.3


def test_bust_covers_about_half_of_the_picture(visible_normals: np.ndarray) -> None:
    assert 0.4 < len(visible_normals) / SIDE**2 < 0.6


def test_parts_skipped_as_too_far_would_not_have_changed_the_distance() -> None:
    points = np.random.default_rng(0).uniform(-0.7, 0.7, (3, 8000))
    for parts in (HEAD, HAIR, TORSO):
        near = np.abs(joined_distance(parts, points, skip=False)) < 0.05
        every, skipping = (joined_distance(parts, points[:, near], skip=skip) for skip in (False, True))
        assert skipping == pytest.approx(every, abs=1e-9)


def test_grid_evaluated_in_blocks_has_the_zero_of_the_full_one() -> None:
    cell = 2 / 90
    distance, first = _distance_grid(cell)
    points = first + cell * np.moveaxis(np.indices(distance.shape), 0, -1)
    full = bust_distance(points.astype(np.float32))
    assert np.array_equal(distance < 0, full < 0)
    assert distance[np.abs(full) < cell] == pytest.approx(full[np.abs(full) < cell], abs=1e-5)


def test_distance_keeps_shape_and_precision() -> None:
    points = np.zeros((2, 3, 3), np.float32)
    assert bust_distance(points).shape == (2, 3)
    assert bust_distance(points).dtype == np.float32
    assert bust_distance(points.astype(float)).dtype == np.float64


def test_the_same_bust_every_time_and_finer_on_request() -> None:
    once, again, finer = bust_mesh(40), bust_mesh(40), bust_mesh(56)
    assert np.array_equal(once.vertices, again.vertices)
    assert np.array_equal(once.normals, again.normals)
    assert np.array_equal(once.faces, again.faces)
    assert len(finer.faces) > 1.5 * len(once.faces)
