"""The methods that the report proposes or compares with, from picture to normals."""

from dataclasses import replace

import numpy as np
import pytest
from synthesis import aligned_error, dome, light_colours, median_error, shade

from huesphere.recover.methods.table import METHODS
from huesphere.render.dataset import Observation

SCENE = dome(96, elongation=1.2, bumps=0.2)
NAMES = ("drew-kontsevich-ambient", "alternation", "kontsevich-1994", "kontsevich-1994-growing")


@pytest.mark.parametrize("name", ["alternation", "kontsevich-1994", "kontsevich-1994-growing"])
def test_the_rotation_is_found_where_the_closed_form_misses_it(name):
    normals, mask = SCENE
    estimate = METHODS[name](shade(normals, mask, light_colours("gels"))[0])
    assert estimate.status == "ok"
    assert median_error(estimate, normals) < 0.5
    assert np.nanmedian(estimate.uncertainty_deg) < 1


def test_the_ambient_term_restores_normals_that_ambient_light_bends():
    normals, mask = SCENE
    observation, _ = shade(normals, mask, light_colours("gels"))
    lifted = replace(observation, rgb=np.where(mask[..., None], observation.rgb + np.float32(0.08), 0))
    plain, ambient = (METHODS[name](lifted) for name in ("drew-kontsevich", "drew-kontsevich-ambient"))
    assert aligned_error(plain, normals) > 1
    assert aligned_error(ambient, normals) < 0.01
    assert ambient.diagnostics["ambient"]["colour"] == pytest.approx([0.08] * 3, abs=1e-3)


@pytest.mark.parametrize("name", NAMES)
def test_grey_light_is_a_named_failure(name):
    normals, mask = SCENE
    grey = np.ones((5, 3)) * np.linspace(0.5, 1, 5)[:, None]
    observation, _ = shade(normals, mask, grey, noise=1e-3)
    estimate = METHODS[name](observation)
    assert estimate.status == "rank-deficient-colours"
    assert not estimate.valid.any()


@pytest.mark.parametrize("name", NAMES)
def test_an_empty_picture_is_a_named_failure(name):
    empty = Observation(np.zeros((20, 20, 3), np.float32), np.zeros((20, 20), bool))
    assert METHODS[name](empty).status == "too-few-pixels"
