"""Every pixel labelled by lights that were found together with the surface."""

import numpy as np
from synthesis import angles_deg, problem_of_colours
from test_recover_methods_initial import COLOURS, NOISE, TOWARD, seldom_all_lit

from huesphere.recover.every_pixel.by_joint_lights import label_by_joint_lights, lights_of
from huesphere.recover.lights.lit_surface import LitSurface


def test_a_pixel_in_the_cast_shadow_of_one_light_is_told_so():
    observation, normals, _, _ = seldom_all_lit()
    truth = LitSurface(TOWARD, COLOURS, COLOURS.T @ TOWARD, normals, 1.0, 0.0, np.zeros((9, 9)))
    cosine = normals @ TOWARD.T
    seen = cosine > 0
    shadow = np.zeros(observation.mask.shape, bool)
    shadow[44:50, 44:50] = True
    seen[shadow, 2] = False
    rgb = np.where(observation.mask[..., None], np.where(seen, cosine, 0.0) @ COLOURS, 0.0)
    labelled = label_by_joint_lights(problem_of_colours(rgb, observation.mask, NOISE), truth)
    assert labelled.explained[observation.mask].all()
    wanted = ~seen @ (1 << np.arange(len(TOWARD)))
    assert (labelled.missed[shadow] == wanted[shadow]).all()
    assert np.max(angles_deg(labelled.normals[shadow], normals[shadow])) < 0.1
    light = lights_of(truth, labelled).found[2]
    assert light.support == (~seen[..., 2] & observation.mask).sum()
    assert 0 < light.attached < 1


def test_a_pixel_that_no_lights_explain_keeps_the_normal_of_the_surface():
    observation, normals, _, _ = seldom_all_lit()
    turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, -0.6], [0.0, 0.6, 0.8]])
    turned = np.where(observation.mask[..., None], normals @ turn, np.nan)
    truth = LitSurface(TOWARD, COLOURS, COLOURS.T @ TOWARD, turned, 1.0, 0.0, np.zeros((9, 9)))
    rgb = np.where(observation.mask[..., None], np.maximum(normals @ TOWARD.T, 0) @ COLOURS, 0.0)
    painted = np.zeros(observation.mask.shape, bool)
    painted[40:60, 40:60] = True
    rgb[painted] *= [0.2, 1.0, 3.0]
    labelled = label_by_joint_lights(problem_of_colours(rgb, observation.mask, NOISE), truth)
    unexplained = painted & ~labelled.explained
    assert unexplained[painted].mean() > 0.9
    assert (labelled.normals[unexplained] == turned[unexplained]).all()
    assert labelled.interpolated[unexplained].all()
    assert np.isnan(labelled.normals[~observation.mask]).all()
