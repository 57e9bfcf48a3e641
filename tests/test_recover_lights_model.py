"""What a light is, and the matrix of the pixels that miss some."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_recover_lights_from_shadows import COLOURS, TOWARD, F

from huesphere.recover.lights.model import Light, Lights, numbered, tolerance, without
from huesphere.recover.lights.parameters import LIGHTS
from huesphere.recover.parameters import overridden

TRUTH = tuple(Light(a, b, 100, 0.0, 1.0) for a, b in zip(TOWARD, COLOURS))


def test_a_light_that_is_missed_leaves_the_matrix_of_the_others():
    assert np.allclose(without(F, TRUTH, (0, 2)), COLOURS[[1, 3]].T @ TOWARD[[1, 3]])
    assert np.allclose(without(F, TRUTH, ()), F)
    assert np.allclose(without(F, TRUTH, (0, 1, 2, 3)), 0)


@settings(deadline=None)
@given(st.sets(st.integers(0, 12)))
def test_numbers_and_bits_of_missed_lights_are_one(lights):
    assert numbered(sum(1 << j for j in lights)) == tuple(sorted(lights))


def test_the_tolerance_is_that_of_noise_but_never_below_that_of_rounding():
    assert tolerance(1.0, 1e-3) == pytest.approx(3e-3)
    assert tolerance(2.0, 0.0) == pytest.approx(1e-4)
    with overridden(LIGHTS, outlier_deviations=2.0):
        assert tolerance(1.0, 1e-3) == pytest.approx(2e-3)


@pytest.mark.parametrize(("missing", "complete"), [(0.0, True), (0.029, True), (0.031, False), (1.0, False)])
def test_lights_are_complete_that_add_up_to_F(missing, complete):
    assert Lights(TRUTH, missing).complete == complete
