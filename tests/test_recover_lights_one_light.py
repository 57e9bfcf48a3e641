"""One light fitted to the colours of pixels that miss it: its partners, its refinement, its guesses by windows."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from test_recover_lights_from_shadows import COLOURS, TOWARD, F, angle_deg

from huesphere.recover.geometry.sphere import fibonacci
from huesphere.recover.lights.one_light import WindowLimits, _ranked, alike, folds, refined, scan, support

LIGHT = np.concatenate([COLOURS[0], TOWARD[0]])  # (b, a)
LIMITS = WindowLimits(0.06, 0.01, 0.6, 0.97, 0.15)


def shadowed(count=400, outliers=0.0, seed=0, *, cast=False):
    """Colours (count, 3) of normals in the attached or ``cast`` shadow of the first light, a share of them outliers;
    and the normals."""
    rng = np.random.default_rng(seed)
    n = rng.normal(size=(20 * count, 3)) + np.array([0.2 if cast else -0.6, 0.0, 1.0])
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    missing = n @ TOWARD[0] > 0.2 if cast else n @ TOWARD[0] < 0.1
    n = n[(n @ TOWARD[1:].T > 0).all(axis=1) & missing][:count]
    rho = n @ (F - np.outer(COLOURS[0], TOWARD[0])).T
    wrong = rng.random(len(n)) < outliers
    rho[wrong] *= rng.uniform(0.5, 0.9, (wrong.sum(), 1))
    return rho, n


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=50, deadline=None)
def test_folds_are_one_ellipsoid(seed):
    rng = np.random.default_rng(seed)
    a = rng.normal(size=3)
    a /= np.linalg.norm(a)
    b = rng.uniform(0.1, 0.6, 3)
    M = F - np.outer(b, a)
    if np.linalg.cond(M) > 100 or abs(1 - a @ np.linalg.solve(F, b)) < 0.05:
        return
    C = np.linalg.inv(M @ M.T)
    found = folds(F, b, a)
    assert len(found) >= 2
    for colour, plane in found:
        other = F - np.outer(colour, plane)
        assert np.allclose(np.linalg.inv(other @ other.T), C, rtol=1e-5, atol=1e-5 * np.abs(C).max())


def test_a_light_is_refined_to_the_true_one_from_a_poor_start_though_some_colours_are_outliers():
    rho, _ = shadowed(outliers=0.2)
    start = LIGHT * [1.1, 1.1, 0.95, 1.0, 1.0, 1.0] + [0, 0, 0, 0.05, -0.04, 0.02]
    end = refined(rho, F, start, 0.05, 1e-5, rounds=50)
    assert np.linalg.norm(end[:3] - COLOURS[0]) < 1e-4
    assert angle_deg(end[3:], TOWARD[0]) < 0.01
    assert abs(np.linalg.norm(end[3:]) - 1) < 1e-12


def test_the_true_light_is_supported_by_every_colour_and_a_wrong_one_by_few():
    rho, _ = shadowed()
    wrong = np.concatenate([COLOURS[3], TOWARD[2]])
    true, other = support(rho, F, np.array([LIGHT, wrong]), 0.01)
    assert true > 0.999 * len(rho)
    assert other < 0.2 * len(rho)


def test_windows_of_shadowed_pixels_guess_the_light():
    """Of eight windows in its cast shadow, a fifth of each outliers, a quarter hit the light: a search draws dozens."""
    hits = 0
    directions = fibonacci(700)
    colours = directions @ F.T
    real = colours.min(axis=1) > -0.1 * colours.max(axis=1)
    size = np.linalg.norm(colours[real], axis=1, keepdims=True)
    for seed in range(8):
        rho, _ = shadowed(60, outliers=0.2, seed=seed, cast=True)
        out, windows = np.empty((1, 4, 6)), np.arange(len(rho))[None]
        length, facing = rho @ np.linalg.inv(F).T, np.array([[0.0, 0.0, 1.0]])
        c, b = directions[real] / size, colours[real] / size
        scan(windows, np.array([len(rho)]), length, rho, c, b, F, facing, LIMITS, 1e-4, out)
        found = out[0][np.isfinite(out[0, :, 0])]
        partners = [np.concatenate(fold) for both in found for fold in folds(F, both[:3], both[3:])]
        hits += min(np.linalg.norm(both - LIGHT) for both in partners) < 0.01
    assert hits >= 2


def test_lights_are_alike_by_direction_and_by_colour():
    turned = LIGHT.copy()
    turned[3:] = TOWARD[1]
    assert alike(LIGHT, 1.0 * LIGHT, 0.97, 0.15)
    assert not alike(LIGHT, turned, 0.97, 0.15)
    assert alike(LIGHT * [1.1, 1.1, 1.1, 1, 1, 1], LIGHT, 0.97, 0.15)
    assert not alike(LIGHT * [1.3, 1.3, 1.3, 1, 1, 1], LIGHT, 0.97, 0.15)


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=60), st.data())
@settings(deadline=None)
def test_the_element_of_a_rank_is_that_of_the_sorted_values(values, data):
    rank = data.draw(st.integers(0, len(values) - 1))
    array = np.array(values)
    assert _ranked(array, len(array), rank, np.empty(len(array))) == np.sort(array)[rank]
