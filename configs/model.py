"""The base class of all models of the configuration."""

from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

LARGEST = 1e12  # of all numbers: squares and products of such numbers are finite
SMALLEST = 1e-12  # of numbers other than 0 that stand alone; components of vectors may be smaller


class Model(BaseModel):
    """A mapping of keys: an unknown key, NaN and infinity are refused, and nothing changes once it is validated."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

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


def _usual(value: int | float, smallest: float) -> bool:
    if isinstance(value, int):  # seeds and counts, which their own fields bound
        return True
    return value == 0 or smallest <= abs(value) <= LARGEST


def _extreme(place: tuple[str | int, ...], value: Any, expected: str) -> InitErrorDetails:
    return {"type": PydanticCustomError("extreme", "{expected}", {"expected": expected}), "loc": place, "input": value}
