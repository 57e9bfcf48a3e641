"""Tuned numbers: few, in records, each read somewhere, with its unit, meaning and origin."""

import dataclasses
import importlib.util
import re
from pathlib import Path

import pytest

from huesphere.recover.parameters import described, overridden, records

ROOT = Path(__file__).parent.parent
FIELDS = [(name, field.name) for name, record in records().items() for field in dataclasses.fields(record)]
CODE = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "recover").rglob("*.py"))


def test_there_are_under_two_hundred():
    assert 100 < len(FIELDS) < 200


@pytest.mark.parametrize(("record", "field"), FIELDS)
def test_every_number_is_read_and_described(record, field):
    assert re.search(rf"\b{record}\.{field}\b", CODE), "what has no effect is removed"
    _, value, unit, meaning, origin = next(row for row in described(records()[record]) if row[0] == field)
    assert value is not None
    assert isinstance(unit, str)
    assert meaning[0].isupper()
    assert meaning.endswith((".", "…"))
    assert len(origin) > 10


def test_records_are_frozen_and_can_be_overridden_for_a_while():
    record = records()["METHOD"]
    before = record.least_r2
    with pytest.raises(dataclasses.FrozenInstanceError):
        record.least_r2 = 0.5
    with overridden(record, least_r2=0.5):
        assert record.least_r2 == 0.5
    assert record.least_r2 == before
    with pytest.raises(AttributeError), overridden(record, least_r3=0.5):
        pass


def test_no_record_is_copied_into_module_constants():
    """A number that is copied when a file is imported could not be overridden any more."""
    for name in records():
        assert not re.search(rf"^[A-Z_]+ = .*\b{name}\.", CODE, re.MULTILINE), name


def test_the_page_of_the_numbers_is_up_to_date():
    """When this fails: python docs/parameters.py."""
    spec = importlib.util.spec_from_file_location("parameters_page", ROOT / "docs" / "parameters.py")
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    assert made.page() == (ROOT / "docs" / "parameters.md").read_text(encoding="utf-8")
