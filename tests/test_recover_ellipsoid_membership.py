"""Which pixels on an ellipsoid see every light: by alike normals and by neighbours, better than by a cut."""

import numpy as np
import pytest
from synthesis import dome, shade
from test_recover_ellipsoid_candidates import COLOURS, WIDE, problem_of

from huesphere.recover.ellipsoid.candidates import refine
from huesphere.recover.ellipsoid.distance import signed_distance
from huesphere.recover.ellipsoid.membership import LIKELY, Membership, learned_weights
from huesphere.recover.ellipsoid.parameters import ELLIPSOID

NOISE = 3e-3


@pytest.fixture(scope="module")
def scene():
    """(rgb, mask, inliers by a cut, true C, all-lit): a bumpy dome, four lights 63–65° off axis."""
    normals, mask = dome(128, elongation=1.1, bumps=0.8, cap=0.95)
    observation, F = shade(normals, mask, COLOURS, directions=WIDE, noise=NOISE)
    rgb, C = observation.rgb.astype(float), np.linalg.inv(F @ F.T)
    _, inlier = refine(problem_of(rgb, mask, NOISE), C)
    return rgb, mask, inlier, C, (normals @ WIDE.T > 0).all(axis=-1) & mask


def test_fewer_outliers_are_taken_and_no_fewer_all_lit_pixels(scene):
    rgb, mask, inlier, C, all_lit = scene
    likely = Membership(rgb, mask, C, noise=NOISE).probability(inlier) > LIKELY
    assert (inlier & ~all_lit).sum() / inlier.sum() > 0.15
    assert (likely & ~all_lit).sum() / likely.sum() < 0.85 * (inlier & ~all_lit).sum() / inlier.sum()
    assert (likely & all_lit).sum() >= (inlier & all_lit).sum()


def test_the_likelier_a_pixel_the_more_often_it_is_so(scene):
    rgb, mask, inlier, C, all_lit = scene
    likely = Membership(rgb, mask, C, noise=NOISE).probability(inlier)
    groups = [(likely > low) & (likely < high) for low, high in ((0.0, 0.2), (0.2, 0.5), (0.5, 0.8), (0.8, 1.0))]
    assert all(some.sum() > 100 for some in groups)
    share = [all_lit[some].mean() for some in groups]
    assert share == sorted(share)
    assert share[0] < 0.2
    assert share[-1] > 0.8


def test_off_the_ellipsoid_and_the_object_the_probability_is_zero(scene):
    rgb, mask, inlier, C, _ = scene
    likely = Membership(rgb, mask, C, noise=NOISE).probability(inlier)
    assert not likely[~mask].any()
    far = mask.copy()
    far[mask] = np.abs(signed_distance(rgb[mask], C)) > ELLIPSOID.single_distance_cut * NOISE
    assert far.any()
    assert not likely[far].any()


def test_exposure_and_channel_order_do_not_matter(scene):
    rgb, mask, inlier, C, _ = scene
    likely = Membership(rgb, mask, C, noise=NOISE).probability(inlier)
    order = [2, 0, 1]
    other = Membership(7 * rgb[..., order], mask, C[np.ix_(order, order)] / 49, noise=7 * NOISE).probability(inlier)
    # Which of the fixed directions a normal is nearest to turns with the channels: so near as the angle between them.
    assert np.abs(other - likely).mean() < 0.02
    brighter = Membership(7 * rgb, mask, C / 49, noise=7 * NOISE).probability(inlier)
    assert np.allclose(brighter, likely, atol=1e-6)


def test_evidence_is_finite_and_as_much_as_is_named(scene):
    rgb, mask, inlier, C, _ = scene
    membership = Membership(rgb, mask, C, noise=NOISE)
    seen = membership.evidence(inlier)
    assert seen.shape == (membership.on.sum(), len(learned_weights()[0]))
    assert np.isfinite(seen).all()
