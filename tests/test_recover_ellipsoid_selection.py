"""Which of the leading candidates is taken, once each is refitted as if it were the only one."""

import numpy as np
import pytest
from synthesis import dome, shade
from test_recover_ellipsoid_candidates import COLOURS, WIDE, problem_of

from huesphere.recover.cues.silhouette import silhouette_of
from huesphere.recover.ellipsoid.candidates import Candidate
from huesphere.recover.ellipsoid.selection import (
    CONTENDER_SCORE_RATIO,
    Grid,
    learned_evidence,
    most_likely_first,
    refit_candidate,
    refit_contenders,
)
from huesphere.recover.status import RecoveryFailure

NOISE = 3e-3


@pytest.fixture(scope="module")
def scene():
    """(rgb, mask, all-lit candidate, that of the pixels that miss just one light): a bumpy dome, four wide lights."""
    normals, mask = dome(112, elongation=1.1, bumps=0.5, cap=0.95)
    observation, F = shade(normals, mask, COLOURS, directions=WIDE, noise=NOISE)
    rgb = observation.rgb.astype(float)
    lit = normals @ WIDE.T > 0
    exposure = np.linalg.norm(F) / np.linalg.norm(COLOURS.T @ WIDE)
    few = [0, 1, 3]
    missing = exposure * COLOURS[few].T @ WIDE[few]
    all_lit = candidate_of(mask, lit.all(axis=-1) & mask, F)
    return rgb, mask, all_lit, candidate_of(mask, lit[..., few].all(axis=-1) & ~lit[..., 2] & mask, missing)


def candidate_of(mask: np.ndarray, inlier: np.ndarray, F: np.ndarray) -> Candidate:
    C = np.linalg.inv(F @ F.T)
    return Candidate(C, inlier, float(inlier.sum() / mask.sum()), 0.5)


def grid(rgb: np.ndarray, mask: np.ndarray, noise: float = NOISE) -> Grid:
    return Grid(problem_of(rgb, mask, noise), 0.0, silhouette_of(mask, mask))


def scoring(one: Candidate, score: float) -> Candidate:
    return Candidate(one.C, one.inlier, one.support, score / one.support)


def test_the_all_lit_ellipsoid_is_taken_though_another_scores_more(scene):
    rgb, mask, all_lit, other = scene
    candidates = [scoring(other, 0.2), scoring(all_lit, 0.1)]
    ordered, own = most_likely_first(grid(rgb, mask), candidates)
    assert [one.C is two.C for one, two in zip(ordered, candidates[::-1])] == [True, True]
    assert np.linalg.norm(own.fit.C - all_lit.C) < 0.05 * np.linalg.norm(all_lit.C)
    assert own.classified
    assert own.probability > 0.7


def test_one_that_scores_far_less_is_not_looked_at(scene):
    rgb, mask, all_lit, other = scene
    candidates = [scoring(other, 0.2), scoring(all_lit, 0.19 / CONTENDER_SCORE_RATIO)]
    ordered, _ = most_likely_first(grid(rgb, mask), candidates)
    assert ordered[0].C is other.C


def test_a_candidate_of_which_refitting_leaves_nothing_keeps_the_pixels_it_had(scene):
    rgb, mask, all_lit, _ = scene
    strange = 0.2 * all_lit.C
    with pytest.raises(RecoveryFailure, match="no-dominant-shell"):
        refit_candidate(problem_of(rgb, mask, NOISE), strange, 0.0)
    kept = refit_candidate(problem_of(rgb, mask, NOISE), strange, 0.0, all_lit.inlier)
    assert np.linalg.norm(kept.fit.C - all_lit.C) < 0.05 * np.linalg.norm(all_lit.C)


def test_where_nothing_becomes_of_any_the_order_stays(scene):
    rgb, mask, all_lit, _ = scene
    nowhere = Candidate(0.2 * all_lit.C, np.zeros_like(mask), 0.1, 0.5)
    assert most_likely_first(grid(rgb, mask), [nowhere]) == ([nowhere], None)
    assert most_likely_first(grid(rgb, mask), [nowhere, nowhere]) == ([nowhere, nowhere], None)


def test_evidence_is_what_is_named_and_does_not_depend_on_exposure(scene):
    rgb, mask, all_lit, _ = scene
    (seen,) = refit_contenders(grid(rgb, mask), [all_lit])
    assert seen.evidence.shape == (len(learned_evidence()),)
    assert np.isfinite(seen.evidence).all()
    brighter = Candidate(all_lit.C / 49, all_lit.inlier, all_lit.support, all_lit.credit)
    (other,) = refit_contenders(grid(7 * rgb, mask, 7 * NOISE), [brighter])
    assert np.allclose(other.evidence, seen.evidence, rtol=1e-6, atol=1e-6)


def test_a_picture_without_noise_leaves_evidence_finite(scene):
    _, mask, all_lit, _ = scene
    normals, _ = dome(112, elongation=1.1, bumps=0.5, cap=0.95)
    clean, F = shade(normals, mask, COLOURS, directions=WIDE)
    one = candidate_of(mask, all_lit.inlier, F)
    (seen,) = refit_contenders(grid(clean.rgb.astype(float), mask, 1e-5), [one])
    assert np.isfinite(seen.evidence).all()


def test_without_a_silhouette_only_what_is_known_is_weighed(scene):
    """The curl of a rotation that is free says little: few pixels have a small one."""
    rgb, mask, all_lit, other = scene
    both = refit_contenders(Grid(problem_of(rgb, mask, NOISE), 0.0, None), [all_lit, other])
    (seen,) = refit_contenders(grid(rgb, mask), [all_lit])
    assert np.array_equal(both[0].evidence[:3], seen.evidence[:3])
    assert np.array_equal(both[0].evidence[3:], both[1].evidence[3:])
