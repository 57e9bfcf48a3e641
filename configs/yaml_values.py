"""What plain YAML scalars mean: the core schema of YAML 1.2, in which only what looks like a number is one.

PyYAML implements YAML 1.1, in which ``yes`` and ``on`` are booleans, ``012`` is ten (octal), ``1:04`` is 64 (base
sixty), ``1_000`` is a number, ``2026-01-02`` is a date, and ``1e-3`` is a text. By the core schema of YAML 1.2 (section
10.3.2) the first five are texts or, for ``012``, the number 12, and ``1e-3`` is a number. Merge keys (``<<``) of YAML
1.1 are kept.
"""

import re
from typing import Any

import yaml

BOOLEAN = re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$")
INTEGER = re.compile(r"^(?:[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+)$")
FLOAT = re.compile(
    r"^(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$"
)
NULL = re.compile(r"^(?:~|null|Null|NULL|)$")
MERGE = re.compile(r"^(?:<<)$")

# Tag, pattern, and the characters with which such a scalar may begin. The first pattern that fits decides.
_SCHEMA = (
    ("bool", BOOLEAN, "tTfF"),
    ("int", INTEGER, "-+0123456789"),
    ("float", FLOAT, "-+.0123456789"),
    ("null", NULL, ["~", "n", "N", ""]),
    ("merge", MERGE, "<"),
)


def use_core_schema(reader: Any) -> None:
    """Give ``reader``, a subclass of a YAML loader or resolver, the rules of YAML 1.2 in place of those of 1.1."""
    reader.yaml_implicit_resolvers = {}
    for tag, pattern, first in _SCHEMA:
        reader.add_implicit_resolver(f"tag:yaml.org,2002:{tag}", pattern, list(first))


def construct_integer(loader: Any, node: yaml.ScalarNode) -> int:
    """The whole number that a scalar with the tag ``int`` stands for: decimal, ``0o17`` or ``0x1F``."""
    text = str(loader.construct_scalar(node))
    base = {"0o": 8, "0x": 16}.get(text[:2], 10)
    return int(text, base)


class CoreSchemaDumper(yaml.SafeDumper):
    """Writes YAML that readers of YAML 1.1 and of YAML 1.2 understand alike: texts special in either are quoted."""


CoreSchemaDumper.add_implicit_resolver("tag:yaml.org,2002:int", INTEGER, list("-+0123456789"))
CoreSchemaDumper.add_implicit_resolver("tag:yaml.org,2002:float", FLOAT, list("-+.0123456789"))
