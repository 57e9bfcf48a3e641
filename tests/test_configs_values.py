"""What plain values of a config mean: YAML 1.2, numbers that are numbers, booleans that are none, temperatures."""

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from huesphere.configs.errors import InputError
from huesphere.configs.load import apply_override, load_configs, validate
from huesphere.configs.yaml_text import parse
from huesphere.configs.yaml_values import CoreSchemaDumper

BASE = "name: a\nshape: {kind: sphere}\nlights: [{direction: [0, 0, 1]}]\n"


def config(text):
    return validate(parse(BASE + text)[0], where="a.yaml")


@pytest.mark.parametrize(
    ("written", "value"),
    [
        ("yes", "yes"),
        ("No", "No"),
        ("on", "on"),
        ("true", True),
        ("FALSE", False),
        ("017", 17),
        ("-08", -8),
        ("0o17", 15),
        ("0x1F", 31),
        ("12:30", "12:30"),
        ("1_000", "1_000"),
        ("0b11", "0b11"),
        ("2026-11-30", "2026-11-30"),
        ("1e3", 1000.0),
        ("2E-4", 2e-4),
        (".5", 0.5),
        ("3.", 3.0),
        (".inf", float("inf")),
        ("~", None),
        ("", None),
        ("~/scan.obj", "~/scan.obj"),
        ("'012'", "012"),
    ],
)
def test_plain_scalars_are_those_of_yaml_1_2_by_either_parser(written, value):
    for text in (f"a: {written}", f"a: {written} #\tPyYAML's own parser reads what has a tab\n"):
        found = parse(text)[0]["a"]
        assert found == value
        assert type(found) is type(value)


def test_merge_keys_still_merge():
    assert parse("x: &x {a: 1}\ny: {<<: *x, b: 2}")[0]["y"] == {"a": 1, "b": 2}


@given(st.text(alphabet="0123456789+-._:exobyntrufals", max_size=6))
def test_what_is_written_is_read_back_by_yaml_1_1_and_1_2(text):
    written = yaml.dump({"a": text, "b": [text]}, Dumper=CoreSchemaDumper)
    assert parse(written)[0] == yaml.safe_load(written) == {"a": text, "b": [text]}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("surface: {reflectance: true}", r"surface\.reflectance, got True, expected a number or a name"),
        ("surface: {reflectance: off}", r"surface\.reflectance: expected a number or a name, got 'off'"),
        ("camera: {exposure: on}", r"camera\.exposure, got 'on', expected 'auto' or a valid number"),
        ("camera: {exposure: false}", r"camera\.exposure, got False, expected a number"),
        ("camera: {bits: true}", r"camera\.bits, got True, expected a whole number"),
        ("camera: {resolution: [2:08, 64]}", r"camera\.resolution\[0\], got '2:08'"),
        ("camera: {resolution: [64, true]}", r"camera\.resolution, got \[64, True\], expected a whole number"),
        ("camera: {read_noise: 1%}", r"camera\.read_noise, got '1%'"),
        ("camera: {read_noise: '0,01'}", r"camera\.read_noise, got '0,01'"),
        ("surface: {reflectance: {gaussian: {centre: true, sigma: 9}}}", r"gaussian\.centre, got True"),
        ("surface: {reflectance: {csv: false}}", r"reflectance\.csv, got False, expected a name"),
        ("recover: {methods: [true]}", r"recover\.methods, got \[True\], expected a name"),
    ],
)
def test_a_truth_or_what_only_looks_like_a_number_is_refused(text, message):
    with pytest.raises(InputError, match=message):
        config(text)


def test_numbers_with_a_leading_zero_are_decimal():
    assert config("camera: {bits: 010, resolution: [064, 032]}").camera.bits == 10
    data = {"camera": {}}
    apply_override(data, "camera.bits=014")
    assert data["camera"]["bits"] == 14


@pytest.mark.parametrize(("written", "value"), [("true", True), ("yes", True), ("off", False), ("false", False)])
def test_where_a_truth_is_meant_words_for_it_are_understood(written, value):
    data = parse(f"name: a\nshape: {{kind: sphere, background: {written}}}\nlights: [{{direction: [0, 0, 1]}}]")[0]
    assert validate(data, where="a").shape.background is value


@pytest.mark.parametrize("written", ["6500", "2856.0", "'5000'", "3200K", "'4000 K'"])
@pytest.mark.parametrize("light", ["direction: [0, 0, 1], spectrum", "kind: sky, zenith"])
def test_a_bare_colour_temperature_is_refused_and_both_ways_to_write_it_are_named(light, written):
    data = parse(f"name: a\nshape: {{kind: sphere}}\nlights: [{{{light}: {written}}}]")[0]
    number = written.strip("'K ").removesuffix(".0")
    with pytest.raises(InputError, match=rf"\{{daylight: {number}\}} or \{{blackbody: {number}\}}"):
        validate(data, where="a")


def test_a_constant_spectrum_is_no_temperature():
    data = parse("name: a\nshape: {kind: sphere}\nlights: [{direction: [0, 0, 1], spectrum: 1}]")[0]
    assert validate(data, where="a").lights[0].spectrum == 1.0


def test_a_sweep_and_a_file_say_the_same(tmp_path):
    (tmp_path / "c.yaml").write_text(BASE + "sweep: {camera.bits: [08, 012], camera.read_noise: [1e-3]}\n")
    configs = load_configs(str(tmp_path / "c.yaml"))
    assert [(c.camera.bits, c.camera.read_noise) for c in configs] == [(8, 1e-3), (12, 1e-3)]
