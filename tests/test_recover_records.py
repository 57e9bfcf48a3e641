"""Records that pass between stages: solutions that cannot disagree with themselves, and a reason for each pixel."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from synthesis import DIRECTIONS, angles_deg, dome, shade

from huesphere.recover.baselines.brill1991 import matrix_from_known_normals
from huesphere.recover.every_pixel.completion import CompletionSteps, complete
from huesphere.recover.geometry.root import symmetric_root
from huesphere.recover.geometry.rotations import TWIN
from huesphere.recover.io.estimate import read_estimate, write_estimate
from huesphere.recover.methods.table import METHODS
from huesphere.recover.pixels.usable import problem_of, usable_pixels
from huesphere.recover.reasons import REASONS, Reason, interpolated, shares
from huesphere.recover.run import recover_one
from huesphere.recover.solution import Convexity, Solution
from huesphere.render.dataset import Observation, write_observation

sys.path.insert(0, str(Path(__file__).parent / "golden"))
from estimates import estimate_of, pictures

COLOURS = np.array([(1, 0.2, 0.1), (0.1, 1, 0.2), (0.2, 0.1, 1), (0.8, 0.7, 0.1), (0.1, 0.6, 0.9)])
WITH_A_SOLUTION = ("linear", "direct", "noisy", "full-noisy", "perspective", "hollow")


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", WITH_A_SOLUTION)
def test_F_C_and_rotation_of_every_estimate_agree(name, method):
    found = estimate_of(name, method)
    if found.solution is None:
        assert not found.valid.any()
        return
    told = {key: np.array(found.diagnostics[key]) for key in ("F", "C", "rotation")}
    assert told["F"] == pytest.approx(found.solution.F, abs=0)
    identity = told["rotation"] @ symmetric_root(told["C"]) @ told["F"]
    assert np.abs(identity - np.eye(3)).max() < 1e-9
    assert np.abs(told["C"] @ told["F"] @ told["F"].T - np.eye(3)).max() < 1e-9
    assert np.abs(told["rotation"] @ told["rotation"].T - np.eye(3)).max() < 1e-9
    assert found.diagnostics["reflection"] == (np.linalg.det(told["F"]) < 0)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ["direct", "saturated", "near", "two-lights", "dome"])
def test_every_pixel_has_a_reason_and_it_fits_its_normal(name, method):
    picture, found = pictures()[name], estimate_of(name, method)
    reason = found.reason
    assert reason is not None
    assert ((reason == Reason.BACKGROUND) == ~picture.mask).all()
    assert ((reason >= Reason.OUTLIER) == (picture.mask & ~found.valid)).all()
    assert set(np.unique(reason).tolist()) <= {int(code) for code in REASONS}
    assert found.object_pixels == picture.mask.sum()
    assert sum(shares(reason).values()) == pytest.approx(1)
    if name == "saturated" and found.valid.any():
        clipped = (picture.rgb >= 1).any(axis=-1) & picture.mask
        assert np.isin(reason[clipped], (Reason.SATURATED, Reason.INTERPOLATED_SATURATED)).mean() > 0.9
    if found.missed is not None:
        assert ((found.missed > 0) == (reason == Reason.MISSES_LIGHTS)).all()


def test_colours_on_either_side_of_the_ellipsoid_are_told_apart():
    """A highlight is brighter than any matte pixel; a pixel in shadow is darker."""
    normals, mask = dome(72, bumps=0.1, elongation=1.15, cap=0.7)
    observation, _ = shade(normals, mask, COLOURS)
    rgb = observation.rgb.copy()
    rgb[30:33, 30:33] *= 1.6
    rgb[40:43, 40:43] *= 0.5
    found = recover_one(replace(observation, rgb=rgb), "drew-kontsevich")
    assert (found.reason[30:33, 30:33] == Reason.OUTLIER_BRIGHT).all()
    assert (found.reason[40:43, 40:43] == Reason.OUTLIER).all()


def test_names_of_reasons_are_unique_and_codes_are_those_of_the_table():
    assert set(REASONS) == set(Reason)
    names = [name for name, _ in REASONS.values()]
    assert len(set(names)) == len(names)
    lost = np.array([[0, Reason.DARK, Reason.SATURATED, Reason.NOT_FINITE]])
    told = [Reason(code).name for code in interpolated(lost)[0]]
    assert told == ["INTERPOLATED", "INTERPOLATED_DARK", "INTERPOLATED_SATURATED", "INTERPOLATED_NOT_FINITE"]


@pytest.mark.parametrize(
    ("name", "method"), [("wide", "knit"), ("perspective", "weak-integrability"), ("near", "auto")]
)
def test_an_estimate_comes_back_from_disk_as_it_was(tmp_path, name, method):
    made = estimate_of(name, method)
    write_observation(tmp_path / "observation.exr", pictures()[name])
    write_estimate(tmp_path / "estimates", made, tmp_path / "observation.exr")
    read, _ = read_estimate(tmp_path / "estimates", method)
    for field in ("normals", "valid", "inlier", "reason", "missed"):
        a, b = getattr(made, field), getattr(read, field)
        assert (a is None) == (b is None)
        assert a is None or np.array_equal(a, b, equal_nan=field == "normals"), field
    assert (read.status, read.steps) == (made.status, made.steps)
    if made.solution is not None:
        assert pytest.approx(made.solution.F, rel=1e-15) == read.solution.F
        assert read.solution.convexity.turn == pytest.approx(made.solution.convexity.turn)
        assert read.rotation_stderr_deg == pytest.approx(made.rotation_stderr_deg)
    if made.lights is not None:
        assert [light.support for light in read.lights.found] == [light.support for light in made.lights.found]
    record = json.loads((tmp_path / f"estimates/{method}.json").read_text())
    assert {entry["name"] for entry in record["reasons"].values()} == {name for name, _ in REASONS.values()}


def test_the_other_solution_of_the_other_is_the_first():
    F = np.array([[1.0, 0.1, 0.2], [0.0, 0.8, -0.1], [0.3, 0.2, 0.9]])
    turn = TWIN @ np.array([[np.cos(0.1), 0, np.sin(0.1)], [0, 1, 0], [-np.sin(0.1), 0, np.cos(0.1)]])
    one = Solution(F, np.ones((2, 2), bool), 1e-3, np.diag([1.0, 2.0, 3.0]), convexity=Convexity(turn=turn))
    back = one.other(0.5, "a").other(0.2, "b")
    assert pytest.approx(F) == back.F
    assert back.rotation_covariance == pytest.approx(one.rotation_covariance)
    assert (back.convexity.flipped, back.convexity.evidence, back.convexity.margin) == (False, "b", 0.2)
    assert pytest.approx(one.C) == one.other(0.5, "a").C
    normals = np.array([0.6, 0.0, 0.8])
    assert one.other(0.5, "a").F @ (turn @ normals) == pytest.approx(F @ normals)


def test_a_calibrated_matrix_enters_completion_like_any_other_solution():
    """Brill's three known normals give F; every pixel follows, those that miss a light among them."""
    normals, mask = dome(96, bumps=0.1, elongation=1.15, cap=0.9)
    toward = DIRECTIONS * [2.0, 2.0, 1.0]
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    observation, F = shade(normals, mask, COLOURS, directions=toward)
    lit = (normals @ toward.T > 0.02).all(axis=-1) & mask
    rows, columns = np.nonzero(lit)
    target = [0, len(rows) // 3, 2 * len(rows) // 3, len(rows) - 1]
    known = normals[rows[target], columns[target]]
    calibrated = matrix_from_known_normals(observation.rgb[rows[target], columns[target]].astype(float), known)
    assert calibrated == pytest.approx(F, rel=1e-3, abs=1e-4)
    solution = Solution(
        calibrated, lit, 1e-5, 1e-8 * np.eye(3), convexity=Convexity(margin=1.0, evidence="calibration")
    )
    found = complete(problem_of(usable_pixels(observation), observation, solution.noise), solution, CompletionSteps())
    assert (found.reason[mask] > 0).all()
    assert (found.reason == Reason.MISSES_LIGHTS).sum() > 0.1 * mask.sum()
    error = angles_deg(found.normals[mask], normals[mask])
    assert np.median(error) < 0.01
    assert np.quantile(error, 0.9) < 0.5
    assert len(found.lights.found) == 5
    assert found.solution.convexity.evidence == "calibration"


def test_an_estimate_is_short_in_words():
    found = estimate_of("direct", "weak-integrability")
    assert repr(found).startswith("Estimate(weak-integrability, ok: normals of ")
    empty = recover_one(Observation(np.zeros((8, 8, 3), np.float32), np.ones((8, 8), bool)), "auto")
    assert "normals of 0% of 64 pixels" in repr(empty)
