"""From YAML text to data: safe, no key twice, each key with its line; by libyaml where possible, which is faster.

libyaml's parser is recursive, and crashes the process where deep nesting exhausts the stack. It is therefore given only
text that cannot be nested deeply. Text that it rejects is read again by PyYAML, whose errors are shown. So is text with
tabs, which libyaml accepts as spaces in more places.
"""

import contextlib
from typing import Any

import yaml

MOST_NODES = 1_000_000  # keys and values of a text; an alias counts as what it stands for
DEEPEST = 2_000  # levels of nesting that libyaml is given

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
    if hasattr(yaml, "CSafeLoader") and "\t" not in text and _deepest(text) <= DEEPEST:
        with contextlib.suppress(yaml.YAMLError):
            return yaml.compose(text, Loader=yaml.CSafeLoader)
    return yaml.compose(text, Loader=_Loader)


def _deepest(text: str) -> int:
    """An upper bound of the levels of ``text``: each bracket opens one, and each column a mapping and a list."""
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
