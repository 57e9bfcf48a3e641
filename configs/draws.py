"""Random values of sweeps: the distributions that a config may give, and draws from them.

{choice: [light skin, 0.8]}   {uniform: [0.2, 0.9]}   {log_uniform: [1e-4, 1e-2]}   {integer: [0, 99]}
{normal: [0.5, 0.1]}          {normal: [0.5, 0.1, 0.2, 0.8]}, drawn again until it lies between the last two
{cone: 60}                    a direction, uniform over the sphere within 60° of the camera's
"""

import hashlib
import json
import math
import random
from collections.abc import Callable
from typing import Any

from huesphere.configs.errors import InputError

DIGITS = 6  # significant digits of a drawn number
MOST_TRIES = 10_000  # draws from a normal distribution with bounds, until one lies between them


def derived_seed(*content: Any) -> int:
    """A seed below 2³¹ that is a function of ``content``, values that JSON can write."""
    text = json.dumps(content, sort_keys=True, default=str)
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "big") >> 1


def is_distribution(value: Any) -> bool:
    """Whether a value in a sweep is written as a distribution, rather than a list."""
    return isinstance(value, dict)


def draw(key: str, written: dict[str, Any], seed: int, number: int, where: object) -> Any:
    """The random value of ``key`` in draw ``number``, from the distribution ``written`` in the sweep.

    It depends only on the arguments, not on other draws. Raises InputError for an invalid distribution.
    """
    if len(written) != 1 or (kind := next(iter(written))) not in _DRAWS:
        names = ", ".join(_DRAWS)
        raise InputError(f"sweep.{key}", got=repr(written)[:60], expected=f"a list, or one of {names}", where=where)
    rng = random.Random(derived_seed(seed, key, number))
    try:
        return _DRAWS[kind](rng, written[kind])
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"sweep.{key}.{kind}: {error}", got=repr(written[kind])[:60], where=where) from None


def _choice(rng: random.Random, values: Any) -> Any:
    if not isinstance(values, list) or not values:
        raise ValueError("expected a list of values")
    return values[int(rng.random() * len(values))]


def _uniform(rng: random.Random, bounds: Any) -> float:
    low, high = _ordered(bounds)
    return _short(low + (high - low) * rng.random(), low, high)


def _log_uniform(rng: random.Random, bounds: Any) -> float:
    low, high = _ordered(bounds)
    if low <= 0:
        raise ValueError("bounds must be positive")
    return _short(math.exp(math.log(low) + math.log(high / low) * rng.random()), low, high)


def _integer(rng: random.Random, bounds: Any) -> int:
    low, high = _ordered(bounds)
    if low != int(low) or high != int(high):
        raise ValueError("bounds must be whole numbers")
    return int(low) + int(rng.random() * (int(high) - int(low) + 1))


def _normal(rng: random.Random, numbers: Any) -> float:
    mean, deviation, *bounds = _numbers(numbers)
    low, high = _ordered(bounds) if bounds else (-math.inf, math.inf)
    if deviation < 0:
        raise ValueError("the standard deviation must not be negative")
    for _ in range(MOST_TRIES):
        value = rng.gauss(mean, deviation)
        if low <= value <= high:
            return _short(value, low, high)
    raise ValueError("almost no draw of this distribution lies between the bounds")


def _cone(rng: random.Random, degrees: Any) -> list[float]:
    """A unit vector, uniform over the sphere within ``degrees`` of +z, which points toward the camera."""
    (half_angle,) = _numbers([degrees])
    if not 0 <= half_angle <= 180:
        raise ValueError("expected degrees from 0 to 180")
    z = 1 - (1 - math.cos(math.radians(half_angle))) * rng.random()
    around, r = 2 * math.pi * rng.random(), math.sqrt(max(0.0, 1 - z * z))
    return [float(f"{c:.{DIGITS}g}") for c in (r * math.cos(around), r * math.sin(around), z)]


def _numbers(values: Any) -> list[float]:
    """``values`` as finite numbers. Raises ValueError for anything else."""
    if not isinstance(values, list):
        raise ValueError("expected a list of numbers")
    if any(isinstance(v, bool) or not isinstance(v, int | float | str) for v in values):
        raise ValueError("expected numbers")
    numbers = [float(v) for v in values]  # YAML 1.1 reads 1e-3 as text
    if not all(math.isfinite(n) for n in numbers):
        raise ValueError("expected finite numbers")
    return numbers


def _ordered(values: Any) -> tuple[float, float]:
    """Two numbers, the smaller one first. Raises ValueError for anything else."""
    numbers = _numbers(values)
    if len(numbers) != 2 or numbers[0] > numbers[1]:
        raise ValueError("expected two numbers, the smaller one first")
    return numbers[0], numbers[1]


def _short(value: float, low: float, high: float) -> float:
    """``value`` rounded to DIGITS significant digits, within the bounds."""
    return min(max(float(f"{value:.{DIGITS}g}"), low), high)


_DRAWS: dict[str, Callable[[random.Random, Any], Any]] = {
    "choice": _choice,
    "uniform": _uniform,
    "log_uniform": _log_uniform,
    "integer": _integer,
    "normal": _normal,
    "cone": _cone,
}
DISTRIBUTIONS = tuple(_DRAWS)
