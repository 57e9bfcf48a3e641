"""Interpolated normals lean on colours where these know more, and keep away from them where they know less."""

from dataclasses import replace

import numpy as np
import pytest
from synthesis import angles_deg, dome, problem_of_colours, shade, solution_of

from huesphere.recover.every_pixel.by_light_sets import LabelledPixels, interpolated_normals
from huesphere.recover.every_pixel.leaning_on_colour import leaning_on_colour
from huesphere.recover.geometry.rays import rays
from huesphere.render.dataset import CameraInfo

SIDE = 72
AROUND = np.radians([10, 82, 154, 226, 298])
TOWARD = np.stack([0.5 * np.cos(AROUND), 0.5 * np.sin(AROUND), np.full(5, np.sqrt(0.75))], axis=-1)
GELS = np.array([[1.0, 0.25, 0.1], [0.7, 0.8, 0.1], [0.1, 1.0, 0.4], [0.15, 0.4, 1.0], [0.8, 0.1, 0.9]])


def in_shadow(noise: float = 0.0, ray: np.ndarray | None = None, bump: float = 2.5):
    """(problem, solution, labels, normals): a dome with a bump, of steepness ``bump``, in a disc that misses lights.

    Pixels outside the disc are explained; within it the surface is interpolated.
    """
    normals, mask = dome(SIDE, cap=0.6)
    row, column = np.mgrid[:SIDE, :SIDE]
    x, y = column - 42.0, 30.0 - row
    gap = x**2 + y**2 < 12**2
    slope = bump * np.exp(-(x**2 + y**2) / (2 * 4**2)) * np.sqrt(np.e) / 4
    relief = normals / normals[..., 2:]
    relief[..., :2] += np.stack([x * slope, y * slope], axis=-1)
    normals = relief / np.linalg.norm(relief, axis=-1, keepdims=True)
    hidden = np.zeros((*mask.shape, 5), bool)
    hidden[gap & (x + y < 0), 1] = True
    hidden[gap & (x - y > 3), 3] = True
    observation, F = shade(normals, mask, GELS, directions=TOWARD, hidden=hidden, noise=noise)
    problem = replace(problem_of_colours(observation.rgb, mask, noise), ray=ray)
    seen, none = mask & ~gap, np.zeros_like(mask)
    between = interpolated_normals(np.where(seen[..., None], normals, 0.0), seen, mask, ray)
    between = np.where(mask[..., None], np.where(gap[..., None], between, normals), np.nan)
    return problem, solution_of(F, seen), LabelledPixels(between, np.where(gap, -1, 0), seen, gap, none), normals


def mean_error(labelled, normals: np.ndarray, where: np.ndarray) -> float:
    return float(angles_deg(labelled.normals[where], normals[where]).mean())


@pytest.mark.parametrize("noise", [0.0, 3e-3])
@pytest.mark.parametrize("field_of_view", [0.0, 40.0])
def test_in_a_shadow_the_error_is_less_than_that_of_the_surface_between(noise, field_of_view):
    focal = SIDE / 2 / np.tan(np.radians(field_of_view / 2)) if field_of_view else None
    camera = CameraInfo(projection="perspective" if focal else "orthographic", focal_px=focal)
    problem, solution, labelled, normals = in_shadow(noise, rays(camera, (SIDE, SIDE)))
    gap = labelled.interpolated
    assert gap.sum() > 300
    found = leaning_on_colour(labelled, problem, solution)
    assert mean_error(found, normals, gap) < 0.8 * mean_error(labelled, normals, gap)
    assert np.abs(np.linalg.norm(found.normals[gap], axis=-1) - 1).max() < 1e-9


def test_in_a_shadow_on_a_smooth_surface_nothing_is_lost():
    problem, solution, labelled, normals = in_shadow(bump=0.0)
    gap = labelled.interpolated
    found = leaning_on_colour(labelled, problem, solution)
    assert mean_error(found, normals, gap) < mean_error(labelled, normals, gap) + 1.0


def test_colours_that_say_nothing_are_not_leaned_on():
    """Colours of a gap that have nothing to do with the surface, as of another material."""
    problem, solution, labelled, normals = in_shadow()
    gap, rng = labelled.interpolated, np.random.default_rng(1)
    rgb = problem.rgb.copy()
    v = rng.standard_normal((gap.sum(), 3)) * rng.uniform(0.0, 3.0, gap.sum())[:, None]
    rgb[gap] = v @ solution.F.T
    found = leaning_on_colour(labelled, replace(problem, rgb=rgb), solution)
    assert mean_error(found, normals, gap) < mean_error(labelled, normals, gap) + 3.0


def test_explained_pixels_and_those_without_a_sample_stay_as_they_are():
    problem, solution, labelled, _ = in_shadow()
    usable = problem.usable.copy()
    usable[30:34, 40:44] = False
    found = leaning_on_colour(labelled, replace(problem, usable=usable), solution)
    explained = problem.mask & ~labelled.interpolated
    assert np.array_equal(found.normals[explained], labelled.normals[explained])
    lost = labelled.interpolated & ~usable
    assert lost.any()
    np.testing.assert_allclose(found.normals[lost], labelled.normals[lost], atol=1e-12)
    assert np.array_equal(found.interpolated, labelled.interpolated)


def test_noise_alone_in_a_black_pixel_is_no_colour():
    noise = 3e-3
    problem, solution, labelled, normals = in_shadow(noise)
    gap, rgb = labelled.interpolated, problem.rgb.copy()
    rgb[gap] = noise * np.random.default_rng(2).standard_normal((gap.sum(), 3))
    found = leaning_on_colour(labelled, replace(problem, rgb=rgb), solution)
    assert mean_error(found, normals, gap) < mean_error(labelled, normals, gap) + 1.0
