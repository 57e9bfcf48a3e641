"""Every pixel's uncertainty: noise by the matrix of the lights that the pixel sees, and the rotation common to all."""

from dataclasses import replace

import numpy as np
import pytest
from synthesis import angles_deg, dome, problem_of_colours, shade, solution_of
from test_recover_every_pixel_by_irradiance_map import without_lights

from huesphere.recover.every_pixel import completion
from huesphere.recover.every_pixel.by_irradiance_map import map_error_deg
from huesphere.recover.every_pixel.by_light_sets import label_by_light_sets
from huesphere.recover.every_pixel.completion import CompletionSteps, complete
from huesphere.recover.every_pixel.parameters import EVERY_PIXEL
from huesphere.recover.lights.model import Light, Lights
from huesphere.recover.problem import Problem
from huesphere.recover.reasons import Reason
from huesphere.recover.solution import Solution

NOISE = 2e-3
TOWARD = np.array([[0.6, 0.2, 1.0], [-0.5, 0.4, 1.0], [0.0, -0.6, 1.0]])
TOWARD /= np.linalg.norm(TOWARD, axis=1, keepdims=True)
COLOURS = np.array([[1.0, 0.2, 0.15], [0.15, 1.0, 0.25], [0.2, 0.15, 1.0]])


def completed(turn_deg: float, *, noise: float = NOISE, missed: bool = False):
    """(completion, normals, mask, a patch) of a shallow dome that sees every light; no light is known by itself.

    In the patch, if ``missed``, something hides the third light.
    """
    normals, mask = dome(64, cap=0.5)
    patch = np.zeros(mask.shape, bool)
    patch[24:34, 24:34] = True
    hidden = np.zeros((*mask.shape, 3), bool)
    hidden[patch, 2] = missed
    observation, F = shade(normals, mask, COLOURS, directions=TOWARD, hidden=hidden, noise=noise)
    problem = problem_of_colours(observation.rgb, mask, noise)
    solution = solution_of(F, mask & ~patch if missed else mask, turn_deg)
    return complete(problem, solution, CompletionSteps(search=False)), normals, mask, patch


def test_the_rotations_error_is_in_every_pixels_uncertainty():
    """It is common to all pixels and independent of their noise: squares add."""
    turn = 2.0
    (without, _, mask, _), (with_turn, *_) = completed(0.0), completed(turn)
    added = np.sqrt(with_turn.uncertainty_deg[mask] ** 2 - without.uncertainty_deg[mask] ** 2)
    np.testing.assert_allclose(added, with_turn.solution.rotation_stderr_deg, rtol=1e-6)
    assert with_turn.solution.rotation_stderr_deg == pytest.approx(np.sqrt(3) * turn)


def test_without_an_error_of_the_rotation_the_uncertainty_is_that_of_noise():
    found, normals, mask, _ = completed(0.0)
    assert (found.reason[mask] == Reason.ALL_LIT).all()
    error = angles_deg(found.normals[mask], normals[mask]).mean()
    assert 1.0 < found.uncertainty_deg[mask].mean() / error < 1.6  # residuals count besides noise: rather too careful


def test_twice_the_noise_is_twice_the_uncertainty():
    once, twice = (completed(0.0, noise=noise) for noise in (NOISE, 2 * NOISE))
    mask = once[2]
    assert np.median(twice[0].uncertainty_deg[mask] / once[0].uncertainty_deg[mask]) == pytest.approx(2.0, rel=0.05)


def test_a_pixel_that_nothing_explains_has_the_error_of_interpolation():
    found, _, mask, patch = completed(0.0, missed=True)
    inner = np.zeros_like(patch)
    inner[26:32, 26:32] = True
    assert (found.uncertainty_deg[inner] == EVERY_PIXEL.interpolated_error_deg).all()
    assert found.uncertainty_deg[mask & ~patch].max() < 3.0
    assert np.isnan(found.uncertainty_deg[~mask]).all()


def test_no_uncertainty_exceeds_that_of_interpolation():
    found, _, mask, _ = completed(40.0)
    assert (found.uncertainty_deg[mask] == EVERY_PIXEL.interpolated_error_deg).all()


def test_the_uncertainty_is_that_of_noise_too_where_lights_have_nearly_one_colour():
    """Errors along and across the direction in which colours change little are tens of times apart, and correlated."""
    grey = 0.75 * COLOURS.mean(axis=0) + 0.25 * COLOURS
    normals, mask = dome(64, cap=0.5)
    observation, F = shade(normals, mask, grey, directions=TOWARD, noise=2e-4)
    assert np.linalg.cond(F) > 15
    found = complete(
        problem_of_colours(observation.rgb, mask, 2e-4), solution_of(F, mask, 0.0), CompletionSteps(search=False)
    )
    error = angles_deg(found.normals[mask], normals[mask]).mean()
    assert 1.0 < found.uncertainty_deg[mask].mean() / error < 1.6


def test_shares_count_the_pixels_by_how_their_normals_were_found():
    found, _, mask, patch = completed(0.0, missed=True)
    count = mask.sum()
    assert found.shares["all_lit"] == pytest.approx((found.reason[mask] == Reason.ALL_LIT).sum() / count)
    assert found.shares["missing_lights"] == 0.0
    assert found.shares["mapped"] == 0.0
    assert found.shares["between"] == pytest.approx(1 - found.shares["all_lit"])
    assert found.shares["between"] > 0.8 * patch.sum() / count


def test_a_pixel_of_the_irradiance_map_has_the_maps_error_and_the_rotations():
    problem, solution, _, _ = without_lights()
    solution = replace(solution, rotation_covariance=np.radians(2.0) ** 2 * np.eye(3))
    found = complete(problem, solution, CompletionSteps(search=False, smooth=True))
    mapped = found.reason == Reason.IRRADIANCE_MAP
    assert mapped.sum() > 0.2 * problem.mask.sum()
    of_map = map_error_deg(float(solution.inlier.sum() / problem.mask.sum()))
    wanted = np.hypot(of_map, solution.rotation_stderr_deg)
    assert of_map < wanted < EVERY_PIXEL.interpolated_error_deg
    np.testing.assert_allclose(found.uncertainty_deg[mapped], wanted, rtol=1e-9)
    assert found.shares["mapped"] == pytest.approx(mapped.sum() / problem.mask.sum())
    assert found.notes["irradiance"]["explained"] == found.map_explains


@pytest.mark.parametrize(
    ("noise", "all_lit_share", "asked"), [(1e-3, 0.5, True), (1e-3, 0.9, False), (1e-5, 0.5, False)]
)
def test_lights_are_estimated_jointly_where_noise_hides_them_from_much_of_the_object(
    noise, all_lit_share, asked, monkeypatch
):
    normals, mask = dome(48, cap=0.5)
    observation, F = shade(normals, mask, COLOURS, directions=TOWARD, noise=noise)
    problem = problem_of_colours(observation.rgb, mask, noise)
    inlier = mask & (np.arange(48) < np.quantile(np.nonzero(mask)[1], all_lit_share))
    given = []

    def not_found(problem, solution):
        given.append(np.sqrt(np.diag(solution.rotation_covariance)))
        return None, {}

    monkeypatch.setattr(completion, "estimate_jointly", not_found)
    complete(problem, solution_of(F, inlier, 3.0), CompletionSteps(search=False, lights_jointly=True))
    assert bool(given) == asked
    if asked:  # of the rotation's covariance only its size is known well
        np.testing.assert_allclose(given[0], np.radians(3.0), rtol=1e-9)


def jointly(noise: float, *, missed: bool = False):
    """(completion without and with the joint fit, normals, mask) of a dome under lights of nearly one colour."""
    normals, mask = dome(64, cap=0.75, bumps=0.05)
    patch = np.zeros((*mask.shape, 3), bool)
    patch[24:34, 24:34, 2] = missed
    grey = 0.7 * COLOURS.mean(axis=0) + 0.3 * COLOURS
    observation, F = shade(normals, mask, grey, directions=TOWARD, hidden=patch, noise=noise)
    problem = problem_of_colours(observation.rgb, mask, noise)
    solution = solution_of(F, mask & ~patch.any(axis=-1), 0.0)
    return (
        *(complete(problem, solution, CompletionSteps(search=False, joint=joint)) for joint in (False, True)),
        normals,
        mask,
    )


def test_the_joint_fit_has_a_smaller_error_and_states_it():
    single, joint, normals, mask = jointly(2e-3)
    assert joint.joint.used
    assert joint.joint.misfit == pytest.approx(1.0, abs=0.3)
    assert joint.joint.share == 1.0
    before, after = (angles_deg(one.normals[mask], normals[mask]).mean() for one in (single, joint))
    assert after < 0.8 * before
    assert 0.8 < joint.uncertainty_deg[mask].mean() / after < 1.4
    assert 0 < np.linalg.norm(joint.solution.F - single.solution.F) < 0.02 * np.linalg.norm(single.solution.F)
    assert np.array_equal(joint.solution.inlier, single.solution.inlier)


def test_the_joint_fit_leaves_interpolated_pixels_their_error():
    single, joint, _, mask = jointly(2e-3, missed=True)
    between = mask & (single.missed == 0) & (single.reason != Reason.ALL_LIT)
    inner = np.zeros_like(mask)
    inner[26:32, 26:32] = True
    assert joint.joint.used
    assert between[inner].all()
    assert joint.uncertainty_deg[inner].min() >= EVERY_PIXEL.interpolated_error_deg
    assert np.median(joint.uncertainty_deg[mask & ~between]) < 2.0


def test_without_noise_to_speak_of_there_is_no_joint_fit():
    _, joint, _, _ = jointly(1e-6)
    assert joint.joint is None


def test_where_lights_were_estimated_with_the_surface_their_rotation_is_in_every_pixels_uncertainty():
    """The joint fit holds the lights, so that its own covariance does not say how far all of them may be turned."""
    normals, mask = dome(64, cap=0.75, bumps=0.05)
    observation, F = shade(normals, mask, COLOURS, directions=TOWARD, noise=2e-3)
    problem, solution = problem_of_colours(observation.rgb, mask, 2e-3), solution_of(F, mask, 1.5)
    start = np.where(mask[..., None], normals, np.nan)
    labelled = label_by_light_sets(problem, start, F, completion.NONE_FOUND)
    found = complete(problem, solution, CompletionSteps(search=False))
    alone = completion._with_joint_fit(found, problem, labelled)
    besides = completion._with_joint_fit(replace(found, lights_estimated_jointly=True), problem, labelled)
    assert alone.joint.used
    added = np.sqrt(besides.uncertainty_deg[mask] ** 2 - alone.uncertainty_deg[mask] ** 2)
    np.testing.assert_allclose(added, solution.rotation_stderr_deg, rtol=1e-6)


# ---- a second search for lights --------------------------------------------------------------------------------------


TRUE, FALSE = TOWARD[2], np.array([0.0, 0.6, 0.8])  # directions of the light that the patch misses, and of another
NONE = Lights((), 1.0)


def third(missing: float, direction: np.ndarray = TRUE) -> Lights:
    """The third light alone, from that direction, of colour COLOURS[2]."""
    return Lights((Light(direction, COLOURS[2], 400, 1.0, 0.0),), missing)


def searched(monkeypatch, first: Lights, second: Lights, *, removed: float = 0.0):
    """(which one the completion takes, noise over the picture's of each search) where searches find these lights.

    In a patch something hides the third light. ``removed``: indirect light that was subtracted from all pixels.
    """
    normals, mask = dome(64, cap=0.5)
    patch = np.zeros((*mask.shape, 3), bool)
    patch[20:40, 20:40, 2] = True
    observation, F = shade(normals, mask, COLOURS, directions=TOWARD, hidden=patch, noise=1e-6)
    exposure = F[0, 0] / (COLOURS.T @ TOWARD)[0, 0]
    problem = problem_of_colours(observation.rgb / exposure, mask, 1e-6)
    problem = replace(problem, removed=np.where(mask[..., None], removed, 0.0) * np.ones(3))
    asked = []

    def found(searched: Problem, solution: Solution, supposed: tuple[Light, ...] = ()) -> Lights:
        asked.append(searched.noise / problem.noise)
        return first if len(asked) == 1 else second

    monkeypatch.setattr(completion, "find_lights", found)
    solution = solution_of(F / exposure, mask & ~patch.any(axis=-1))
    taken = complete(problem, solution, CompletionSteps()).lights
    return "first" if taken is first else "second" if taken is second else taken, asked


def test_where_indirect_light_was_removed_and_no_light_is_found_a_search_allows_for_more_noise(monkeypatch):
    taken, asked = searched(monkeypatch, NONE, third(0.6), removed=0.01)
    assert asked == [1.0, EVERY_PIXEL.shadow_noise_factor]
    assert taken == "second"


def test_lights_of_the_second_search_that_explain_no_more_are_not_taken(monkeypatch):
    """Though they add up to F: false lights may."""
    assert searched(monkeypatch, NONE, third(0.0, FALSE), removed=0.01)[0] == "first"


def test_lights_of_the_second_search_that_leave_more_light_missing_are_not_taken(monkeypatch):
    assert searched(monkeypatch, third(0.5, FALSE), third(0.6), removed=0.01)[0] == "first"


@pytest.mark.parametrize(
    ("first", "removed"),
    [(NONE, 0.0), (third(0.01), 0.01), (third(0.6), 0.01)],
    ids=["no indirect light", "all lights found", "the object explained"],
)
def test_otherwise_there_is_one_search(first, removed, monkeypatch):
    assert searched(monkeypatch, first, third(0.0), removed=removed) == ("first", [1.0])
