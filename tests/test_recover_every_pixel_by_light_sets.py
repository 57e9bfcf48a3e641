"""Every pixel labelled with the lights that it misses."""

import numpy as np
import pytest
from synthesis import dome, problem_of_colours, shade, solution_of
from test_recover_lights_from_shadows import COLOURS, TOWARD, F, angle_deg, wide_picture

from huesphere.recover.every_pixel import by_light_sets
from huesphere.recover.every_pixel.by_light_sets import (
    interpolated_normals,
    label_by_light_sets,
    with_explained_neighbours,
)
from huesphere.recover.lights.from_shadows import find_lights
from huesphere.recover.lights.model import Light, Lights

TRUTH = Lights(tuple(Light(a, b, 100, 0.0, 1.0) for a, b in zip(TOWARD, COLOURS)), 0.0)


@pytest.fixture(scope="module")
def wide():
    return wide_picture()


def labelled(picture, lights):
    observation, normals, lit, scale = picture
    all_lit = observation.mask & lit.all(axis=-1)
    start = np.where(all_lit[..., None], normals, np.nan)
    problem = problem_of_colours(observation.rgb, observation.mask)
    scaled = tuple(Light(one.direction, scale * one.colour, 0, 0.0, 0.0) for one in lights.found)
    return label_by_light_sets(problem, start, scale * F, Lights(scaled, lights.missing)), all_lit


def test_every_pixel_is_labelled_by_the_lights_that_were_found(wide):
    observation, normals, lit, scale = wide
    mask = observation.mask
    all_lit = mask & lit.all(axis=-1)
    problem = problem_of_colours(observation.rgb, mask)
    lights = find_lights(problem, solution_of(scale * F, all_lit))
    start = np.where(all_lit[..., None], normals, np.nan)
    whole = label_by_light_sets(problem, start, scale * F, lights)
    error = angle_deg(whole.normals[mask], normals[mask])
    assert np.isfinite(whole.normals[mask]).all()
    assert (whole.explained & mask).sum() > 0.97 * mask.sum()
    assert np.median(error) < 0.05
    assert error.mean() < 0.5
    missed = np.stack([(whole.missed >> j) & 1 for j in range(len(lights.found))], axis=-1).astype(bool)
    order = [int(np.argmax(TOWARD @ light.direction)) for light in lights.found]
    agree = (missed == ~lit[..., order]).all(axis=-1)
    assert agree[whole.explained].mean() > 0.95


def test_without_lights_the_rest_is_interpolated(wide):
    whole, all_lit = labelled(wide, Lights((), 1.0))
    observation, normals, *_ = wide
    assert np.isfinite(whole.normals[observation.mask]).all()
    assert (whole.missed[~whole.explained] == -1).all()
    assert (whole.missed[whole.explained] == 0).all()
    assert np.median(angle_deg(whole.normals[all_lit], normals[all_lit])) < 1e-3


def test_labels_exclude_one_another_and_nothing_is_said_off_the_object(wide):
    whole, _ = labelled(wide, TRUTH)
    mask = wide[0].mask
    assert not (whole.explained & whole.interpolated).any()
    assert not whole.mapped.any()
    assert not (whole.explained | whole.interpolated)[~mask].any()
    assert np.isnan(whole.normals[~mask]).all()


def test_a_cast_shadow_is_told_from_the_pixels_own_colour(wide):
    """A square that faces every light, from which something hides the second: its pixels say so, and their normals."""
    observation, normals, lit, scale = wide
    rgb = observation.rgb.astype(np.float64)
    square = np.zeros(observation.mask.shape, bool)
    square[50:60, 50:60] = True
    rgb[square] -= scale * np.maximum(normals[square] @ TOWARD[1], 0)[:, None] * COLOURS[1]
    all_lit = observation.mask & lit.all(axis=-1) & ~square
    assert lit[square].all()
    start = np.where(all_lit[..., None], normals, np.nan)
    lights = Lights(tuple(Light(a, scale * b, 100, 0.0, 1.0) for a, b in zip(TOWARD, COLOURS)), 0.0)
    whole = label_by_light_sets(problem_of_colours(rgb, observation.mask), start, scale * F, lights)
    assert (whole.missed[square] == 0b10).mean() > 0.95
    assert np.median(angle_deg(whole.normals[square], normals[square])) < 0.1


def test_a_pixel_in_the_edge_of_a_cast_shadow_is_partly_lit(wide):
    """Half of the second light is hidden: where no set explains the colour, a share of that light does."""
    observation, normals, lit, scale = wide
    rgb = observation.rgb.astype(np.float64)
    edge = np.zeros(observation.mask.shape, bool)
    edge[[80, 80, 80, 70, 70], [30, 36, 42, 48, 54]] = True
    rgb[edge] -= 0.5 * scale * np.maximum(normals[edge] @ TOWARD[1], 0)[:, None] * COLOURS[1]
    all_lit = observation.mask & lit.all(axis=-1) & ~edge
    start = np.where(all_lit[..., None], normals, np.nan)
    lights = Lights(tuple(Light(a, scale * b, 100, 0.0, 1.0) for a, b in zip(TOWARD, COLOURS)), 0.0)
    whole = label_by_light_sets(problem_of_colours(rgb, observation.mask), start, scale * F, lights)
    partly = edge & ~whole.explained & ~whole.interpolated
    assert partly.sum() >= 3
    assert angle_deg(whole.normals[partly], normals[partly]).max() < 0.1


def test_of_two_mirrored_normals_a_smooth_surface_tells_which(monkeypatch):
    """Three lights, of which one is missed: the other two give one colour to two normals, mirrored in their plane.

    The surface interpolated between pixels that see every light is flatter than the dome, so by it alone the mirrored
    normal is taken for half of the pixels, and for a quarter where it counts less far from known normals. The dome
    passes through the plane within the shadow.
    """
    toward = np.array([[0.05, 0.78, 0.62], [0.81, 0.38, 0.44], [-0.38, -0.72, 0.58]])
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    colours = np.array([[0.9, 0.2, 0.1], [0.1, 0.3, 0.9], [0.3, 0.9, 0.4]])
    normals, mask = dome(96, cap=0.995)
    observation, scaled = shade(normals, mask, colours, directions=toward)
    exposure = scaled[0, 0] / (colours.T @ toward)[0, 0]
    lit = normals @ toward.T > 0
    start = np.where((mask & lit.all(axis=-1))[..., None], normals, np.nan)
    third = Lights((Light(toward[2], exposure * colours[2], 100, 0.0, 1.0),), 0.7)
    own = mask & lit[..., 0] & lit[..., 1] & ~lit[..., 2]
    assert own.sum() > 0.1 * mask.sum()

    def share_right() -> float:
        found = label_by_light_sets(problem_of_colours(observation.rgb, mask), start, scaled, third)
        return float((angle_deg(found.normals[own], normals[own]) < 1.0).mean())

    assert share_right() > 0.9
    undecided = np.zeros(mask.shape, bool)
    monkeypatch.setattr(by_light_sets, "one_sheet_a_region", lambda *_: (undecided, undecided))
    alone = share_right()
    monkeypatch.setattr(by_light_sets, "KNOWN_WITHIN", 1e9)
    assert 0.8 > alone > 0.65 > 0.55 > share_right()


def test_a_single_explained_pixel_does_not_count():
    explained = np.zeros((9, 9), bool)
    explained[4, 4] = True
    assert not with_explained_neighbours(explained).any()
    explained[3:6, 3:6] = True
    assert with_explained_neighbours(explained)[4, 4]


def test_a_gap_is_interpolated_by_the_depth_about_it(wide):
    _, normals, *_ = wide
    mask = wide[0].mask
    gap = np.zeros(mask.shape, bool)
    gap[50:54, 60:64] = True
    found = interpolated_normals(np.where((mask & ~gap)[..., None], normals, 0.0), mask & ~gap, mask)
    assert angle_deg(found[gap], normals[gap]).max() < 4
