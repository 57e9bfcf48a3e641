"""Sets keys of a config by their dotted name, such as ``lights.0.intensity``."""

from typing import Any

from huesphere.configs.errors import InputError


def set_key(data: dict[str, Any], key: str, value: Any, *, what: str) -> tuple[str | int, ...]:
    """Set one key of ``data`` in place; items of lists are given by number. Mappings that are missing are added.

    ``what`` is the origin of the key for error messages: "--set" or "sweep". Returns the place that was set, as a tuple
    of keys and indices. Raises InputError if there is no such place.
    """
    parts = key.strip().split(".")
    target: Any = data
    steps: list[str | int] = []
    for depth, part in enumerate(parts):
        last = depth == len(parts) - 1
        place = ".".join(parts[: depth + 1])
        if isinstance(target, list):
            if not part.isdigit() or int(part) >= len(target):
                raise InputError(f"{what} {place}", got=part, expected=f"an index below {len(target)}")
            step: Any = int(part)
        elif isinstance(target, dict):
            step = part
        else:
            raise InputError(f"{what} {place}: {'.'.join(parts[:depth])} is a single value and has no keys")
        steps.append(step)
        if last:
            target[step] = value
        else:
            if isinstance(target, dict) and not isinstance(target.get(step), dict | list):
                target[step] = {}
            target = target[step]
    return tuple(steps)
