"""Specular pixels, against highlights that were rendered or planted."""

import subprocess
import sys
from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from synthesis import DIRECTIONS, dome, light_colours, shade

from huesphere.recover.ellipsoid.specular import specular_pixels
from huesphere.render.dataset import read_observation, read_truth


def test_highlights_are_outliers_beyond_the_matte_ellipsoid(tmp_path):
    coat = "surface={kind: coated, reflectance: light skin, roughness: 0.15}"
    size = "camera.resolution=[64,64]"
    command = [Path(sys.executable).parent / "render", "--config", "sphere_quick", "--transport", "direct"]
    subprocess.run([*command, "--set", coat, "--set", size, "--out", tmp_path], check=True, capture_output=True)
    folder = tmp_path / "sphere_quick" / "direct"
    observation, truth = read_observation(folder / "observation.exr"), read_truth(folder / "truth.exr")
    found = specular_pixels(observation.rgb.astype(float), observation.mask)
    highlight = truth.extra["highlight"] > 0.5
    assert highlight.sum() > 100
    assert (found & highlight).sum() / found.sum() > 0.8  # precision
    assert (found & highlight).sum() / highlight.sum() > 0.9  # recall


def test_a_matte_surface_has_no_highlight():
    n, mask = dome(96, bumps=0.2)
    rgb = shade(n, mask, light_colours("gels"), noise=1e-3)[0].rgb.astype(float)
    assert specular_pixels(rgb, mask)[mask].mean() < 0.03  # the tail beyond 2.5 s0


def glossy(
    at: tuple[int, int], radius: float, light: int, strength: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(rgb, mask, highlight): a dome under three lights with a disc of one light's own colour added.

    Strength 1 is what the light gives a pixel that faces it. In normals the disc adds F⁻¹b, of length 1 at least where
    directions are unit vectors, so from twice its inverse on it leaves the unit sphere whichever way it points.
    """
    n, mask = dome(56, bumps=0.15, cap=0.6)
    colours = light_colours("gels")[:3]
    observation, F = shade(n, mask, colours, directions=DIRECTIONS[:3] * [0.6, 0.6, 1], noise=3e-4)
    scale = np.linalg.norm(F) / np.linalg.norm(colours.T @ (DIRECTIONS[:3] * [0.6, 0.6, 1]))
    row, column = np.mgrid[:56, :56]
    disc = mask & ((row - at[0]) ** 2 + (column - at[1]) ** 2 < radius**2)
    return observation.rgb + strength * scale * np.where(disc[..., None], colours[light], 0.0), mask, disc


discs = st.tuples(*[st.integers(20, 36)] * 2)


@settings(max_examples=15, deadline=None)
@given(at=discs, radius=st.floats(3, 8), light=st.integers(0, 2), strength=st.floats(2.2, 6))
def test_a_planted_highlight_is_found_whatever_its_place_and_colour(at, radius, light, strength):
    rgb, mask, disc = glossy(at, radius, light, strength)
    found = specular_pixels(rgb, mask)
    assert (found & disc).sum() == disc.sum()
    assert (found & mask & ~disc).sum() < 0.03 * mask.sum()


@settings(max_examples=10, deadline=None)
@given(exposure=st.floats(1e-3, 1e3), order=st.permutations(range(3)), balance=st.tuples(*[st.floats(0.2, 5.0)] * 3))
def test_highlights_do_not_depend_on_exposure_units_or_order_of_channels(exposure, order, balance):
    rgb, mask, _ = glossy((28, 30), 6.0, 1, 1.0)
    usual = specular_pixels(rgb, mask)
    changed = specular_pixels((rgb * (exposure * np.array(balance)))[..., order], mask)
    assert (changed == usual)[mask].mean() > 0.99


def test_a_wider_cut_finds_fewer_highlights_and_a_single_pixel_is_no_highlight():
    rgb, mask, disc = glossy((28, 28), 5.0, 0, 3.0)
    narrow, wide = (specular_pixels(rgb, mask, cut=cut) for cut in (2.5, 400.0))
    assert narrow[disc].all()
    assert wide.sum() < narrow.sum()
    row, column = 20, 38
    speck = np.where(disc[..., None], 0.0, rgb)
    speck[row, column] *= 3
    usable = mask & ~disc
    assert usable[row, column]
    assert not specular_pixels(speck, usable)[row, column]
