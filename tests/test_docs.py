"""The documentation says what is so: links, names and figures are there, its gallery renders, its site builds."""

import ast
import importlib.util
import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from huesphere.configs.load import load_config
from huesphere.eval.metrics import COLUMNS
from huesphere.recover.io.estimate import write_estimate
from huesphere.recover.methods.table import METHODS
from huesphere.recover.reasons import REASONS
from huesphere.recover.status import REMEDIES
from huesphere.render.exr import read_exr

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
TOP = ("configs", "scenes", "render", "recover", "eval")
MADE = ("gallery.md", "notebook.md", "api")  # by `make docs`
PAGES = sorted(p for p in DOCS.rglob("*.md") if not str(p.relative_to(DOCS)).startswith(MADE))
TEXTS = [*PAGES, ROOT / "README.md"]


def script(name: str):
    spec = importlib.util.spec_from_file_location(f"docs_{name}", DOCS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def short(path: Path) -> str:
    return str(path.relative_to(ROOT))


@cache
def text_of(path: Path) -> str:
    return path.read_text(encoding="utf-8")


@cache
def anchors(path: Path) -> set[str]:
    """Anchors of a page's headings, as MyST and GitHub make them."""
    titles = re.findall(r"^#+ (.*)$", re.sub(r"```.*?```", "", text_of(path), flags=re.DOTALL), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("path", TEXTS, ids=short)
def test_links_lead_to_pages_and_headings_that_are_there(path):
    for target in re.findall(r"\]\(([^)\s]+)\)", re.sub(r"```.*?```|`[^`]*`", "", text_of(path), flags=re.DOTALL)):
        if re.match(r"[a-z]+:", target):
            continue
        name, _, anchor = target.partition("#")
        other = (path.parent / name).resolve() if name else path
        if DOCS in other.parents and str(other.relative_to(DOCS)).startswith(MADE):
            continue
        assert other.exists(), f"{target} in {short(path)}"
        assert not anchor or anchor in anchors(other), f"{target} in {short(path)}"


@pytest.mark.parametrize("path", PAGES, ids=short)
def test_no_line_of_a_page_is_lost_as_a_comment(path):
    assert not [line for line in text_of(path).splitlines() if line.startswith("%")]  # as MyST marks comments


def test_names_in_tables_break_after_their_dots():
    context = {"body": '<td><span class="pre">a.b_c/d</span> e.f</td><p><span class="pre">a.b</span></p>'}
    script("conf").names_that_break(None, "", "", context, None)
    assert context["body"] == (
        '<td><span class="pre">a.<wbr>b_<wbr>c/<wbr>d</span> e.f</td><p><span class="pre">a.b</span></p>'
    )


@cache
def names_in(module: Path) -> set[str]:
    """What a module defines at its top, and members of its classes as ``Class.member``."""
    found = set()
    for node in ast.parse(text_of(module)).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        if isinstance(node, ast.ClassDef):
            found |= {f"{node.name}.{inner.name}" for inner in node.body if isinstance(inner, ast.FunctionDef)}
        if isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            found |= {name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)}
    return found


def module_of(dotted: str) -> tuple[Path | None, str]:
    """The file of the module that a dotted name begins with, and what of the name is left; None if there is none."""
    parts = dotted.removeprefix("huesphere.").split(".")
    for count in range(len(parts), 0, -1):
        path = ROOT / Path(*parts[:count])
        for file in (path.with_suffix(".py"), path / "__init__.py"):
            if file.is_file():
                return file, ".".join(parts[count:])
    return None, dotted


@pytest.mark.parametrize("path", TEXTS, ids=short)
def test_every_file_module_and_function_that_is_named_is_there(path):
    code = re.findall(r"(?<!`)`([^`\n]+)`(?!`)", text_of(path))
    for name in code:
        if re.fullmatch(r"(?:[\w.]+/)+[\w.]+\.(?:py|md|tsv|sh)", name) and not name.startswith("run/"):
            assert (ROOT / name).exists(), f"{name} in {short(path)}"
        if re.fullmatch(rf"(?:huesphere\.)?(?:{'|'.join(TOP)})(?:\.[A-Za-z_]\w*)+", name) and not name.endswith(
            ".html"
        ):
            module, rest = module_of(name)
            known = module is not None and (not rest or rest in names_in(module))
            assert known or is_config_key(name), f"{name} in {short(path)}"


def is_config_key(name: str) -> bool:
    """Keys of a config read as dotted names do: ``recover.lights``, ``render.samples``."""
    from huesphere.configs.schema import RunConfig

    top, _, key = name.partition(".")
    field = RunConfig.model_fields.get(top)
    return field is not None and key in getattr(field.annotation, "model_fields", {})


def table_rows(page: Path) -> dict[str, str]:
    """Rows of a page's tables by what stands in code type in the first column."""
    rows = [line.strip("| ").split(" | ", 1) for line in text_of(page).splitlines() if line.startswith("| `")]
    return {name: row[1] for row in rows for name in re.findall("`([^`]+)`", row[0])}


def test_every_method_is_described_where_methods_are_chosen():
    assert set(METHODS) == set(table_rows(DOCS / "recover" / "index.md"))
    assert set(METHODS) <= set(table_rows(ROOT / "README.md"))


def test_every_status_is_described_with_its_remedy():
    assert set(REMEDIES) == set(table_rows(DOCS / "recover" / "failures.md"))


def test_every_code_of_a_pixels_reason_is_in_the_format():
    rows = {line for line in text_of(DOCS / "format.md").splitlines() if line.startswith("| ")}
    for code, (name, text) in REASONS.items():
        assert f"| {int(code)} | `{name}` | {text} |" in rows


def test_every_channel_and_field_of_an_estimate_on_disk_is_in_the_format(tmp_path):
    observation = script("figures").scene(size=48).observation
    estimate = replace(METHODS["drew-kontsevich"](observation), depth=np.zeros((48, 48), np.float32))
    (tmp_path / "observation.exr").write_bytes(b"")
    write_estimate(tmp_path, estimate, tmp_path / "observation.exr")
    section = text_of(DOCS / "format.md").split("## estimates")[1]
    channels, fields = (set(re.findall("`([^`]+)`", part)) for part in section.split("`<method>.json`:"))
    written = set(read_exr(tmp_path / "drew-kontsevich.exr")[0])
    assert written <= channels | {"normal.Y", "normal.Z"}
    record = json.loads((tmp_path / "drew-kontsevich.json").read_text())
    assert set(record) <= fields
    assert set(record["solution"]) | set(record["solution"]["convexity"]) | set(record["ellipsoid"]) <= fields


def test_every_column_of_the_metrics_is_explained():
    table = text_of(DOCS / "evaluate.md").split("## What the numbers mean")[1].split("\n\n**")[0]
    said = set(re.findall("`([^`]+)`", table)) | {"config", "transport", "method"}  # which picture and method
    for name in COLUMNS:
        assert name in said or "_" + name.removeprefix("within_") in said, name


def equations() -> dict[int, set[Path]]:
    """Numbers of the report's equations that the code names, and the modules that do."""
    found: dict[int, set[Path]] = {}
    for package in ("recover", "render"):
        for module in (ROOT / package).rglob("*.py"):
            for line in text_of(module).splitlines():
                for numbers in re.findall(r"\bEqs?\. ((?:\(\d+\)(?:, |–| and )?)+)", line):
                    for number in () if "J. Opt." in line else re.findall(r"\d+", numbers):  # not of other papers
                        found.setdefault(int(number), set()).add(module)
    return found


def test_every_equation_in_the_code_is_in_the_table_of_conventions_beside_its_module():
    table = text_of(DOCS / "conventions.md").split("## Symbols")[1]
    for number, modules in sorted(equations().items()):
        rows = [row for row in table.splitlines() if row.startswith("| ") and f"({number})" in row.split(" | ")[0]]
        assert rows, f"Eq. ({number})"
        named = {module_of(name)[0] for row in rows for name in re.findall(r"`((?:recover|render)\.[\w.]+)`", row)}
        assert named & modules, f"Eq. ({number}): none of {sorted(map(short, modules))}"


def test_every_figure_has_a_page_and_a_function_that_draws_it():
    drawn = set(script("figures").FIGURES)
    files = {path.stem: path for path in (DOCS / "recover" / "figures").glob("*.png")}
    shown = {name for page in PAGES for name in re.findall(r"\]\(figures/([\w-]+)\.png\)", text_of(page))}
    assert drawn == set(files) == shown
    for path in files.values():
        assert path.stat().st_size < 150_000, path.name


def test_a_figure_is_drawn_from_a_scene_whose_truth_is_exact():
    figures = script("figures")
    made = figures.scene(directions=figures.lights_at(20.0))
    assert (made.seen[made.mask] == 5).all()
    error = made.observation.rgb - made.normals @ made.F.T
    assert abs(error[made.mask]).max() < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ellipsoid", "rotation", "lights", "depth", "uncertainty", "perspective", "failures"])
def test_figures_are_drawn_as_they_are_kept(name, tmp_path, monkeypatch):
    from PIL import Image

    figures = script("figures")
    monkeypatch.setattr(figures, "FOLDER", tmp_path)
    monkeypatch.setattr(sys, "argv", ["figures.py", name])
    figures.main()
    drawn, kept = (
        np.asarray(Image.open(folder / f"{name}.png").convert("RGB"), float)
        for folder in (tmp_path, DOCS / "recover" / "figures")
    )
    height, width = np.minimum(drawn.shape, kept.shape)[:2]
    assert abs(np.subtract(drawn.shape, kept.shape)).max() < 12  # fonts differ between machines
    assert abs(drawn[:height, :width].mean(axis=(0, 1)) - kept[:height, :width].mean(axis=(0, 1))).max() < 6  # of 255


@pytest.mark.parametrize(
    ("docstring", "wanted"),
    [
        ("|b| a·n and p_y − q_x, r_ alone", "<p>|b| a·n and p_y − q_x, r_ alone</p>"),
        ("a * b ** c", "<p>a * b ** c</p>"),
        ("one ``code_`` more", "<p>one <tt"),
        ("- first\n  goes on\n- second", "<li>first goes on</li>"),
        ("Text.\n\n    r1·N = 0,\n\nmore", "<pre"),
    ],
)
def test_docstrings_are_prose_whatever_stands_in_them(docstring, wanted):
    from docutils.core import publish_parts
    from docutils.writers.html4css1 import Writer

    lines = docstring.splitlines()
    script("conf").plain_prose(None, "function", "f", None, None, lines)
    made = publish_parts("\n".join(lines), writer=Writer(), settings_overrides={"halt_level": 2})["fragment"]
    assert wanted in made


def test_fields_of_a_record_are_listed_with_their_comments():
    from huesphere.recover.rotation.closed_form import Angle

    lines = ["An angle."]
    script("conf").plain_prose(None, "class", "Angle", Angle, None, lines)
    assert any(line.startswith("- ") and "alpha" in line and "radians" in line for line in lines)


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
    build = (
        "import sys; from sphinx.cmd.build import main; code = main(sys.argv[1:]); "
        "sys.exit(code or ('mitsuba was imported' if 'mitsuba' in sys.modules else 0))"
    )
    done = subprocess.run(
        [sys.executable, "-c", build, "-q", "-W", "--keep-going", str(docs), str(tmp_path / "site")],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "site" / "recover" / "rotation.html").read_text()
    assert page.count("<math") > 10
    page = (tmp_path / "site" / "api" / "huesphere.recover.ellipsoid.html").read_text()
    assert "least_median_of_squares" in page
    for path in (tmp_path / "site").rglob("*.html"):
        text = path.read_text()
        assert 'src="http' not in text, path.name
        assert 'rel="stylesheet" href="http' not in text, path.name
