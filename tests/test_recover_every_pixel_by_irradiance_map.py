"""Pixels that no light found explains, by a smooth map from normal to colour."""

import numpy as np
import pytest
from synthesis import angles_deg, dome, problem_of_colours, shade, solution_of
from test_recover_methods_initial import COLOURS, NOISE, TOWARD, seldom_all_lit

from huesphere.recover.every_pixel.by_irradiance_map import map_error_deg, with_irradiance_map
from huesphere.recover.every_pixel.by_light_sets import label_by_light_sets
from huesphere.recover.every_pixel.parameters import EVERY_PIXEL
from huesphere.recover.lights.model import Lights
from huesphere.recover.parameters import overridden

NONE_FOUND = Lights((), 1.0)


def without_lights(painted=None):
    """(problem, solution, labels, normals) of a dome of which few pixels see all lights; no light is known.

    Pixels that are ``painted`` have a colour that no light explains.
    """
    observation, normals, all_lit, F = seldom_all_lit()
    rgb = observation.rgb.astype(np.float64)
    if painted is not None:
        rgb[painted] *= [0.3, 1.0, 2.0]
        all_lit = all_lit & ~painted
    problem = problem_of_colours(rgb, observation.mask, NOISE)
    start = np.where(all_lit[..., None], normals, np.nan)
    return problem, solution_of(F, all_lit), label_by_light_sets(problem, start, F, NONE_FOUND), normals


def test_a_map_of_the_normal_is_nearer_than_the_interpolated_surface():
    """From the true F and the pixels that see every light, no light known by itself."""
    problem, solution, labelled, normals = without_lights()
    mapped, diagnostics = with_irradiance_map(labelled, problem, solution)
    where = mapped.mapped
    before, after = (angles_deg(one.normals[where], normals[where]).mean() for one in (labelled, mapped))
    assert where.sum() > 0.2 * problem.mask.sum()
    assert not (where & (mapped.explained | mapped.interpolated)).any()
    assert after < 0.7 * before
    assert diagnostics["explained"] > 0.75
    same = problem.mask & ~where & ~mapped.interpolated
    assert (mapped.normals[same] == labelled.normals[same]).all()
    assert (mapped.missed[where] == -1).all()


def test_the_map_gives_no_normals_beyond_what_it_explains_where_indirect_light_was_removed():
    painted = np.zeros((96, 96), bool)
    painted[60:66, 60:66] = True
    problem, solution, labelled, _ = without_lights(painted)
    removed = np.where(problem.mask[..., None], 1e-3, 0.0) * np.ones(3)
    direct = type(problem)(**{**vars(problem), "removed": removed})
    with overridden(EVERY_PIXEL, most_explained_by_map=0.2):
        plain, allowing = (with_irradiance_map(labelled, one, solution)[0] for one in (problem, direct))
    assert (allowing.mapped == plain.mapped).all()
    rest = problem.mask & (plain.normals != allowing.normals).any(axis=-1)
    assert rest.any()
    assert plain.interpolated[rest].all()
    assert (allowing.normals[rest] == labelled.normals[rest]).all()


def test_a_map_is_not_made_where_all_pixels_see_every_light():
    normals, mask = dome(64, cap=0.3)
    observation, F = shade(normals, mask, COLOURS, directions=TOWARD)
    problem, start = problem_of_colours(observation.rgb, mask), np.where(mask[..., None], normals, np.nan)
    labelled = label_by_light_sets(problem, start, F, NONE_FOUND)
    mapped, diagnostics = with_irradiance_map(labelled, problem, solution_of(F, mask))
    assert mapped is labelled
    assert diagnostics == {}


def test_the_stated_error_grows_as_the_core_shrinks():
    assert map_error_deg(0.5) == pytest.approx(2 * map_error_deg(1.0))
    assert np.isfinite(map_error_deg(0.0))
