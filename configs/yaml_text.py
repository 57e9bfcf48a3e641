"""Parses YAML text safely, with the line of each key, and refuses a key that is given twice.

Plain scalars mean what they mean in YAML 1.2 (``configs.yaml_values``).

libyaml is used where possible, because it is faster than PyYAML's own parser. But it is recursive, and deep nesting
exhausts its stack and crashes the process, so it is given only text that cannot be nested deeply. Text that it rejects
is parsed again by PyYAML, whose error messages are shown; so is text with tabs, which libyaml accepts in more places.
"""

import contextlib
from typing import Any

import yaml

from huesphere.configs.yaml_values import construct_integer, use_core_schema

MOST_NODES = 1_000_000  # keys and values of a text; an alias counts as all the values it stands for
DEEPEST = 2_000  # most levels of nesting for libyaml

Lines = dict[tuple[str | int, ...], int]  # place of a key or value -> its line, from 1


class _Loader(yaml.SafeLoader):
    """Safe YAML that refuses a key given twice."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key_node, _ in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                raise yaml.constructor.ConstructorError(None, None, "a key that is not a word", key_node.start_mark)
            if key_node.value in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"key {key_node.value!r} twice", key_node.start_mark
                )
            seen.add(key_node.value)
        return super().construct_mapping(node, deep)


use_core_schema(_Loader)
_Loader.add_constructor("tag:yaml.org,2002:int", construct_integer)

_FastLoader: Any = None  # composes by libyaml, where PyYAML was built with it
if hasattr(yaml, "CSafeLoader"):

    class _WithLibyaml(yaml.CSafeLoader):
        """The parser of libyaml with the rules of YAML 1.2."""

    use_core_schema(_WithLibyaml)
    _FastLoader = _WithLibyaml


def parse(text: str) -> tuple[Any, Lines]:
    """The data of a YAML ``text``, and the line of each of its keys and values.

    Raises yaml.YAMLError, ValueError, TypeError or RecursionError for what is not YAML, has tags or a key twice, is
    nested too deeply or too large.
    """
    root = _compose(text)
    lines: Lines = {}
    _collect_lines(root, (), lines)  # before it is built: an alias may contain itself, or expand to millions of values
    return (None if root is None else _Loader("").construct_document(root)), lines


def _compose(text: str) -> yaml.Node | None:
    if _FastLoader is not None and "\t" not in text and _deepest(text) <= DEEPEST:
        with contextlib.suppress(yaml.YAMLError):
            return yaml.compose(text, Loader=_FastLoader)
    return yaml.compose(text, Loader=_Loader)


def _deepest(text: str) -> int:
    """An upper bound of the levels of nesting: one for each bracket and two (mapping, list) for each column."""
    return text.count("[") + text.count("{") + 2 * max(map(len, text.splitlines()), default=0)


def _collect_lines(node: yaml.Node | None, place: tuple[str | int, ...], lines: Lines) -> None:
    if len(lines) > MOST_NODES:
        raise ValueError(f"more than {MOST_NODES} keys and values")
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise ValueError("a key that is not a word")
            lines[(*place, key.value)] = key.start_mark.line + 1
            _collect_lines(value, (*place, key.value), lines)
    elif isinstance(node, yaml.SequenceNode):
        for index, value in enumerate(node.value):
            lines[(*place, index)] = value.start_mark.line + 1
            _collect_lines(value, (*place, index), lines)
