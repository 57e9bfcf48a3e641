"""When ``auto`` leaves the brightness free: where its own result is not to be trusted and a silhouette is there."""

from dataclasses import replace

import numpy as np
import pytest
from synthesis import angles_deg
from test_recover_uniform_hue import wavy

import huesphere.recover.trust.evidence as evidence_module
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.methods.calling import estimate_by
from huesphere.recover.methods.second_opinion import with_free_brightness
from huesphere.recover.methods.table import METHODS
from huesphere.recover.trust.evidence import evidence_or_none
from huesphere.recover.trust.hollow import hollowness
from huesphere.render.dataset import Observation


def failed(observation: Observation, status: str = "no-ellipsoid") -> Estimate:
    """An estimate without normals."""
    shape = observation.mask.shape
    nothing = np.zeros(shape, bool)
    normals, unknown = np.full((*shape, 3), np.nan, np.float32), np.full(shape, np.nan, np.float32)
    return Estimate("", status, "why", normals, nothing, nothing, unknown, steps=("first step",))


def test_auto_alone_has_a_second_opinion():
    assert [name for name, method in METHODS.items() if method.second_opinion] == ["auto"]


def test_where_there_are_no_normals_the_brightness_is_left_free_and_the_steps_say_why():
    observation, normals, _ = wavy()
    opinion = with_free_brightness(failed(observation), None, observation)
    assert opinion is not None
    found, evidence = opinion
    assert evidence == evidence_or_none(found, observation)
    assert found.steps == (
        "first step",
        "brightness: left free at every pixel (no-ellipsoid: no normals of uniform brightness)",
    )
    given = found.valid
    assert np.median(angles_deg(found.normals[given].astype(float), normals[given])) < 2


@pytest.mark.parametrize("status", ["ok", "rank-deficient-colours"])
def test_what_is_trusted_or_has_another_cause_stays(status):
    observation, _, _ = wavy()
    assert with_free_brightness(failed(observation, status), None, observation) is None


def test_without_a_silhouette_the_first_estimate_stays():
    observation, _, _ = wavy()
    middle = slice(16, 32)
    cut = Observation(observation.rgb[middle, middle], observation.mask[middle, middle])
    assert with_free_brightness(failed(cut), None, cut) is None


def test_of_a_patchy_dome_the_doubtful_estimate_of_uniform_brightness_is_replaced():
    observation, normals, _ = wavy()
    weak = METHODS["weak-integrability"].load()
    first = estimate_by("auto", weak, observation)
    found = estimate_by("auto", weak, observation, otherwise=with_free_brightness)
    assert first.verdict != "trust"
    assert found.verdict == "doubtful"
    assert found.albedo is not None
    errors = [
        np.median(angles_deg(one.normals[one.valid].astype(float), normals[one.valid])) if one.valid.any() else 90.0
        for one in (first, found)
    ]
    assert errors[1] < min(2.0, errors[0])


def test_the_evidence_for_an_estimate_is_collected_once(monkeypatch):
    observation, _, _ = wavy()
    collected = []

    def counted(*arguments):
        collected.append(arguments)
        return hollowness(*arguments)

    monkeypatch.setattr(evidence_module, "hollowness", counted)
    found = estimate_by("auto", METHODS["weak-integrability"].load(), observation, otherwise=with_free_brightness)
    assert found.albedo is not None, "the second opinion was taken, so there are two estimates"
    assert len(collected) == 2


def test_of_a_dome_of_one_brightness_the_estimate_stays():
    observation, normals, _ = wavy()
    F = np.array([[0.5, 0.1, 0.6], [-0.4, 0.3, 0.6], [0.0, -0.5, 0.6]])
    rgb = normals @ F.T + 5e-4 * np.random.default_rng(2).normal(size=normals.shape)
    even = replace(observation, rgb=np.where(observation.mask[..., None], rgb, 0).astype(np.float32))
    found = estimate_by(
        "auto", METHODS["weak-integrability"].load(), even, otherwise=with_free_brightness
    )  # trusted, or doubted for another reason
    assert found.albedo is None
