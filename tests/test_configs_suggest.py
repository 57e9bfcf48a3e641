"""Suggestions for misspelt names, lists of names, short representations, and lines that fit a terminal."""

import numpy as np
import pytest

from huesphere.configs.commandline import Parser
from huesphere.configs.errors import InputError
from huesphere.configs.load import find_config, load_config, packaged_names
from huesphere.configs.suggest import closest, suggested
from huesphere.eval.datasets.sample import require_contents
from huesphere.eval.frames import parse_frame
from huesphere.eval.scores import score
from huesphere.recover.cli import _listed
from huesphere.recover.io.picture_folder import folder_name
from huesphere.recover.methods.table import METHODS, check_methods
from huesphere.render.cli import _said_once
from huesphere.render.listing import KINDS, WIDTH, listed
from huesphere.scenes.spectra import known_name, patch_names


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("weak", "weak-integrability"),
        ("Drew Kontsevich", "drew-kontsevich"),
        ("drew_kontsevic", "drew-kontsevich"),
        ("integrability", "weak-integrability"),
        ("unbonce", "unbounce"),
        ("zzz", None),
        ("k", None),
    ],
)
def test_a_misspelt_method_is_recognised(typed: str, meant: str | None):
    assert closest(typed, METHODS) == meant
    with pytest.raises(InputError, match="did you mean it" if meant else "one of"):
        check_methods([typed])


def test_an_error_names_what_was_meant_or_else_what_there_is():
    assert suggested("normal", ["depth", "normals"], "one of two") == "'normals' (did you mean it?)"
    assert suggested("zzz", ["depth", "normals"], "one of two") == "one of two"


@pytest.mark.parametrize(
    ("ask", "meant"),
    [
        (lambda: known_name("light_skin", patch_names(), "reflectance", "shape"), "'light skin'"),
        (lambda: parse_frame("open gl"), "'opengl'"),
        (lambda: require_contents(["Normal"]), "'normals'"),
        (lambda: load_config("sphere_quick.yaml", overrides=["camera.noise=1"]), "'read_noise'"),
        (lambda: load_config("sphere_quick.yaml", overrides=["shape.kind=depth"]), "'depth_map'"),
        (lambda: Parser(prog="p").error("unrecognized arguments: --versoin"), "--version"),
    ],
)
def test_part_of_a_name_is_enough_wherever_a_name_is_suggested(ask, meant: str):
    with pytest.raises(InputError) as refused:
        ask()
    assert meant in str(refused.value)
    assert "did you mean" in str(refused.value)


@pytest.mark.parametrize("name", ["nosuch.yaml", "x.yaml", "missing"])
def test_a_config_of_no_likeness_is_not_guessed(name: str):
    with pytest.raises(InputError) as refused:
        find_config(name)
    assert "did you mean" not in str(refused.value)


def test_a_misspelt_config_is_recognised():
    with pytest.raises(InputError, match=r"did you mean sphere_quick\.yaml"):
        find_config("sphere_quik.yaml")


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "methods"])
def test_lists_fit_the_terminal_and_name_what_a_config_takes(kind: str):
    lines = listed(kind)
    known = {"configs": packaged_names()[0], "spectra": "D65", "cameras": "Nikon 5100 (NPL)"}
    assert known.get(kind, "light skin") in " ".join(lines)
    assert max(map(len, lines)) <= WIDTH


def test_the_list_of_methods_is_recoverys_and_fits_too():
    with pytest.raises(InputError, match="recover --list"):
        listed("methods")
    assert max(map(len, _listed(WIDTH))) <= WIDTH
    assert all(name in "\n".join(_listed(WIDTH)) for name in METHODS)


def test_a_sweep_says_each_line_once_and_leaves_out_its_steps(capsys: pytest.CaptureFixture[str]):
    log = _said_once()
    for line in ("shape: a sphere", "a light reaches nothing", "a light reaches nothing", "engine: transport"):
        log(line)
    assert capsys.readouterr().out.splitlines() == ["a light reaches nothing"]


def test_two_regions_of_a_photograph_have_two_folders():
    from pathlib import Path

    names = {folder_name(Path("vase.png"), region) for region in (None, (0, 0, 10, 10), (0, 0, 10, 12))}
    assert len(names) == 3


def test_scores_have_a_short_representation():
    up = np.broadcast_to([0.0, 0.0, 1.0], (4, 4, 3))
    assert repr(score(up, up)) == "Scores(median 0°, mean 0°, p90 0°, 100% covered)"
