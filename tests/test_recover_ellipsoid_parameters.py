"""Tuned numbers of pixels, cues and ellipsoid: each is read and described, and learned weights say their origin."""

import json
import re
from pathlib import Path

import pytest

import huesphere.recover
from huesphere.recover.cues.parameters import CUES
from huesphere.recover.cues.silhouette import silhouette_weights
from huesphere.recover.ellipsoid.membership import learned_weights
from huesphere.recover.ellipsoid.parameters import ELLIPSOID
from huesphere.recover.ellipsoid.region_growing import growth_settings
from huesphere.recover.ellipsoid.selection import learned_evidence
from huesphere.recover.parameters import described, overridden
from huesphere.recover.pixels.parameters import PIXELS

RECOVER = Path(huesphere.recover.__file__).parent
RECORDS = {"PIXELS": PIXELS, "CUES": CUES, "ELLIPSOID": ELLIPSOID}


@pytest.mark.parametrize("name", RECORDS)
def test_every_parameter_is_read_by_name_where_it_is_used(name):
    source = "\n".join(path.read_text() for path in RECOVER.rglob("*.py"))
    read = set(re.findall(rf"\b{name}\.(\w+)", source))
    assert {row[0] for row in described(RECORDS[name])} <= read


@pytest.mark.parametrize("name", RECORDS)
def test_every_parameter_has_a_unit_a_meaning_in_a_sentence_and_an_origin(name):
    for field, _, unit, meaning, origin in described(RECORDS[name]):
        assert unit, field
        assert meaning[0].isupper(), field
        assert meaning.endswith("."), field
        assert origin, field


def test_the_three_packages_have_at_most_90_tuned_numbers():
    assert sum(len(described(record)) for record in RECORDS.values()) <= 90


def test_compiled_code_gets_the_values_of_the_moment():
    usual = growth_settings()
    with overridden(ELLIPSOID, near_share=0.5, averaging_window_px=7):
        changed = growth_settings()
    assert (changed != usual).sum() == 2
    assert {0.5, 3.0} <= set(changed)
    assert (growth_settings() == usual).all()


@pytest.mark.parametrize("path", ["ellipsoid/membership", "ellipsoid/selection", "cues/silhouette"])
def test_learned_weights_name_a_script_that_is_there_and_its_data(path):
    kept = json.loads((RECOVER / f"{path}_weights.json").read_text())
    assert (Path(__file__).parents[1] / kept["script"]).is_file()
    assert "seed" in kept["data"]


def test_weights_are_those_that_were_fitted():
    """The numbers with which the golden answers were made."""
    weights, offset = learned_weights()
    assert (len(weights), offset, weights["scatter of neighbours"]) == (9, 4.531, -1.323)
    assert [entry["weight"] for entry in learned_evidence().values()] == [0.470, -5.334, 3.960, -1.953, -1.358]
    assert list(silhouette_weights()["weights"].values()) == [1.85, -4.2, 0.52]
