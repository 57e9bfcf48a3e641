"""The documentation does what it says: its gallery renders, its notebook runs, its site builds without a warning."""

import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from huesphere.configs.load import load_config
from huesphere.recover.methods.table import METHODS

DOCS = Path(__file__).parent.parent / "docs"


def script(name: str):
    spec = importlib.util.spec_from_file_location(f"docs_{name}", DOCS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("exhibit", script("site").EXHIBITS, ids=lambda e: e.title)
def test_every_exhibit_names_a_config_and_a_method_that_are_there(exhibit):
    config = load_config(exhibit.config, overrides=[*exhibit.settings, f"render.transport=[{exhibit.transport}]"])
    assert config.render.transport == (exhibit.transport,)
    assert exhibit.method in METHODS


def test_the_gallery_shows_a_picture_and_the_commands_that_make_it(tmp_path):
    site = script("site")
    exhibit = site.Exhibit("Two lamps", "sphere_quick.yaml", (), "direct", "drew-kontsevich", "Says.")
    page = site.gallery((exhibit,), tmp_path / "gallery", tmp_path / "run", size=40)
    assert "![picture, true normals, recovered normals, error](gallery/0.webp)" in page
    assert "render --config sphere_quick.yaml --transport direct" in page
    from PIL import Image

    with Image.open(tmp_path / "gallery" / "0.webp") as strip:
        assert strip.size == (4 * 40 + 3 * 4, 40)
    assert "status ok" in page


def test_kept_studies_are_small_and_name_their_figures(tmp_path):
    import numpy as np

    from huesphere.eval.studies.page import Figure, Section, Study, write_study

    figure = Figure("one", "One", np.zeros((8, 9, 3), np.uint8))
    write_study(tmp_path / "made", Study("s", "t", ("a",), (Section("x", figures=(figure,)),), ({"n": 1.0},)))
    script("studies").keep(tmp_path / "made", tmp_path / "kept")
    assert "![One](figures/one.webp)" in (tmp_path / "kept" / "study.md").read_text()
    assert {p.name for p in (tmp_path / "kept").iterdir()} == {"study.md", "results.csv", "figures"}


@pytest.mark.slow
def test_the_notebook_runs_and_becomes_a_page(tmp_path):
    page = script("site").notebook_page(DOCS / "notebooks" / "first_look.ipynb", tmp_path / "notebook")
    assert "'weak-integrability': 'ok'" in page
    assert page.count("![output of the cell above]") == 2
    assert len(list((tmp_path / "notebook").glob("*.png"))) == 2


@pytest.mark.slow
def test_the_site_builds_without_a_warning_and_fetches_nothing(tmp_path):
    docs = tmp_path / "docs"
    shutil.copytree(DOCS, docs)
    for made in ("gallery", "notebook"):  # what `make docs` makes first
        (docs / f"{made}.md").write_text(f"# {made}\n")
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", str(docs), str(tmp_path / "site")],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "site" / "methods" / "rotation.html").read_text()
    assert page.count("<math") > 10
    for path in (tmp_path / "site").rglob("*.html"):
        text = path.read_text()
        assert 'src="http' not in text, path.name
        assert 'rel="stylesheet" href="http' not in text, path.name
