"""How an object is rotated, from its silhouette: whichever lights its pixels miss; with an error that is stated."""

import numpy as np
import pytest
from synthesis import TWIN, dome, median_error

from huesphere.recover.cues.silhouette import silhouette_of
from huesphere.recover.geometry.rotations import rotation_by
from huesphere.recover.methods.table import METHODS
from huesphere.render.dataset import CameraInfo, Observation

pytestmark = pytest.mark.usefixtures("as_the_method_says")  # the verdict has tests of its own

START = rotation_by(np.array([0.4, -0.5, 0.8]))
SURE = 1e-10 * np.eye(3)


def ellipsoid(size: int, axes: tuple[float, float, float], turn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(normals (H, W, 3), mask (H, W)) of an ellipsoid of such half axes, turned; it turns away at its outline."""
    side = (np.arange(size) + 0.5) / size * 2.2 - 1.1
    x, y = np.meshgrid(side, -side)
    Q = turn @ np.diag(np.array(axes) ** -2.0) @ turn.T
    linear, constant = Q[0, 2] * x + Q[1, 2] * y, Q[0, 0] * x * x + 2 * Q[0, 1] * x * y + Q[1, 1] * y * y - 1
    root = linear**2 - Q[2, 2] * constant
    n = np.stack([x, y, (np.sqrt(np.maximum(root, 0)) - linear) / Q[2, 2]], axis=-1) @ Q
    return n / np.linalg.norm(n, axis=-1, keepdims=True), root > 0


def lit(n: np.ndarray, seed: int, count: int = 6, tilt: tuple[float, float] = (25.0, 75.0)) -> tuple[np.ndarray, float]:
    """(N (H, W, 3) of normals under so many lights so many degrees off axis, turned by START; share that sees all)."""
    rng = np.random.default_rng(seed)
    while True:
        polar, around = np.radians(rng.uniform(*tilt, count)), rng.uniform(0, 2 * np.pi, count)
        d = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=-1)
        colours = rng.uniform(0.05, 1.0, (count, 3))
        F = colours.T @ d
        if np.linalg.cond(F) < 15:
            break
    shading = n @ d.T
    rgb = np.maximum(shading, 0) @ colours
    return rgb @ np.linalg.inv(F).T @ START, float((shading > 0).all(axis=-1).mean())


def off_deg(found: np.ndarray, truth: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip((np.trace(found @ truth.T) - 1) / 2, -1, 1))))


def stated_deg(precision: np.ndarray) -> float:
    return float(np.degrees(np.sqrt(np.trace(np.linalg.inv(precision)))))


@pytest.mark.parametrize("axes", [(1.0, 1.0, 1.0), (1.0, 0.6, 0.8)])
def test_opposite_rims_tell_the_rotation_whichever_lights_they_miss(axes):
    n, mask = ellipsoid(128, axes, rotation_by(np.array([0.3, -0.4, 0.5])))
    off = []
    for seed in range(8):
        N, share = lit(n, seed)
        found = silhouette_of(mask, mask).rotation(N[mask], share, SURE)
        off.append(off_deg(found.rotation, START))
        assert stated_deg(found.precision) < 5
    assert np.median(off) < 1.5
    assert max(off) < 4.0


@pytest.mark.parametrize("chirality", [1.0, -1.0])
def test_it_tells_the_chirality_and_does_not_depend_on_the_frame(chirality):
    n, mask = ellipsoid(96, (1.0, 0.8, 0.7), np.eye(3))
    N, share = lit(n, 3)
    Q = chirality * rotation_by(np.array([-0.7, 0.2, 0.3]))
    once, again = (silhouette_of(mask, mask).rotation(image[mask], share, SURE).rotation for image in (N, N @ Q))
    np.testing.assert_allclose(again, once @ Q, atol=1e-9)


def test_a_silhouette_that_is_no_occluding_contour_has_less_precision():
    n, inside = dome(128, elongation=1.3, bumps=0.3, cap=0.6)
    n = np.where(inside[..., None], n, 0.0)
    N, share = lit(n, 1)
    found = silhouette_of(inside, inside).rotation(N[inside], share, SURE)
    assert stated_deg(found.precision) > 3
    assert off_deg(found.rotation, START) < 3 * stated_deg(found.precision)


def test_a_dent_is_taken_for_a_hill_and_pulls_as_one():
    """Convex or concave is the twin's business: what is near either is near."""
    n, mask = ellipsoid(96, (1.0, 0.9, 0.9), np.eye(3))
    N, share = lit(n @ TWIN, 2, tilt=(10.0, 40.0))
    found = silhouette_of(mask, mask).rotation(N[mask], share, SURE)
    assert off_deg(found.rotation, TWIN @ START) < 5
    assert np.linalg.norm(found.pull(START)[0]) < np.radians(5)
    assert found.loss(START) < found.loss(rotation_by(np.array([0.3, 0.0, 0.0])) @ START)


def test_across_a_reflection_there_is_no_pull_and_much_loss():
    n, mask = ellipsoid(96, (1.0, 0.9, 0.9), np.eye(3))
    N, share = lit(n, 2)
    found = silhouette_of(mask, mask).rotation(N[mask], share, SURE)
    away, counts = found.pull(-START)
    assert not away.any()
    assert not counts.any()
    assert found.loss(-START) > 10 * found.loss(START)


def test_the_edge_of_the_picture_is_no_silhouette():
    everywhere = np.ones((96, 96), bool)
    assert silhouette_of(everywhere, everywhere) is None
    corner = np.zeros((96, 96), bool)
    corner[:90, :90] = True
    assert silhouette_of(corner, corner) is None
    whole = np.pad(everywhere, 1)
    assert silhouette_of(whole, whole) is not None


def test_noise_makes_it_less_sure():
    n, mask = ellipsoid(96, (1.0, 0.9, 0.9), np.eye(3))
    N, share = lit(n, 2)
    noisy, grain = N + 0.1 * np.random.default_rng(0).standard_normal(N.shape), 0.01 * np.eye(3)
    clean = silhouette_of(mask, mask).rotation(N[mask], share, SURE)
    with_noise = silhouette_of(mask, mask).rotation(noisy[mask], share, grain)
    assert stated_deg(with_noise.precision) > 1.2 * stated_deg(clean.precision)
    assert off_deg(with_noise.rotation, START) < 3 * stated_deg(with_noise.precision)


def test_the_wrong_ellipsoid_misfits_the_rim():
    n, mask = ellipsoid(96, (1.0, 0.9, 0.9), np.eye(3))
    N, _ = lit(n, 2)
    silhouette = silhouette_of(mask, mask)
    wrong = N @ (np.eye(3) + 0.3 * np.outer([1, 0, 0], [1, 0, 0]))
    assert silhouette.rim(N[mask], SURE).misfit < 0.1 < silhouette.rim(wrong[mask], SURE).misfit


def test_where_the_chirality_is_undetermined_there_is_no_rotation():
    """All light from one side of a cylinder: N lean in one direction only."""
    n, mask = ellipsoid(96, (1.0, 0.9, 0.9), np.eye(3))
    flat = n * [1.0, 0.0, 1.0]
    N = flat / np.linalg.norm(flat, axis=-1, keepdims=True)
    assert silhouette_of(mask, mask).rotation(N[mask], 0.5, SURE) is None


def test_an_object_off_the_optical_axis_faces_its_own_ray():
    n, mask = ellipsoid(128, (1.0, 0.9, 0.8), np.eye(3))
    toward = np.array([-0.25, 0.1, 1.0]) / np.linalg.norm([-0.25, 0.1, 1.0])
    off_axis = rotation_by(np.cross([0.0, 0.0, 1.0], toward))
    N, share = lit(n @ off_axis.T, 4, tilt=(40.0, 70.0))
    ray = np.broadcast_to([0.25, -0.1], (*mask.shape, 2))
    by_ray, straight = (silhouette_of(mask, mask, r).rotation(N[mask], share, SURE).rotation for r in (ray, None))
    assert off_deg(by_ray, START) < 5
    assert off_deg(straight, START) > 10


@pytest.mark.parametrize("seed", [0, 3, 5, 6])
def test_a_round_body_of_which_a_fifth_sees_every_light_is_known_to_a_few_degrees(seed):
    """All-lit pixels alone leave the second to fourth 39 to 56° off, or without an ellipsoid."""
    rng = np.random.default_rng(seed)
    n, mask = ellipsoid(128, (1.0, 0.8, 0.7), rotation_by(rng.normal(size=3)))
    while True:
        count = int(rng.integers(4, 8))
        polar, around = np.radians(rng.uniform(30, 75, count)), rng.uniform(0, 2 * np.pi, count)
        d = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=-1)
        colours = rng.uniform(0.05, 1.0, (count, 3))
        share = ((n @ d.T > 0).all(axis=-1) & mask).sum() / mask.sum()
        if np.linalg.cond(colours.T @ d) < 15 and 0.12 < share < 0.25:
            break
    rgb = np.maximum(n @ d.T, 0) @ colours
    rgb = rgb / rgb[mask].max() + 3e-3 * rng.standard_normal(n.shape)
    picture = Observation(np.where(mask[..., None], rgb, 0).astype(np.float32), mask, CameraInfo(known=False))
    found = METHODS["robust"](picture)
    assert found.status == "ok"
    assert median_error(found, n) < 4
