"""Near lights of known position: an ellipsoid under five point lights, shaded by NumPy."""

from dataclasses import replace

import numpy as np
import pytest

from huesphere.configs.errors import InputError
from huesphere.configs.load import validate
from huesphere.recover.io.picture import read_picture
from huesphere.recover.methods.near_lights import recover_near
from huesphere.recover.methods.table import METHODS
from huesphere.render.dataset import CameraInfo, KnownLights, Observation, read_observation, write_observation

SIDE, RADIUS, NOISE = 64, 28.0, 1e-3
TOWARD = np.array([(0.5, 0.2, 1), (-0.5, 0.2, 1), (0, -0.5, 1), (0.3, 0.5, 1), (-0.2, 0.4, 1)])
TOWARD /= np.linalg.norm(TOWARD, axis=1, keepdims=True)
COLOURS = np.array([(0.8, 0.15, 0.05), (0.1, 0.8, 0.2), (0.05, 0.2, 0.8), (0.55, 0.5, 0.08), (0.12, 0.45, 0.5)])


def ellipsoid(distance, *, hollow=False, distant=0):
    """(picture, true normals) of an ellipsoid of semi-axes 1, 0.75, 0.9 radii, lights ``distance`` radii away.

    ``hollow``: its inside. ``distant``: so many of the lights are parallel light.
    """
    row, column = np.indices((SIDE, SIDE)) + 0.5
    x, y, sign = column - SIDE / 2, SIDE / 2 - row, -1.0 if hollow else 1.0
    axes = RADIUS * np.array([1.0, 0.75, 0.9])
    inside = 1 - (x / axes[0]) ** 2 - (y / axes[1]) ** 2
    mask = inside > 0.03
    z = sign * axes[2] * np.sqrt(np.maximum(inside, 0.01))
    X = np.stack([x, y, z], axis=-1)
    n = sign * X / axes**2
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    positions = distance * RADIUS * TOWARD
    away = positions - X[..., None, :]
    a = (distance * RADIUS) ** 2 * away / np.linalg.norm(away, axis=-1, keepdims=True) ** 3
    a[..., :distant, :] = TOWARD[:distant]
    rgb = np.maximum(np.einsum("hwlk,hwk->hwl", a, n), 0) @ COLOURS * mask[..., None]
    rgb = 0.9 * rgb / rgb.max() + NOISE * np.random.default_rng(0).standard_normal(rgb.shape)
    lights = KnownLights(positions[distant:], TOWARD[:distant])
    return Observation(rgb.astype(np.float32), mask, CameraInfo(read_noise=NOISE), lights), n


def errors_deg(estimate, n):
    cosine = (estimate.normals * n).sum(axis=-1)[estimate.valid]
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


@pytest.mark.parametrize(("distance", "distant"), [(1.5, 0), (6.0, 0), (3.0, 2)])
def test_known_positions_of_near_lights_give_every_normal(distance, distant):
    picture, n = ellipsoid(distance, distant=distant)
    estimate = METHODS["auto"](picture)
    assert estimate.status == "ok"
    assert np.array_equal(estimate.valid, picture.mask)
    assert np.median(errors_deg(estimate, n)) < 0.4
    assert errors_deg(estimate, n).mean() < 0.8
    blind = METHODS["weak-integrability"](picture)
    assert blind.status != "ok" or np.median(errors_deg(blind, n)) > 5


def test_the_distance_to_the_lights_and_the_stated_error_are_those_of_the_picture():
    picture, n = ellipsoid(3.0)
    moved = picture.lights._replace(positions=picture.lights.positions + np.array([0, 0, 0.7 * RADIUS]))
    here, there = (recover_near(replace(picture, lights=lights))[0] for lights in (picture.lights, moved))
    depth = [estimate.diagnostics["near"]["depth"] for estimate in (here, there)]
    assert depth[1] - depth[0] == pytest.approx(0.7 * RADIUS, abs=0.05)
    stated = np.median(here.uncertainty_deg[here.valid])
    assert 0.5 * stated < np.median(errors_deg(here, n)) < 2 * stated


def test_a_hollow_is_distinguished_from_a_hill():
    picture, n = ellipsoid(3.0, hollow=True)
    estimate, _ = recover_near(picture)
    assert estimate.status == "ok"
    assert np.median(errors_deg(estimate, n)) < 0.4
    assert estimate.diagnostics["near"]["left_other_way"] > 5


def test_lights_that_are_not_at_the_reported_positions_are_found_out():
    picture, _ = ellipsoid(1.5)
    swapped = picture.lights._replace(positions=picture.lights.positions[::-1] * [1.0, -1.0, 0.6])
    assert METHODS["auto"](replace(picture, lights=swapped)).status == "lights-unexplained"
    assert recover_near(replace(picture, lights=None))[0].status == "lights-not-told"


def test_positions_are_kept_in_the_header_and_move_with_a_region(tmp_path):
    picture, _ = ellipsoid(3.0, distant=1)
    path = tmp_path / "picture.exr"
    write_observation(path, picture)
    assert all(np.array_equal(a, b) for a, b in zip(read_observation(path).lights, picture.lights, strict=True))
    cut, _ = read_picture(path, region=(10, 8, 64, 60))
    assert np.allclose(picture.lights.positions - cut.lights.positions, [5.0, -2.0, 0.0])
    write_observation(path, replace(picture, lights=None))
    assert read_observation(path).lights is None


def test_only_lights_with_a_position_are_reported():
    config = {"name": "a", "shape": {"kind": "sphere"}, "recover": {"lights": "told"}}
    point = {"kind": "point", "position": [0, 0, 3]}
    assert validate(config | {"lights": [point]}, where="").recover.lights == "told"
    with pytest.raises(InputError, match="cannot be told"):
        validate(config | {"lights": [point, {"kind": "sky"}]}, where="")
    with pytest.raises(InputError, match="orthographic"):
        validate(config | {"lights": [point], "camera": {"projection": "perspective"}}, where="")
