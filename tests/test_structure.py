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


RECOVER = (  # the order in which the parts of recover may use each other
    *("parameters", "status", "stages", "reasons", "robust_scale", "geometry", "problem", "solution", "pixels", "cues"),
    *(
        "ellipsoid",
        "rotation",
        "uniform_hue",
        "lights",
        "depth",
        "io",
        "interreflection",
        "every_pixel",
        "trust",
        "full_size",
        "baselines",
    ),
    *("methods", "run", "rig", "one_picture", "arrays", "cli"),
)


def test_the_parts_of_recover_import_only_from_those_before_them():
    for path in (ROOT / "recover").rglob("*.py"):
        own = path.relative_to(ROOT / "recover").parts[0].removesuffix(".py")
        if own == "__init__":
            continue
        allowed = RECOVER[: RECOVER.index(own) + 1]
        for name in imports_of(path):
            if name.startswith("huesphere.recover."):
                assert name.split(".")[2] in allowed, f"{path.relative_to(ROOT)} imports {name}"


def reads_of_diagnostics(tree: ast.AST) -> list[int]:
    """Lines where the diagnostics of an estimate are looked into: indexed, searched, or asked for a key."""
    found = []
    for node in ast.walk(tree):
        looked_into = None
        if isinstance(node, ast.Subscript):
            looked_into = node.value
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            looked_into = node.func.value if node.func.attr in ("get", "items", "keys", "values", "pop") else None
        elif isinstance(node, ast.Compare) and any(isinstance(op, ast.In | ast.NotIn) for op in node.ops):
            looked_into = node.comparators[0]
        elif isinstance(node, ast.For | ast.comprehension):
            looked_into = node.iter
        if isinstance(looked_into, ast.Attribute) and looked_into.attr == "diagnostics":
            found.append(looked_into.lineno)
    return found


def test_the_check_for_reads_of_diagnostics_finds_them():
    text = "a.diagnostics['C']\nb = e.diagnostics.get('x')\n'y' in e.diagnostics\nfor k in e.diagnostics: pass\n"
    assert sorted(reads_of_diagnostics(ast.parse(text))) == [1, 2, 3, 4]
    assert reads_of_diagnostics(ast.parse("replace(e, diagnostics=e.diagnostics | {'a': 1})")) == []


def test_diagnostics_are_written_and_never_read_back():
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            lines = reads_of_diagnostics(ast.parse(text))
            assert not lines, f"{path.relative_to(ROOT)}:{lines[0]} reads the diagnostics of an estimate"
            aliased = [n for n in ast.walk(ast.parse(text)) if isinstance(n, ast.Assign) and is_diagnostics(n.value)]
            assert not aliased, f"{path.relative_to(ROOT)}:{aliased[0].lineno} takes the diagnostics of an estimate"


def is_diagnostics(node: ast.AST) -> bool:
    return isinstance(node, ast.Attribute) and node.attr == "diagnostics"


MOST_PARAMETERS, MOST_LINES = 7, 60


def test_long_functions_and_those_of_many_parameters_say_why():
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            lines = path.read_text(encoding="utf-8").splitlines()
            for node in ast.walk(ast.parse("\n".join(lines))):
                if not isinstance(node, ast.FunctionDef):
                    continue
                given = node.args.posonlyargs + node.args.args + node.args.kwonlyargs
                count = len([a for a in given if a.arg not in ("self", "cls")])
                long = node.end_lineno - node.lineno + 1 > MOST_LINES
                near = " ".join(" ".join(lines[max(0, node.lineno - 5) : node.end_lineno]).replace("#", " ").split())
                where = f"{path.relative_to(ROOT)}:{node.lineno} {node.name}"
                assert count <= MOST_PARAMETERS or "seven parameters" in near, f"{where}: {count} parameters"
                assert not long or "sixty lines" in near, where
