"""YAML as text: libyaml and PyYAML say the same, and what is nested without end ends in an error, never in a crash."""

import pytest
import yaml

from huesphere.configs.load import PACKAGED
from huesphere.configs.yaml_text import parse

ODD = [
    "a: 1\nb: [x, {c: 2.5}]\nd: {e: null, f: 'g h'}",
    "a: &x [1, 2]\nb: *x",
    "a: |\n  many\n  lines\nb: >-\n  folded\n  text",
    "? a\n: b",
    "",
    "# nothing",
    "ä: ö\nnumber: 1e-3\nother: 1.0e-3\nyes: no",
    "a: 1\na: 2",
    "a: !!python/object:os.system x",
    "a: [1",
    "a:\tb",
    "a: b: c",
    "- - - 1",
    "a: 2026-01-01",
    "\x00",
]


def said(text: str) -> object:
    """What a text is read as; of an error, what it says, and of which line."""
    try:
        return parse(text)
    except (yaml.YAMLError, ValueError, TypeError) as error:
        mark = getattr(error, "problem_mark", None)
        return type(error), getattr(error, "problem", None), mark and mark.line


@pytest.mark.parametrize("text", [*(path.read_text(encoding="utf-8") for path in PACKAGED.glob("*.yaml")), *ODD])
def test_libyaml_makes_no_difference_but_time(text, monkeypatch):
    fast = said(text)
    monkeypatch.delattr(yaml, "CSafeLoader")
    assert said(text) == fast


@pytest.mark.parametrize("text", ["[" * 1500, "[" * 1_000_000, "{a: " * 600, "- " * 1_000_000 + "a", "? " * 5000])
def test_nesting_without_end_is_an_error(text):
    with pytest.raises((RecursionError, yaml.YAMLError)):
        parse(text)
