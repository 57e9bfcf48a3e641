"""The reference of configs is that of the schema, and the figure for teachers shows what Eq. (6) says."""

import importlib.util
from pathlib import Path

import numpy as np

DOCS = Path(__file__).parent.parent / "docs"


def script(name: str):
    spec = importlib.util.spec_from_file_location(f"docs_{name}_page", DOCS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_reference_is_current_and_has_every_key():
    made = script("configuration")
    kept = (DOCS / "configuration.md").read_text(encoding="utf-8")
    assert kept == made.page(), "run python docs/configuration.py"
    for model in made.models():
        assert f"## {model.__name__}\n" in kept
        for name in model.model_fields:
            assert f"| `{name}` |" in kept


def test_the_colours_of_the_teaching_figure_lie_on_the_ellipsoid_of_its_matrix():
    teaching = script("teaching")
    F = teaching.matrix(330)
    rho = teaching.normals() @ F.T
    C = np.linalg.inv(F @ F.T)
    np.testing.assert_allclose(np.einsum("ni,ij,nj->n", rho, C, rho), 1.0, atol=1e-9)
    conditions = [np.linalg.cond(teaching.matrix(turn)) for turn in teaching.MOVED]
    assert 330 <= teaching.MOVED[int(np.argmin(conditions))] <= 360  # the page calls these the roundest …
    assert conditions[0] > 2 * min(conditions)
    assert conditions[-1] > 2 * min(conditions)


def test_the_teaching_figure_loads_nothing_but_the_library_beside_it():
    text = script("teaching").fragment()
    assert text.count("src=") == 1
    assert 'src="_static/plotly.min.js"' in text
