"""docs/architecture.md says which files run for each method, and in which order: the drawing is that of the code."""

import re
import sys
from pathlib import Path

import pytest

from huesphere.recover.methods.table import METHODS

sys.path.insert(0, str(Path(__file__).parent / "golden"))
from estimates import architecture as architecture_script
from estimates import made

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"


@pytest.fixture(scope="module")
def architecture():
    return architecture_script()


def test_every_file_of_every_package_is_on_the_page(architecture):
    text = (DOCS / "architecture.md").read_text(encoding="utf-8")
    drawn = (DOCS / "images/architecture.svg").read_text(encoding="utf-8")
    for package in architecture.PACKAGES:
        for path in (ROOT / "recover" / package).glob("*.py"):
            if path.stem not in architecture.LEFT_OUT:
                assert f"`{package}/{path.stem}`" in text or (package == "geometry" and f">{path.stem}<" in drawn), path
    assert set(re.findall(r"^### (\S+)$", text, re.MULTILINE)) == set(METHODS)
    for name in re.findall(r"`([a-z_]+/[a-z0-9_]+)`", text.split("## Method by method")[1]):
        assert (ROOT / "recover" / f"{name}.py").is_file(), name


def test_the_page_is_what_the_methods_do_today(architecture):
    """When this fails after a change of the steps: python docs/architecture.py."""
    order = architecture.orders(lambda name, method: made(name, method).files)
    assert architecture.page(order) == (DOCS / "architecture.md").read_text(encoding="utf-8")
    assert architecture.drawing(order) == (DOCS / "images/architecture.svg").read_text(encoding="utf-8")
