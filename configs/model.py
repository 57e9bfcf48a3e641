"""The base class of all models of the configuration."""

from functools import cache
from typing import Any, get_args

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

LARGEST = 1e12  # of all numbers: squares and products of such numbers are finite
SMALLEST = 1e-12  # of numbers other than 0 that stand alone; components of vectors may be smaller


class Model(BaseModel):
    """A mapping of keys; nothing changes once it is validated.

    Refused are unknown keys, NaN and infinity, and true or false where a number or a text is expected, which pydantic
    would take for 1 or 0.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _no_boolean_for_a_number(cls, data: Any) -> Any:
        wrong = _wrong_booleans(cls, data) if isinstance(data, dict) else []
        if wrong:
            raise ValidationError.from_exception_data(cls.__name__, wrong)
        return data

    @model_validator(mode="after")
    def _no_extreme_numbers(self) -> "Model":
        """Refuse numbers that no scene is made of, and that arithmetic turns into infinity or 0."""
        errors: list[InitErrorDetails] = []
        for name in type(self).model_fields:
            value = getattr(self, name)
            if isinstance(value, int | float) and not _usual(value, SMALLEST):
                errors.append(_extreme((name,), value, f"0, or {SMALLEST:g} to {LARGEST:g} in magnitude"))
            elif isinstance(value, tuple):
                numbers = [(i, one) for i, one in enumerate(value) if isinstance(one, int | float)]
                errors += [
                    _extreme((name, i), one, f"at most {LARGEST:g} in magnitude")
                    for i, one in numbers
                    if not _usual(one, 0.0)
                ]
        if errors:
            raise ValidationError.from_exception_data(type(self).__name__, errors)
        return self


def _wrong_booleans(model: type[BaseModel], data: dict[str, Any]) -> list[InitErrorDetails]:
    """An error for each key of ``data`` that is true or false, or a list with either, and may not be."""
    found: list[InitErrorDetails] = []
    for name, value in data.items():
        if name in model.model_fields and _holds_boolean(value) and not _takes_boolean(model, name):
            kind = PydanticCustomError("boolean", "{expected}", {"expected": _expected(model, name)})
            found.append({"type": kind, "loc": (name,), "input": value})
    return found


def _holds_boolean(value: Any) -> bool:
    """Whether ``value`` is true or false, or a list with one of them in it. Mappings are left to their own models."""
    if isinstance(value, list | tuple):
        return any(_holds_boolean(one) for one in value)
    return isinstance(value, bool)


@cache
def _takes_boolean(model: type[BaseModel], name: str) -> bool:
    """Whether the field ``name`` may be true or false, or pydantic itself takes neither for a value of its kind."""
    types = _types_in(model.model_fields[name].annotation)
    return bool in types or Any in types or not _expected(model, name)


def _expected(model: type[BaseModel], name: str) -> str:
    """Numbers and texts that the field ``name`` takes, as words of an error message; "" if it takes neither."""
    types = _types_in(model.model_fields[name].annotation)
    words = [word for kind, word in ((float, "a number"), (int, "a whole number"), (str, "a name")) if kind in types]
    return " or ".join(words)


def _types_in(annotation: Any) -> list[Any]:
    """The types that an annotation is made of: those of a union, and those of the items of a list or mapping."""
    inner = [one for argument in get_args(annotation) for one in _types_in(argument)]
    return inner or [annotation]


def _usual(value: int | float, smallest: float) -> bool:
    if isinstance(value, int):  # seeds and counts, which their own fields bound
        return True
    return value == 0 or smallest <= abs(value) <= LARGEST


def _extreme(place: tuple[str | int, ...], value: Any, expected: str) -> InitErrorDetails:
    return {"type": PydanticCustomError("extreme", "{expected}", {"expected": expected}), "loc": place, "input": value}
