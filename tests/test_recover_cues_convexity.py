"""Convex or concave: by the perspective where it is clear, else by the silhouette, else undetermined."""

import numpy as np
import pytest
from synthesis import TWIN, dome

from huesphere.recover.cues.convexity import choose_twin
from huesphere.recover.cues.parameters import CUES


@pytest.mark.parametrize("bumps", [0.0, 0.3])
def test_a_solid_is_kept_and_its_twin_is_flipped(bumps):
    normals, mask = dome(96, elongation=1.3, bumps=bumps)
    kept, flipped = (choose_twin(n, mask, mask) for n in (normals, normals @ TWIN))
    assert (kept.flipped, flipped.flipped) == (False, True)
    assert kept.margin == pytest.approx(flipped.margin)
    assert kept.margin > 0.5
    assert kept.evidence == "silhouette"


def test_pixels_far_from_the_border_tell_too_but_less_clearly():
    normals, mask = dome(96, bumps=0.3)
    row, column = np.mgrid[:96, :96]
    middle = (row - 47.5) ** 2 + (column - 47.5) ** 2 < 30**2
    found = choose_twin(normals, middle & mask, mask)
    assert not found.flipped
    assert 0.1 < found.margin < choose_twin(normals, mask, mask).margin


def test_normals_that_point_out_as_often_as_in_have_no_margin():
    mask = dome(96)[1]
    normals = np.zeros((96, 96, 3))
    normals[..., 0], normals[..., 2] = 0.6, 0.8  # a plane: out on one side, in on the other
    assert choose_twin(normals, mask, mask).margin < 0.05


def test_a_clear_perspective_decides_before_the_silhouette():
    normals, mask = dome(64)
    found = choose_twin(normals @ TWIN, mask, mask, ratio=2.0)
    assert (found.flipped, found.margin, found.evidence) == (False, 0.5, "perspective")
    below = choose_twin(normals @ TWIN, mask, mask, ratio=CUES.perspective_ratio)
    assert (below.flipped, below.evidence) == (True, "silhouette")


def test_where_the_picture_shows_no_silhouette_a_bump_is_taken_before_a_dent():
    normals, _ = dome(64, cap=0.5)
    middle = np.s_[16:48, 16:48]
    everywhere = np.ones((32, 32), bool)
    for n, flipped in ((normals[middle], False), (normals[middle] @ TWIN, True)):
        found = choose_twin(n, everywhere, everywhere)
        assert (found.flipped, found.margin, found.evidence) == (flipped, 0.0, "none: taken as convex")
