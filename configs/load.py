"""Loads configs: reads a YAML file, applies `--set` overrides, and validates; errors name the file, line and key."""

import json
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ValidationError

from huesphere.configs.draws import DISTRIBUTIONS
from huesphere.configs.errors import InputError
from huesphere.configs.places import set_key
from huesphere.configs.regular_file import CONFIG_BYTES, read_text
from huesphere.configs.schema import RunConfig
from huesphere.configs.sweep import expand
from huesphere.configs.yaml_text import Lines, parse

PACKAGED = Path(__file__).parent

# ---- files ---------------------------------------------------------------------------------------------------------


def packaged_names() -> list[str]:
    """Names of the scene configurations that ship with huesphere; studies are in ``configs.study``."""
    return sorted(path.name for path in PACKAGED.glob("*.yaml") if not is_study(path))


def is_study(path: Path) -> bool:
    """Whether the YAML file is the config of a study."""
    return any(line.startswith("study:") for line in path.read_text(encoding="utf-8").splitlines())


def find_config(name_or_path: str) -> Path:
    """The file with the path ``name_or_path``, or the packaged configuration of that name. Raises InputError."""
    path = Path(name_or_path)
    if path.is_file():
        return path
    if path.name == name_or_path:
        for candidate in (PACKAGED / name_or_path, PACKAGED / f"{name_or_path}.yaml"):
            if candidate.is_file() and candidate.suffix == ".yaml":
                return candidate
    near = get_close_matches(path.name, packaged_names(), n=1, cutoff=0.5)
    hint = f"did you mean {near[0]}? " if near else ""
    raise InputError(f"no such config; {hint}packaged are {', '.join(packaged_names())}", where=name_or_path)


def read_yaml(path: Path, *, follow: bool = True) -> tuple[dict[str, Any], Lines]:
    """The mapping in a YAML file, and the line (from 1) of each of its keys.

    ``follow``: whether ``path`` may be a link. Raises InputError if it cannot be read, is no regular file, is not YAML,
    or has tags or a key twice.
    """
    try:
        data, lines = parse(read_text(path, most=CONFIG_BYTES, follow=follow))
    except InputError:
        raise
    except UnicodeDecodeError:
        raise InputError("not a text file in UTF-8", where=path) from None
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", where=path) from None
    except RecursionError:
        raise InputError("nested too deeply", where=path) from None
    except (yaml.YAMLError, ValueError, TypeError) as error:
        mark = getattr(error, "problem_mark", None)
        where = f"{path}:{mark.line + 1}" if mark else path
        raise InputError(f"not valid YAML: {getattr(error, 'problem', None) or error}", where=where) from None
    if not isinstance(data, dict):
        raise InputError("a config is a mapping of keys", got=type(data).__name__, where=path)
    return data, lines


# ---- overrides -----------------------------------------------------------------------------------------------------


def apply_override(data: dict[str, Any], assignment: str) -> tuple[str | int, ...]:
    """Set one key of ``data`` in place, from a text such as ``lights.0.intensity=2`` (items of lists by number).

    A key that a sweep varies is removed from the sweep. Returns the place that was set, as a tuple of keys and indices.
    Raises InputError for an invalid text or place.
    """
    key, sign, text = assignment.partition("=")
    if not sign or not key.strip():
        raise InputError("--set", got=assignment, expected="key.sub=value")
    try:
        value, _ = parse(text)
    except (yaml.YAMLError, ValueError, RecursionError, TypeError):
        raise InputError(f"--set {key}: not a YAML value", got=_short(text)) from None
    swept = data.get("sweep")
    if key.strip().startswith("sweep."):
        name = key.strip().removeprefix("sweep.")
        data["sweep"] = {**(swept if isinstance(swept, dict) else {}), name: value}
        return "sweep", name
    if isinstance(swept, dict) and key.strip() in swept:  # what is set is no longer swept
        data["sweep"] = {k: v for k, v in swept.items() if k != key.strip()} or None
    return set_key(data, key, value, what="--set")


# ---- validation ----------------------------------------------------------------------------------------------------


Places = dict[tuple[str | int, ...], str]  # key place -> where it was written ("file.yaml:12", "--set")


def validate(data: dict[str, Any], *, where: object, places: Places | None = None) -> RunConfig:
    """``data`` as a RunConfig. Raises InputError for the most specific error, with its file, line and key.

    ``where`` is the file, and ``places`` has the origin of each key ("file.yaml:12", "--set").
    """
    try:
        return RunConfig.model_validate(data)
    except ValidationError as error:
        raise _one_line(error.errors(include_url=False), data, where, places or {}) from None


def _one_line(errors: list[Any], data: dict[str, Any], where: object, places: Places) -> InputError:
    """The InputError for the most specific of all errors that validation found, one for each member of a union."""

    def worth(error: Any) -> tuple[bool, int, bool]:
        at = _written_place(error["loc"], data)
        unknown = error["type"] == "extra_forbidden" and at[-1] not in _known_keys(at[:-1], data)
        return unknown, len(at), error["type"] not in ("literal_error", "float_type", "string_type", "model_type")

    known_key = [e for e in errors if e["type"] != "extra_forbidden" or worth(e)[0]]
    first = max(known_key or errors, key=worth)
    place = _written_place(first["loc"], data)
    where_line = next((places[place[:n]] for n in range(len(place), 0, -1) if place[:n] in places), where)
    name = _dotted(place) or "config"
    if first["type"] == "extra_forbidden":
        near = get_close_matches(str(place[-1]), _known_keys(place[:-1], data), n=1, cutoff=0.5)
        hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(_known_keys(place[:-1], data))}"
        return InputError(f"unknown key {name}; {hint}", where=where_line)
    if first["type"] == "missing":
        return InputError(f"{name} is missing", where=where_line)
    if first["type"] in ("union_tag_invalid", "literal_error"):
        context = first["ctx"]
        expected = context.get("expected_tags") or context.get("expected")
        got = context.get("tag", first["input"])
        near = get_close_matches(
            str(got), [e.strip(" '") for e in expected.replace(" or ", ",").split(",")], n=1, cutoff=0.5
        )
        hint = f" (did you mean {near[0]!r}?)" if near else ""
        if first["type"] == "union_tag_invalid":
            name += ".kind"
        return InputError(name, got=got, expected=f"one of {expected}{hint}", where=where_line)
    if first["type"] == "union_tag_not_found":
        return InputError(f"{name}.kind is missing", where=where_line)
    message = first["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
    if first["type"] == "value_error":
        return InputError(f"{name}: {message}", got=_short(first["input"]), where=where_line)
    return InputError(name, got=_short(first["input"]), expected=message, where=where_line)


def _written_place(loc: tuple[str | int, ...], data: Any) -> tuple[str | int, ...]:
    """The part of a validation location that is in ``data``; pydantic adds the names of union members to it."""
    place: list[str | int] = []
    node = data
    for position, part in enumerate(loc):
        if isinstance(node, dict) and (part in node or position == len(loc) - 1):
            place.append(part)
            node = node.get(part)
        elif isinstance(node, list | tuple) and isinstance(part, int) and part < len(node):
            place.append(part)
            node = node[part]
    return tuple(place)


def _known_keys(place: tuple[str | int, ...], data: Any) -> list[str]:
    """The keys that are allowed at ``place``, which are those of the model that validates it."""
    models: list[type[BaseModel]] = [RunConfig]
    node: Any = data
    for part in place:
        node = node[part] if isinstance(node, dict | list | tuple) else None  # type: ignore[index]
        if isinstance(part, int):
            continue
        annotations = [m.model_fields[part].annotation for m in models if part in m.model_fields]
        models = [m for annotation in annotations for m in _models_in(annotation)]
    kind = node.get("kind") if isinstance(node, dict) else None
    meant = [m for m in models if kind is None or "kind" not in m.model_fields or kind in _literals(m)]
    return sorted({key for m in meant or models for key in m.model_fields})


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [m for argument in getattr(annotation, "__args__", ()) for m in _models_in(argument)]


def _literals(model: type[BaseModel]) -> tuple[Any, ...]:
    return getattr(model.model_fields["kind"].annotation, "__args__", ())


def _dotted(place: tuple[str | int, ...]) -> str:
    return "".join(f"[{p}]" if isinstance(p, int) else f".{p}" for p in place).lstrip(".")


def _short(value: Any) -> str:
    try:
        text = repr(value)
    except ValueError:  # Python refuses to write whole numbers of thousands of digits
        text = "a whole number of thousands of digits"
    return text if len(text) <= 60 else f"{text[:57]}..."


# ---- reading and writing configs ------------------------------------------------------------------------------------


def load_configs(
    name_or_path: str, *, overrides: list[str] | tuple[str, ...] = (), shape: str | None = None
) -> tuple[RunConfig, ...]:
    """Read a config file, apply overrides, replace its shape by the file ``shape``, expand its sweep, and validate.

    Paths inside a config are relative to the config's own folder; paths on the command line to the current one.
    Raises InputError for anything that is wrong.
    """
    path = find_config(name_or_path)
    data, lines = read_yaml(path)
    if "study" in data:
        raise InputError("this is a study, not a scene", expected=f"evaluate --study {name_or_path}", where=path)
    data.setdefault("name", path.stem)
    anchor_paths(data, path.parent)
    places = {place: f"{path}:{line}" for place, line in lines.items()}
    for assignment in overrides:
        places[apply_override(data, assignment)] = "--set"
    if shape is not None:
        data["shape"] = {"kind": _kind_of_file(Path(shape)), "path": str(Path(shape).resolve())}
    where = places.get(("sweep",), str(path))
    return tuple(validate(one, where=path, places=places | swept) for one, swept in expand(data, where))


def load_config(
    name_or_path: str, *, overrides: list[str] | tuple[str, ...] = (), shape: str | None = None
) -> RunConfig:
    """`load_configs` for a file that describes one item. Raises InputError for a sweep of several."""
    configs = load_configs(name_or_path, overrides=overrides, shape=shape)
    if len(configs) > 1:
        raise InputError("a sweep", got=f"{len(configs)} items", expected="one", where=name_or_path)
    return configs[0]


DEPTH_MAP_SUFFIXES = (".npz", ".npy", ".exr", ".png", ".txt", ".asc", ".csv", ".tif", ".tiff")
MESH_SUFFIXES = (".ply", ".obj", ".stl", ".off", ".glb", ".gltf", ".3mf", ".dae")


def _kind_of_file(path: Path) -> str:
    """The kind of shape that a file holds, by its suffix. Raises InputError for an unknown one."""
    if path.suffix.lower() in DEPTH_MAP_SUFFIXES:
        return "depth_map"
    if path.suffix.lower() in MESH_SUFFIXES:
        return "mesh"
    known = ", ".join(DEPTH_MAP_SUFFIXES + MESH_SUFFIXES)
    raise InputError(
        "not a shape that can be read", got=f"suffix {path.suffix!r}", expected=f"one of {known}", where=path
    )


def anchor_paths(node: Any, folder: Path) -> None:
    """Make the values of `path` and `csv` keys absolute, in place; also the values that a sweep lists for them."""
    if isinstance(node, dict):
        for key, value in node.items():
            if str(key).rpartition(".")[2] in ("path", "csv"):
                node[key] = _anchored(value, folder)
            else:
                anchor_paths(value, folder)
    elif isinstance(node, list):
        for value in node:
            anchor_paths(value, folder)


def _anchored(value: Any, folder: Path) -> Any:
    if isinstance(value, str) and "\0" not in value:
        return str((folder / value).resolve())
    if isinstance(value, list):
        return [_anchored(one, folder) for one in value]
    return {key: _anchored(one, folder) for key, one in value.items()} if isinstance(value, dict) else value


def dump_config(config: RunConfig) -> str:
    """``config`` as YAML text with all defaults; loading it gives an equal config."""
    return yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False, allow_unicode=True)


def export_schema() -> str:
    """The JSON Schema of a config, for editors."""
    schema = RunConfig.model_json_schema()
    schema["title"] = "huesphere run configuration"
    one_of = [{"type": "object", "properties": {kind: {}}, "required": [kind]} for kind in DISTRIBUTIONS]
    schema["properties"]["sweep"] = {
        "type": "object",
        "properties": {"count": {"type": "integer", "minimum": 1}, "seed": {"type": "integer", "minimum": 0}},
        "additionalProperties": {"anyOf": [{"type": "array", "minItems": 1}, *one_of]},
        "description": "keys with lists of values: all combinations are items; those that share geometry, one trace. "
        "Keys with distributions: count draws of each combination",
    }
    return json.dumps(schema, indent=1, sort_keys=True) + "\n"
