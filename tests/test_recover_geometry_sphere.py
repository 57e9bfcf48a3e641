"""The normal whose colour is nearest to one that was seen."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from test_recover_lights_from_shadows import F, angle_deg, bumps

from huesphere.recover.geometry.sphere import across, fibonacci, on_sphere


@given(st.integers(0, 2**32 - 1), st.booleans())
@settings(max_examples=30, deadline=None)
def test_nearest_on_the_sphere_is_the_nearest(seed, flat):
    rng = np.random.default_rng(seed)
    M = rng.normal(size=(3, 3))
    if flat:
        M[2] = M[0] + M[1]
    rho = rng.normal(size=(5, 3))
    n, distance = on_sphere(rho, M)
    assert np.allclose(np.linalg.norm(n, axis=1), 1)
    assert np.allclose(np.linalg.norm(rho - n @ M.T, axis=1), distance)
    others = rng.normal(size=(4000, 3))
    others /= np.linalg.norm(others, axis=1, keepdims=True)
    nearest = np.linalg.norm(rho[:, None] - others @ M.T, axis=2).min(axis=1)
    assert (distance <= nearest + 1e-9).all()


def test_a_colour_on_the_ellipsoid_gives_its_normal():
    normals, mask = bumps()
    n = normals[mask]
    found, distance = on_sphere(n @ F.T, F)
    assert angle_deg(found, n).max() < 1e-5
    assert distance.max() < 1e-9


def test_two_vectors_across_any_direction_make_a_right_handed_frame():
    directions = np.concatenate([fibonacci(500), np.eye(3), -np.eye(3)])
    first, second = across(directions)
    frames = np.stack([first, second, directions], axis=1)
    assert np.allclose(frames @ frames.transpose(0, 2, 1), np.eye(3), atol=1e-12)
    assert np.allclose(np.linalg.det(frames), 1)
