"""Sources: closed forms of what a surface gets from them when nothing stands in the way."""

import numpy as np
import pytest

from huesphere.configs.errors import InputError
from huesphere.configs.load import load_config
from huesphere.scenes.build import build_scene
from huesphere.scenes.lights import AmbientLight, DomeLight, NearLight, build_lights, unoccluded
from huesphere.scenes.spectra import WAVELENGTHS

ONE = np.ones(len(WAVELENGTHS))
UP = np.array([[0.0, 0.0, 1.0]])
ORIGIN = np.zeros((1, 3))


def near(kind, z, **more):
    return NearLight("x", ONE, kind, np.array([0.0, 0.0, z]), **more)


def test_a_point_source_falls_with_the_square_of_its_distance():
    values = [unoccluded(near("point", z), ORIGIN, UP)[0] for z in (1.0, 2.0)]
    assert values == pytest.approx([1.0, 0.25])


def test_a_ball_of_light_on_the_axis_is_its_closed_form():
    # Irradiance of a uniform sphere of radius R at distance d is π L (R/d)²: 1/d² here, however near.
    for distance in (1.0, 3.0):
        assert unoccluded(near("sphere", distance, radius=0.5), ORIGIN, UP)[0] == pytest.approx(distance**-2)


def test_a_rectangle_has_its_form_factor():
    # Howell's catalogue, B-3/B-4 times four: differential element under the centre of a parallel rectangle a × b at c.
    a = b = 1.0
    c = 1.0
    x, y = a / 2 / c, b / 2 / c
    quarter = (
        x / np.hypot(1, x) * np.arctan(y / np.hypot(1, x)) + y / np.hypot(1, y) * np.arctan(x / np.hypot(1, y))
    ) / (2 * np.pi)
    light = near("rectangle", c, edge_u=np.array([0.0, b, 0]), edge_v=np.array([a, 0, 0.0]))
    # Our unit: π times the form factor over the area.
    assert unoccluded(light, ORIGIN, UP)[0] == pytest.approx(4 * quarter * np.pi / (a * b), rel=2e-4)


def test_a_ball_cut_by_the_horizon_agrees_with_numerical_integration():
    light = NearLight("x", ONE, "sphere", np.array([0.8, 0.0, 0.1]), radius=0.5)
    targets, normals = light.sample(np.random.default_rng(0).random((400_000, 2)))
    reach = np.linalg.norm(targets, axis=1)
    toward = targets / reach[:, None]
    numeric = 4 * np.mean(np.maximum(toward[:, 2], 0) * np.maximum(-np.sum(normals * toward, axis=1), 0) / reach**2)
    assert unoccluded(light, ORIGIN, UP)[0] == pytest.approx(numeric, rel=1e-2)


def test_a_rectangle_shines_to_one_side_only():
    light = near("rectangle", 1.0, edge_u=np.array([1.0, 0, 0]), edge_v=np.array([0, 1.0, 0]))
    assert unoccluded(light, ORIGIN, UP)[0] == 0


@pytest.mark.parametrize("profile", ["uniform", "zenith", "horizon", "ground"])
@pytest.mark.parametrize("tilt", [0.0, 0.7, 2.0, np.pi])
def test_domes_agree_with_numerical_integration(profile, tilt):
    normal = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    light = DomeLight("sky", ONE, np.array([0.0, 0.0, 1.0]), profile)
    rng = np.random.default_rng(0)
    d = rng.normal(size=(400_000, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    c = d[:, 2]
    weight = {
        "uniform": np.ones_like(c),
        "zenith": np.maximum(c, 0),
        "horizon": (c > 0) * (1 - c),
        "ground": (c < 0) * 1.0,
    }[profile]
    numeric = 4 * np.mean(weight * np.maximum(d @ normal, 0))
    assert light.unoccluded(normal) == pytest.approx(numeric, abs=6e-3)


def test_ambient_light_knows_no_normal():
    assert (unoccluded(AmbientLight("x", ONE), np.zeros((5, 3)), np.eye(3)[[0, 1, 2, 0, 1]]) == 1).all()


def test_sun_and_sky_are_several_sources():
    config = load_config("sphere_quick", overrides=["lights=[{kind: sky, ground: 0.5, sun: {direction: [1,1,1]}}]"])
    assert [type(light).__name__ for light in build_lights(config.lights)] == ["DomeLight"] * 3 + ["DistantLight"]


def test_a_flat_rectangle_is_refused():
    with pytest.raises(InputError, match="span a rectangle"):
        load_config(
            "sphere_quick",
            overrides=["lights=[{kind: rectangle, position: [0,0,1], edge_u: [1,0,0], edge_v: [2,0,0]}]"],
        )


def test_the_walls_of_a_room_look_inward():
    config = load_config("room_coloured_walls", overrides=["shape={kind: sphere, detail: 8}"])
    room = build_scene(config).enclosure
    mesh = room.mesh()
    toward_middle = (room.low + room.high) / 2 - mesh.vertices
    assert (np.einsum("vc,vc->v", toward_middle, mesh.normals) > 0).all()
