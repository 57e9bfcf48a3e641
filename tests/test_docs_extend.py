"""The recipes of docs/extend.md are carried out: their code is applied to a copy of the source tree, and run there."""

import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parent.parent
PACKAGES = ("configs", "scenes", "render", "recover", "eval")
PAGE = (ROOT / "docs/extend.md").read_text(encoding="utf-8")
RECIPES = ("A shape", "A light", "A method")


@dataclass(frozen=True)
class Tree:
    """A copy of the source tree, and beside it a folder in which it has the shape of the installed package."""

    root: Path
    path: Path  # for PYTHONPATH

    def run(self, *command: str) -> subprocess.CompletedProcess[str]:
        bin_and_path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        environment = os.environ | {"PYTHONPATH": str(self.path), "PATH": bin_and_path}
        return subprocess.run(
            command, cwd=self.root, env=environment, capture_output=True, text=True, timeout=500, check=False
        )


@pytest.fixture
def tree(tmp_path) -> Tree:
    copy = Tree(tmp_path / "source", tmp_path / "installed")
    (copy.path / "huesphere").mkdir(parents=True)
    for package in PACKAGES:  # with what is compiled already: copies keep the times by which it is known to be current
        shutil.copytree(ROOT / package, copy.root / package)
        (copy.path / "huesphere" / package).symlink_to(copy.root / package)
    for file in (ROOT / "huesphere").glob("*.py"):
        shutil.copy2(file, copy.path / "huesphere")
    (copy.root / "tests").mkdir()
    shutil.copy2(ROOT / "tests/conftest.py", copy.root / "tests")
    shutil.copy2(ROOT / "pyproject.toml", copy.root)
    return copy


def blocks_of(recipe: str) -> list[tuple[str, str]]:
    """(language, text) of the code blocks in a section of the page, in their order."""
    section = PAGE.split(f"\n## {recipe}\n")[1].split("\n## ")[0]
    return re.findall(r"^```(\w+)\n(.*?)^```$", section, flags=re.MULTILINE | re.DOTALL)


def apply(tree: Tree, language: str, text: str) -> Path:
    """Write the new file of a block, or make its change: what it says to be there must be there, once. Its path."""
    header, _, body = text.partition("\n")
    path = tree.root / header.removeprefix("# ")
    if language == "python":
        assert not path.exists(), f"{path} of the recipe is there already"
        path.write_text(body, encoding="utf-8")
        return path
    lines = body.splitlines()
    assert {line[:1] for line in lines} <= {"+", "-", " ", ""}, body
    before = "".join(f"{line[1:]}\n" for line in lines if not line.startswith("+"))
    after = "".join(f"{line[1:]}\n" for line in lines if not line.startswith("-"))
    source = path.read_text(encoding="utf-8")
    assert source.count(before) == 1, f"{header} has not, once:\n{before}"
    path.write_text(source.replace(before, after), encoding="utf-8")
    return path


@pytest.mark.parametrize("recipe", RECIPES)
def test_a_recipe_does_what_it_says(recipe, tree):
    blocks = blocks_of(recipe)
    assert {language for language, _ in blocks} == {"python", "diff", "bash"}
    for language, text in blocks:
        if language != "bash":
            apply(tree, language, text)
    where = tree.run(
        "python", "-c", "import huesphere.scenes as s, huesphere.recover as r; print(s.__file__, r.__file__)"
    )
    assert where.stdout.count(str(tree.path)) == 2, where.stderr
    for command in (line for language, text in blocks if language == "bash" for line in text.splitlines()):
        done = tree.run("bash", "-c", command)
        assert done.returncode == 0, f"{command}\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
        assert "skipped" not in done.stdout, done.stdout
    assert list(tree.root.glob("run/*/*/observation.exr"))


def test_the_code_of_the_recipes_keeps_to_the_style_of_the_house(tree):
    blocks = [block for recipe in RECIPES for block in blocks_of(recipe) if block[0] != "bash"]
    changed = {str(apply(tree, *block)) for block in blocks}
    for check in (("check",), ("format", "--check")):
        done = tree.run("ruff", *check, *changed)
        assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("name", ["shape torus", "light disc", "method trimmed"])
def test_without_its_recipe_nothing_of_it_is_known(name, tree):
    """The recipes are tested on the copy: what they add is nowhere else."""
    what, value = name.split()
    command = {
        "shape": f"render --config sphere_quick --set 'shape={{kind: {value}}}'",
        "light": f"render --config sphere_quick --set 'lights=[{{kind: {value}}}]'",
        "method": f"recover . --method {value}",
    }[what]
    done = tree.run("bash", "-c", command)
    assert done.returncode == 2, done.stdout
    assert value in done.stderr
