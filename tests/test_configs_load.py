"""Configs: what is right loads and round-trips; what is wrong is one line with its place."""

import re

import pytest
import yaml

from huesphere.configs.errors import InputError
from huesphere.configs.load import (
    PACKAGED,
    apply_override,
    dump_config,
    export_schema,
    find_config,
    load_config,
    load_configs,
    packaged_names,
    validate,
)
from huesphere.configs.schema import RunConfig


@pytest.mark.parametrize("name", packaged_names())
def test_packaged_config_loads_and_survives_a_round_trip(name):
    for config in load_configs(name):
        assert validate(yaml.safe_load(dump_config(config)), where="again") == config


@pytest.mark.parametrize("name", packaged_names())
def test_packaged_config_begins_with_its_purpose(name):
    assert (PACKAGED / name).read_text().startswith("# ")


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("camera.read_nose=1", r"unknown key camera.read_nose; did you mean 'read_noise'\?"),
        ("camera.read_noise=-1", "camera.read_noise, got -1, expected greater than or equal to 0"),
        ("camera.read_noise=nan", "finite"),
        ("shape.kind=bst", "shape.kind, got bst, expected one of .*did you mean 'bust'"),
        ("lights=[]", "lights, got .*at least 1"),
        ("lights.0.direction=[0,0,0]", r"lights\[0\].direction: a direction may not be \(0, 0, 0\)"),
        ("lights.0.spectrum={gausian: 3}", "did you mean 'gaussian'"),
        ("lights.0.spectrum={gaussian: {centre: 3, sigma: 2}}", "spectrum.gaussian.centre, got 3, expected greater"),
        ("camera.resolution=[3,3]", r"camera.resolution\[0\], got 3"),
        ("render.transport=[ful]", "did you mean 'full'"),
        ("name=../x", "name, got '../x'"),
        ("lights.9.intensity=1", "lights.9, got 9, expected an index below 5"),
        ("camera.exposure=-3", "camera.exposure, got -3"),
        ("nonsense", "--set, got nonsense, expected key.sub=value"),
        (
            "surface.colour=3",
            "unknown key surface.colour; known are checker, kind, mixture, reflectance, srgb, texture",
        ),
    ],
)
def test_a_wrong_key_or_value_is_named_in_one_line(override, message):
    with pytest.raises(InputError, match=message) as caught:
        load_config("mozart_5lights", overrides=[override])
    assert "\n" not in str(caught.value)


def test_an_error_in_a_file_names_file_and_line(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("shape: {kind: sphere}\nlights:\n  - {direction: [0, 0, 1]}\ncamera:\n  bitz: 3\n")
    with pytest.raises(InputError, match=re.escape(f"{path}:5: unknown key camera.bitz")):
        load_config(str(path))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("- 1\n", "a config is a mapping"),
        ("a: [1\n", "not valid YAML"),
        ("name: x\nname: y\n", "key 'name' twice"),
        ("name: !!python/object/apply:os.system ['true']\n", "not valid YAML"),
        ("", "a config is a mapping"),
        ("a: &a [*a]\n", "nested too deeply"),
        ("? [a]\n: b\n", "a key that is not a word"),
        ("[" * 5000, "nested too deeply"),
        (
            "a: &a [x,x,x,x,x,x,x,x]\n"
            + "".join(f"{k}: &{k} [{','.join(['*' + p] * 8)}]\n" for p, k in zip("abcdefg", "bcdefgh")),
            "more than 1000000",
        ),
    ],
)
def test_a_file_that_is_no_config_is_one_line(tmp_path, text, message):
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        load_config(str(path))


def test_binary_file_is_one_line(tmp_path):
    path = tmp_path / "bad.yaml"
    path.write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(InputError, match="UTF-8"):
        load_config(str(path))


def test_an_unknown_config_suggests_the_nearest():
    with pytest.raises(InputError, match="did you mean mozart_5gels"):
        find_config("mozart_5gel.yaml")


@pytest.mark.parametrize(
    ("overrides", "where"),
    [
        (["lights=[{kind: sphere, position: [0, 0, 3]}]"], "--set: lights[0].radius is missing"),
        (["lights.0={kind: sphere, position: [0, 0, 3]}"], "--set: lights[0].radius is missing"),
        (["camera.bits=12", "lights.0.intensity=-1"], "--set: lights[0].intensity"),
    ],
)
def test_what_is_wrong_in_a_value_that_was_set_is_not_blamed_on_the_file(overrides, where):
    with pytest.raises(InputError, match=re.escape(where)):
        load_config("sphere_quick", overrides=overrides)


def test_override_reaches_lists_and_makes_missing_mappings():
    data = {"lights": [{"direction": [0, 0, 1]}]}
    apply_override(data, "lights.0.intensity=2")
    apply_override(data, "camera.bits=12")
    assert data == {"lights": [{"direction": [0, 0, 1], "intensity": 2}], "camera": {"bits": 12}}


def test_numbers_in_scientific_notation_are_numbers():
    config = load_config("mozart_5lights", overrides=["surface.reflectance=8e-1", "camera.read_noise=1e-3"])
    assert config.surface.reflectance == 0.8
    assert config.camera.read_noise == 1e-3


def test_paths_in_a_config_are_relative_to_it(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("shape: {kind: depth_map, path: z.npy}\nlights: [{direction: [0, 0, 1]}]\n")
    assert load_config(str(path)).shape.path == str(tmp_path / "z.npy")


def test_shape_option_takes_depth_maps_and_meshes(tmp_path):
    assert load_config("sphere_quick", shape=str(tmp_path / "a.npz")).shape.kind == "depth_map"
    assert load_config("sphere_quick", shape=str(tmp_path / "a.ply")).shape.kind == "mesh"
    with pytest.raises(InputError, match="suffix"):
        load_config("sphere_quick", shape="a.docx")


def test_json_schema_names_every_top_level_key():
    assert set(RunConfig.model_fields) <= set(yaml.safe_load(export_schema())["properties"])
