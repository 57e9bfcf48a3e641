"""The shape of the house: imports go one way, and recovery and evaluation never load the renderer."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGES = ("configs", "scenes", "render", "recover", "eval")


def imports_of(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module)
    return found


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_imports_only_from_those_to_its_left(package):
    allowed = PACKAGES[: PACKAGES.index(package) + 1]
    for path in (ROOT / package).rglob("*.py"):
        for name in imports_of(path):
            top = (*name.split("."), "")[1] if name.startswith("huesphere") else ""
            assert top not in PACKAGES or top in allowed, f"{path.relative_to(ROOT)} imports {name}"


def test_no_import_cycles_between_modules():
    modules = {
        "huesphere." + ".".join(path.relative_to(ROOT).with_suffix("").parts): path
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
    }
    graph = {name: {i for i in imports_of(path) if i in modules} for name, path in modules.items()}
    done: set[str] = set()

    def visit(name: str, trail: tuple[str, ...]) -> None:
        assert name not in trail, " → ".join((*trail[trail.index(name) :], name))
        if name not in done:
            for other in graph[name]:
                visit(other, (*trail, name))
            done.add(name)

    for name in graph:
        visit(name, ())


@pytest.mark.parametrize("package", ["recover", "eval"])
def test_package_runs_without_mitsuba(package):
    modules = [
        "huesphere." + ".".join(path.relative_to(ROOT).with_suffix("").parts)
        for path in (ROOT / package).rglob("*.py")
        if path.name != "__init__.py"
    ]
    code = (
        "import sys; sys.modules['mitsuba'] = None; sys.modules['drjit'] = None\n"
        f"import importlib\nfor name in {modules!r}: importlib.import_module(name)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_only_the_renderer_knows_mitsuba():
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            known = {name.split(".")[0] for name in imports_of(path)} & {"mitsuba", "drjit"}
            assert not known or package == "render", path.relative_to(ROOT)


def test_recovery_never_reads_truth():
    for path in (ROOT / "recover").rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        assert "read_truth" not in text, path.relative_to(ROOT)
        assert "truth.exr" not in text, path.relative_to(ROOT)


def test_there_are_no_drawers_for_odds_and_ends():
    odd = {"utils", "util", "helpers", "common", "core", "base", "misc"}
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            assert path.stem not in odd, path.relative_to(ROOT)
