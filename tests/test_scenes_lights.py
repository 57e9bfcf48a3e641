"""Sources: closed forms of what a surface gets from them when nothing stands in the way."""

import re
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from huesphere.configs import lights as configs
from huesphere.configs.errors import InputError
from huesphere.configs.load import load_config
from huesphere.scenes.build import build_scene
from huesphere.scenes.lights.ambient import AmbientLight
from huesphere.scenes.lights.distant import DistantLight
from huesphere.scenes.lights.point import PointLight
from huesphere.scenes.lights.rectangle import RectangleLight
from huesphere.scenes.lights.sky import DomeLight
from huesphere.scenes.lights.source import EnvironmentLight, RayLight, UniformLight
from huesphere.scenes.lights.sphere import SphereLight
from huesphere.scenes.lights.table import BUILDERS, build_lights
from huesphere.scenes.quadrature import fibonacci_lattice
from huesphere.scenes.spectra import WAVELENGTHS

ROOT = Path(__file__).parent.parent
ONE = np.ones(len(WAVELENGTHS))
UP = np.array([[0.0, 0.0, 1.0]])
ORIGIN = np.zeros((1, 3))


def on_axis(z):
    return np.array([0.0, 0.0, z])


def test_a_point_source_falls_with_the_square_of_its_distance():
    values = [PointLight("x", ONE, on_axis(z)).unoccluded(ORIGIN, UP)[0] for z in (1.0, 2.0)]
    assert values == pytest.approx([1.0, 0.25])


def test_a_ball_of_light_on_the_axis_is_its_closed_form():
    # Irradiance of a uniform sphere of radius R at distance d is π L (R/d)²: 1/d² here, however near.
    for distance in (1.0, 3.0):
        light = SphereLight("x", ONE, on_axis(distance), 0.5)
        assert light.unoccluded(ORIGIN, UP)[0] == pytest.approx(distance**-2)


def test_a_rectangle_has_its_form_factor():
    # Howell's catalogue, B-3/B-4 times four: differential element under the centre of a parallel rectangle a × b at c.
    a = b = 1.0
    c = 1.0
    x, y = a / 2 / c, b / 2 / c
    quarter = (
        x / np.hypot(1, x) * np.arctan(y / np.hypot(1, x)) + y / np.hypot(1, y) * np.arctan(x / np.hypot(1, y))
    ) / (2 * np.pi)
    light = RectangleLight("x", ONE, on_axis(c), np.array([0.0, b, 0]), np.array([a, 0, 0.0]))
    # Our unit: π times the form factor over the area.
    assert light.unoccluded(ORIGIN, UP)[0] == pytest.approx(4 * quarter * np.pi / (a * b), rel=2e-4)


def test_a_ball_cut_by_the_horizon_agrees_with_numerical_integration():
    light = SphereLight("x", ONE, np.array([0.8, 0.0, 0.1]), 0.5)
    normals = np.random.default_rng(0).normal(size=(400_000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    targets = light.centre + light.radius * normals
    reach = np.linalg.norm(targets, axis=1)
    toward = targets / reach[:, None]
    # A ball of area 4πR² shows a disc of area πR²: the mean over its surface counts four times.
    numeric = 4 * np.mean(np.maximum(toward[:, 2], 0) * np.maximum(-np.sum(normals * toward, axis=1), 0) / reach**2)
    assert light.unoccluded(ORIGIN, UP)[0] == pytest.approx(numeric, rel=1e-2)


def test_a_rectangle_shines_to_one_side_only():
    light = RectangleLight("x", ONE, on_axis(1.0), np.array([1.0, 0, 0]), np.array([0, 1.0, 0]))
    assert light.unoccluded(ORIGIN, UP)[0] == 0


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
    assert light.unoccluded(ORIGIN, normal[None])[0] == pytest.approx(numeric, abs=6e-3)


def test_ambient_light_knows_no_normal():
    assert (AmbientLight("x", ONE).unoccluded(np.zeros((5, 3)), np.eye(3)[[0, 1, 2, 0, 1]]) == 1).all()


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


# ---- what every kind must answer -----------------------------------------------------------------------------------

RAYS = {
    "distant": DistantLight("x", ONE, np.array([0.6, 0.0, 0.8])),
    "point": PointLight("x", ONE, np.array([0.4, 0.2, 1.5])),
    "sphere": SphereLight("x", ONE, np.array([0.4, 0.2, 1.5]), 0.5),
    "rectangle": RectangleLight(
        "x", ONE, np.array([0.4, 0.2, 1.5]), np.array([0.0, 0.7, 0.1]), np.array([0.9, 0.0, 0.0])
    ),
}


def test_every_kind_of_the_config_has_a_builder_and_every_builder_a_kind():
    union = get_args(get_args(configs.LightSpec)[0])
    assert set(BUILDERS) == set(union)


@pytest.mark.parametrize("kind", RAYS)
def test_rays_toward_a_source_add_up_to_its_closed_form(kind, mi):
    """`toward` averaged over the source and `unoccluded` are two ways to one number."""
    import drjit as dr

    light, count = RAYS[kind], 1 << 14
    position, normal = np.array([[0.1, -0.2, 0.0]]), np.array([[0.0, 0.0, 1.0]])
    square = tuple(mi.Float(np.ascontiguousarray(v, np.float32)) for v in fibonacci_lattice(count).T)
    toward, distance, strength = light.toward(mi, dr, mi.Point3f(*position[0].tolist()), square)
    mean = np.mean(np.maximum(np.array(toward)[2], 0) * np.array(strength))
    assert np.linalg.norm(np.array(toward), axis=0) == pytest.approx(1, abs=1e-5)
    assert (distance is None) == (kind == "distant")
    assert mean == pytest.approx(light.unoccluded(position, normal)[0], rel=2e-3)


@pytest.mark.parametrize("profile", ["uniform", "zenith", "horizon", "ground"])
def test_the_radiance_of_a_dome_is_what_the_reference_engine_is_given(profile, mi):
    import drjit as dr

    light = DomeLight("sky", ONE, np.array([0.0, 0.6, 0.8]), profile)
    directions = np.random.default_rng(1).normal(size=(3, 1000))
    directions = mi.Vector3f(np.float32(directions / np.linalg.norm(directions, axis=0)))
    ours, reference = (np.array(f(mi, dr, directions)) for f in (light.radiance, light.reference_radiance))
    assert np.broadcast_to(ours, 1000) == pytest.approx(np.broadcast_to(reference, 1000), abs=1e-6)


def test_the_renderer_knows_families_of_lights_and_no_kind():
    families = {"source", "table"}
    for path in (ROOT / "render").glob("*.py"):
        for module in re.findall(r"scenes\.lights(?:\.(\w+))?", path.read_text(encoding="utf-8")):
            assert module in families, path.name


def test_every_source_is_of_one_family_with_facts_and_a_place_where_its_config_says_so():
    lights = (
        "{direction: [0,0,1]}, {kind: point, position: [0,0,2]}, {kind: ambient}, {kind: sky},"
        " {kind: sphere, position: [0,0,4], radius: 1},"
        " {kind: rectangle, position: [0,0,2], edge_u: [1,0,0], edge_v: [0,1,0]}"
    )
    config = load_config("sphere_quick", overrides=[f"lights=[{lights}]"])
    kinds = []
    for spec in config.lights:
        places = [
            light.known_position is not None or light.known_direction is not None for light in build_lights((spec,))
        ]
        assert spec.has_place == all(places), spec.kind
    for light in build_lights(config.lights):
        assert sum(isinstance(light, family) for family in (RayLight, EnvironmentLight, UniformLight)) == 1
        kinds.append(light.facts()["kind"])
    assert kinds == ["distant", "point", "ambient", "dome", "dome", "sphere", "rectangle"]


def test_an_object_that_reaches_into_a_ball_of_light_is_refused():
    config = load_config("sphere_quick", overrides=["lights=[{kind: sphere, position: [0,0,1.2], radius: 0.5}]"])
    with pytest.raises(InputError, match="reaches into the ball light"):
        build_scene(config)
