"""Write docs/configuration.md: every key of a config with its kind, limits, default and meaning, from the schema.

Usage: python docs/configuration.py. Edit the models in ``configs/``, not the page.
"""

import json
import re
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from huesphere.configs.schema import RunConfig
from huesphere.scenes.cameras import NAMES
from huesphere.scenes.spectra import illuminant_names, patch_names

DOCS = Path(__file__).resolve().parent
HEAD = """\
# Configuration reference

<!-- Written by docs/configuration.py. Edit the models in configs/, not this page. -->

Every key of one item, with what may be given, its default, and its meaning with the unit. In addition a config may have
`sweep` ([many pictures](render.md#many-pictures-from-one-config), [distributions](jobs.md#a-sweep)), and leave parts of
the scene to chance ([random scenes](render.md#random-scenes)); studies have keys of their own (`configs/study.py`). A
key below another is reached on the command line by dots: `--set camera.read_noise=1e-3`. A section with `kind`
describes one of several choices. Keys without a default are required. Directions and positions are in the
[camera frame](conventions.md).
"""
# Defaults that `configs.load` gives.
FROM_FILE: dict[tuple[type[BaseModel], str], str] = {(RunConfig, "name"): "the name of the file, without its ending"}


def page() -> str:
    """The text of docs/configuration.md."""
    parts = [HEAD]
    for model in models():
        parts += [f"## {model.__name__}", ""]
        says = model.__dict__.get("__doc__")
        parts += [_prose(re.sub(r"\s+", " ", says.strip())), ""] if says else []
        parts += ["| key | what may be given | default | meaning |", "| --- | --- | --- | --- |"]
        for name, field in model.model_fields.items():
            cells = (f"`{name}`", _given(model, name), _default(model, name, field), _prose(field.description or "–"))
            parts.append(f"| {' | '.join(cells)} |")
        parts.append("")
    parts += ["## Names of emission spectra", "", _listed(illuminant_names()), ""]
    parts += ["## Names of reflectances", "", _listed(patch_names()), ""]
    parts += ["## Names of cameras", "", _listed(NAMES), ""]
    return "\n".join(parts)


def models() -> list[type[BaseModel]]:
    """RunConfig and all models that are reached from it, each once, in the order in which they are met."""
    found: list[type[BaseModel]] = []
    waiting: list[type[BaseModel]] = [RunConfig]
    while waiting:
        model = waiting.pop(0)
        if model not in found:
            found.append(model)
            waiting += [inner for field in model.model_fields.values() for inner in _inside(field.annotation)]
    return found


def _inside(annotation: Any) -> list[type[BaseModel]]:
    """The models in a type, however deep in unions and tuples."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for argument in get_args(annotation) for model in _inside(argument)]


def _given(model: type[BaseModel], name: str) -> str:
    """What a key may hold, from the JSON schema of its model, as Markdown."""
    return _kind(model.model_json_schema()["properties"][name])


def _kind(schema: dict[str, Any]) -> str:
    if "$ref" in schema:
        model = schema["$ref"].rsplit("/", 1)[-1]
        return f"[{model}](#{model.lower()})"
    if "const" in schema or "enum" in schema:
        return ", ".join(f"`{value}`" for value in schema.get("enum", [schema.get("const")]))
    if "anyOf" in schema or "oneOf" in schema:
        return " or ".join(dict.fromkeys(_kind(one) for one in schema.get("anyOf", schema.get("oneOf"))))
    if schema.get("type") == "array":
        if "prefixItems" in schema:
            return f"list of {len(schema['prefixItems'])}: {_kind(schema['prefixItems'][0])}"
        return f"list of: {_kind(schema.get('items', {}))}"
    names = {"number": "number", "integer": "whole number", "string": "text", "boolean": "true, false", "null": "null"}
    limits = (("minimum", "≥"), ("exclusiveMinimum", ">"), ("maximum", "≤"), ("exclusiveMaximum", "<"))
    said = [f"{sign} {schema[key]:g}" for key, sign in limits if key in schema]
    return _prose(" ".join([names.get(schema.get("type", ""), "mapping"), *said]))


def _default(model: type[BaseModel], name: str, field: FieldInfo) -> str:
    if (model, name) in FROM_FILE:
        return FROM_FILE[model, name]
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True)
    if isinstance(value, BaseModel):
        return f"as [{type(value).__name__}](#{type(value).__name__.lower()})"
    return f"`{json.dumps(value, default=str)}`".replace("|", "\\|")


def _listed(names: Any) -> str:
    return ", ".join(f"`{name}`" for name in names)


def _prose(text: str) -> str:
    """``text`` as Markdown in a cell: code stays code, and no sign is taken for markup."""
    return re.sub(r"([|*$<>_])", r"\\\1", text) if "``" not in text else text.replace("``", "`").replace("|", "\\|")


def main() -> None:
    (DOCS / "configuration.md").write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
