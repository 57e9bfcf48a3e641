"""Loads configs: reads a YAML file, applies `--set` overrides, and validates; errors name the file, line and key."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ValidationError

from huesphere.configs.draws import DISTRIBUTIONS
from huesphere.configs.errors import InputError
from huesphere.configs.file_paths import absolute_path, expanded, make_absolute, mark_paths, recorded_digests
from huesphere.configs.places import set_key
from huesphere.configs.random_scene import RandomLights
from huesphere.configs.regular_file import CONFIG_BYTES, read_text
from huesphere.configs.schema import RunConfig
from huesphere.configs.suggest import closest
from huesphere.configs.sweep import expand
from huesphere.configs.yaml_text import Lines, parse
from huesphere.configs.yaml_values import CoreSchemaDumper

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
    path = Path(expanded(name_or_path))
    if path.is_file():
        return path
    if path.name == name_or_path:
        for candidate in (PACKAGED / name_or_path, PACKAGED / f"{name_or_path}.yaml"):
            if candidate.is_file() and candidate.suffix == ".yaml":
                return candidate
    near = closest(path.stem, (Path(name).stem for name in packaged_names()))  # every name has the same ending
    hint = f"did you mean {near}.yaml? " if near else ""
    raise InputError(f"no such config; {hint}packaged are {', '.join(packaged_names())}", where=name_or_path)


def read_yaml(path: Path) -> tuple[dict[str, Any], Lines]:
    """The mapping in a YAML file, and the line (from 1) of each of its keys.

    Raises InputError if it cannot be read, is no regular file, is not YAML, or has tags or a key twice.
    """
    try:
        data, lines = parse(read_text(path, most=CONFIG_BYTES))
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
        value = _with_bytes(parse(_without_bytes(text))[0])
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


# Bytes of a file name that is not in the system's encoding are surrogates in Python, which YAML does not allow in a
# text. While it is parsed, they are characters of the private use area.
_BYTES = {0xDC80 + n: 0xE080 + n for n in range(128)}


def _without_bytes(text: str) -> str:
    return text.translate(_BYTES)


def _with_bytes(value: Any) -> Any:
    """``value`` with the bytes back in each of its texts."""
    if isinstance(value, str):
        return value.translate({there: here for here, there in _BYTES.items()})
    if isinstance(value, dict):
        return {key: _with_bytes(one) for key, one in value.items()}
    return [_with_bytes(one) for one in value] if isinstance(value, list) else value


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

    def worth(error: Any) -> tuple[bool, int, bool, bool]:
        at = _written_place(error, data)
        unknown = error["type"] == "extra_forbidden" and at[-1] not in _known_keys(at[:-1], data)
        return (
            unknown,
            len(at),
            error["type"] != "missing",
            error["type"] not in ("literal_error", "float_type", "string_type", "model_type"),
        )

    known_key = [e for e in errors if e["type"] != "extra_forbidden" or worth(e)[0]]
    first = max(known_key or errors, key=worth)
    place = _written_place(first, data)
    where_line = next((places[place[:n]] for n in range(len(place), 0, -1) if place[:n] in places), where)
    name = _dotted(place) or "config"
    if first["type"] == "extra_forbidden":
        known = _known_keys(place[:-1], data)
        near = closest(str(place[-1]), known, cutoff=0.5)
        hint = f"did you mean {near!r}?" if near else f"known are {', '.join(known)}"
        return InputError(f"unknown key {name}; {hint}", where=where_line)
    if first["type"] == "missing":
        return InputError(f"{name} is missing", where=where_line)
    if first["type"] in ("union_tag_invalid", "literal_error"):
        context = first["ctx"]
        expected = context.get("expected_tags") or context.get("expected")
        got = context.get("tag", first["input"])
        near = closest(str(got), [e.strip(" '") for e in expected.replace(" or ", ",").split(",")], cutoff=0.5)
        hint = f" (did you mean {near!r}?)" if near else ""
        if first["type"] == "union_tag_invalid":
            name += ".kind"
        return InputError(name, got=got, expected=f"one of {expected}{hint}", where=where_line)
    if first["type"] == "union_tag_not_found":
        return InputError(f"{name}.kind is missing", where=where_line)
    message = first["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
    words = [e["ctx"]["expected"] for e in errors if e["type"] == "literal_error" and _written_place(e, data) == place]
    if words:
        message = f"{words[0]} or {message}"
    if first["type"] == "value_error":
        return InputError(f"{name}: {message}", got=_short(first["input"]), where=where_line)
    return InputError(name, got=_short(first["input"]), expected=message, where=where_line)


def _written_place(error: Any, data: Any) -> tuple[str | int, ...]:
    """The part of an error's location that is in ``data``; pydantic adds the names of union members to it."""
    place: list[str | int] = []
    node, loc = data, error["loc"]
    of_a_key = error["type"] in ("missing", "extra_forbidden")  # then the last part is a key, even if it is not there
    for position, part in enumerate(loc):
        if isinstance(node, dict) and (part in node or (of_a_key and position == len(loc) - 1)):
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
    """Read a config file, replace its shape by the file ``shape``, apply overrides, expand its sweep, and validate.

    Overrides of keys such as ``shape.rotation`` belong to the file ``shape`` where there is one. Paths inside a config
    are relative to the config's own folder; paths on the command line to the current one. In the validated configs they
    are absolute. Raises InputError for anything that is wrong.
    """
    path = find_config(name_or_path)
    data, lines = read_yaml(path)
    if "study" in data:
        raise InputError("this is a study, not a scene", expected=f"evaluate --study {name_or_path}", where=path)
    data.setdefault("name", path.stem)
    mark_paths(data, path.parent, recorded_digests(path))
    places = {place: f"{path}:{line}" for place, line in lines.items()}
    if shape is not None:
        _require_one_shape(data, overrides, path)
        places = {place: line for place, line in places.items() if place[0] != "shape"}
        data["shape"] = _shape_in(shape, data.get("shape"))
    for assignment in overrides:
        place = apply_override(data, assignment)  # what the file said there and below holds no more
        places = {at: line for at, line in places.items() if at[: len(place)] != place} | {place: "--set"}
        mark_paths(data, Path())
    where = places.get(("sweep",), str(path))
    expansion = ((make_absolute(one), places | swept) for one, swept in expand(data, where))
    return tuple(validate(one, where=path, places=at) for one, at in expansion)


def load_config(
    name_or_path: str, *, overrides: list[str] | tuple[str, ...] = (), shape: str | None = None
) -> RunConfig:
    """`load_configs` for a file that describes one item. Raises InputError for a sweep of several."""
    configs = load_configs(name_or_path, overrides=overrides, shape=shape)
    if len(configs) > 1:
        raise InputError("a sweep", got=f"{len(configs)} items", expected="one", where=name_or_path)
    return configs[0]


CHOOSE_A_SHAPE = ("shape", "shape.kind", "shape.path")  # keys that say which shape it is, rather than how it is shown


def _require_one_shape(data: dict[str, Any], overrides: Sequence[str], where: object) -> None:
    """Raise InputError if an override or the sweep of ``data`` names a shape, as the option --shape does already."""
    for key in (assignment.partition("=")[0].strip() for assignment in overrides):
        if key.removeprefix("sweep.") in CHOOSE_A_SHAPE:
            raise InputError(f"--shape and --set {key}=… both say which shape is meant", expected="one of them")
    swept = data.get("sweep")
    for key in swept if isinstance(swept, dict) else ():
        if key in CHOOSE_A_SHAPE:
            raise InputError(f"--shape, and a sweep over {key}", expected="one of them", where=where)


def _shape_in(shape: str, written: Any) -> dict[str, Any]:
    """The key ``shape`` for what lies at the path ``shape``, in place of what is ``written`` in the config.

    A config of photographs keeps its other keys. Raises InputError as `kind_of_file` does.
    """
    path = absolute_path(shape)
    if isinstance(written, dict) and written.get("kind") == "photographs":
        return {**written, "path": str(path)}
    return {"kind": "photographs" if path.is_dir() else kind_of_file(path), "path": str(path)}


DEPTH_MAP_SUFFIXES = (".npz", ".npy", ".exr", ".png", ".txt", ".asc", ".csv", ".tif", ".tiff")
MESH_SUFFIXES = (".ply", ".obj", ".stl", ".off", ".glb", ".gltf", ".3mf", ".dae")


def kind_of_file(path: Path) -> str:
    """The kind of shape that a file holds, by its suffix. Raises InputError for an unknown one."""
    if path.suffix.lower() in DEPTH_MAP_SUFFIXES:
        return "depth_map"
    if path.suffix.lower() in MESH_SUFFIXES:
        return "mesh"
    known = ", ".join(DEPTH_MAP_SUFFIXES + MESH_SUFFIXES)
    raise InputError(
        "not a shape that can be read", got=f"suffix {path.suffix!r}", expected=f"one of {known}", where=path
    )


def anchor_paths(data: dict[str, Any], folder: Path, digests: Mapping[str, str] | None = None) -> dict[str, Any]:
    """``data`` with absolute paths as the values of `path` and `csv` keys; relative ones are relative to ``folder``.

    ``digests``: see ``file_paths.mark_paths``. ``data`` itself is changed. Raises InputError for a variable in a path
    that is not set.
    """
    mark_paths(data, folder, digests)
    anchored: dict[str, Any] = make_absolute(data)
    return anchored


def dump_config(data: RunConfig | dict[str, Any]) -> str:
    """A config, or the mapping of one, as YAML text with all defaults; loading it gives an equal config."""
    mapping = data.model_dump(mode="json") if isinstance(data, RunConfig) else data
    return yaml.dump(mapping, Dumper=CoreSchemaDumper, sort_keys=False, allow_unicode=True)


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
    lights = schema["properties"]["lights"]
    schema["properties"]["lights"] = {
        "anyOf": [
            lights,
            {
                "type": "object",
                "properties": {"random": RandomLights.model_json_schema(ref_template="#/$defs/{model}")},
                "required": ["random"],
            },
        ]
    }
    return json.dumps(schema, indent=1, sort_keys=True) + "\n"
