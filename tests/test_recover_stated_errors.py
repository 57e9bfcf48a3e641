"""Covariances that recovery states of rotations and of F, against the scatter of the errors that they speak of.

The errors are of kinds that noise of the camera alone does not make: an ellipsoid that outliers have stretched, and
residuals that neighbouring pixels share.
"""

import numpy as np
import pytest
from scipy import ndimage
from synthesis import TWIN, dome, joint_fit

from huesphere.recover.geometry.rays import of_surface
from huesphere.recover.geometry.rotations import rotation_by
from huesphere.recover.rotation import weak_form
from huesphere.recover.rotation.tangents import tangent_rotation, turn_between
from huesphere.recover.rotation.weak_form import weak_rotation

SIZE = 48
TOWARD = np.array([[0.5, 0.2, 1.0], [-0.5, 0.2, 1.0], [0.0, -0.5, 1.0]])
F = np.array([[1.0, 0.8, 0.7], [0.8, 1.0, 0.75], [0.75, 0.8, 1.0]]) @ TOWARD / 3
STRETCHES = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]  # of a symmetric matrix


def stretch(numbers: np.ndarray) -> np.ndarray:
    """The symmetric matrix 𝟙 + … of six small numbers."""
    S = np.eye(3)
    for (i, j), number in zip(STRETCHES, numbers, strict=True):
        S[i, j] += number
        S[j, i] += number if i != j else 0.0
    return S


def test_the_tangents_rotation_is_within_its_error_though_the_ellipsoid_is_off_by_six_times_its_noise():
    """Outliers stretch the ellipsoid by several times what the noise of its pixels says, on real and random scenes.

    The surface says more about the stretch then, so that part of it is undone; and the covariance allows for the rest.
    """
    start, sigma = rotation_by(np.array([0.15, -0.1, 0.2])), 0.01
    n, inside = dome(96, elongation=1.2, bumps=0.3, cap=0.6)
    unit = n[inside]
    # |(𝟙 + S) n| = 1 + nᵀSn to first order, which each pixel measures with the noise sigma.
    design = np.stack([(1 if i == j else 2) * unit[:, i] * unit[:, j] for i, j in STRETCHES], axis=-1)
    half = np.linalg.cholesky(6.0**2 * sigma**2 * np.linalg.inv(design.T @ design))
    errors, stated, undone = [], [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        S = stretch(half @ rng.standard_normal(6))
        N = (n + sigma * rng.standard_normal(n.shape)) @ start @ np.linalg.inv(S)
        found = tangent_rotation(N, inside, sigma**2 * np.eye(3), [np.eye(3)])
        errors.append(turn_between(found.rotation, start))
        stated.append(np.sqrt(np.trace(found.covariance)))
        undone.append(np.linalg.norm(found.stretch - S) / np.linalg.norm(S - np.eye(3)))
    ratio = np.sqrt(np.mean(np.square(errors)) / np.mean(np.square(stated)))
    assert 0.4 < ratio < 1.4
    assert np.median(undone) < 0.85


def test_the_weak_forms_error_holds_though_neighbours_share_their_residuals():
    """Noise blurred over six pixels, the radius of a bump: were each bump counted for itself it would be a third."""
    n, inside = dome(96, elongation=1.2, bumps=0.15)
    squares, variances = [], []
    for seed in range(8):
        shared = ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal(n.shape), (6.0, 6.0, 0))
        N = n + 0.02 * shared / shared.std()
        N /= np.linalg.norm(N, axis=-1, keepdims=True)
        found = weak_rotation(N, inside, [np.eye(3)], search=False)
        turn = min((found.rotation, TWIN @ found.rotation), key=lambda R: np.linalg.norm(R - np.eye(3)))
        squares.append(np.sum((turn - np.eye(3)) ** 2) / 2)
        variances.append(np.trace(found.covariance))
    assert 0.5 < np.sqrt(np.mean(squares) / np.mean(variances)) < 1.5


def patchy_fit(patch: int, seed: int):
    """The joint fit to a smooth hill, of noise that is the same over squares of so many pixels."""
    noise, count = 2e-3, -(-SIZE // patch)
    x, y = np.meshgrid(np.linspace(-1, 1, SIZE + 1), np.linspace(1, -1, SIZE + 1))  # of the corners of pixels
    depth = 15 * np.exp(-(x**2) - y**2)
    above, below = depth[:-1], depth[1:]
    p = (above[:, 1:] - above[:, :-1] + below[:, 1:] - below[:, :-1]) / 2
    q = (above[:, 1:] + above[:, :-1] - below[:, 1:] - below[:, :-1]) / 2
    n = np.stack([-p, -q, np.ones_like(p)], axis=-1)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    mask = x[:-1, :-1] ** 2 + y[:-1, :-1] ** 2 < 0.9
    grain = np.random.default_rng(seed).standard_normal((count, count, 3)).repeat(patch, 0).repeat(patch, 1)
    rgb = np.where(mask[..., None], n @ F.T, 0.0) + noise * grain[:SIZE, :SIZE]
    start = np.where(mask[..., None], n, np.nan)
    return joint_fit(rgb, mask, start, F, noise)


def scatter_over_stated(patch: int) -> float:
    """Root mean square of the joint fit's error of F over what its covariance says."""
    fits = [patchy_fit(patch, seed) for seed in range(12)]
    squares = [np.sum(((fit.F - F) / fit.noise) ** 2) for fit in fits]
    return float(np.sqrt(np.mean(squares) / np.mean([np.trace(fit.covariance) for fit in fits])))


def test_the_joint_fits_error_of_F_is_that_of_noise_where_there_is_nothing_else():
    """Stated is the sum of what noise gives and of what blocks of residuals show, √2 of it."""
    assert 0.5 < scatter_over_stated(1) < 1.0


def test_the_joint_fits_error_of_F_holds_though_neighbours_share_their_residuals():
    """Squares of eight pixels with one noise: were each pixel counted for itself it would be less than half."""
    assert 0.6 < scatter_over_stated(8) < 1.4


@pytest.mark.parametrize("perspective", [False, True])
def test_the_noise_that_explains_a_surfaces_curls_is_the_noise_that_its_normals_have(perspective):
    n, inside = dome(96, elongation=1.2, bumps=0.1, cap=0.7)
    row, column = np.indices(inside.shape)
    inside &= (row < 52) & (column > 44)  # a quarter, so that slopes and rays have a mean
    ray = None
    if perspective:  # the same slopes, now of the relief
        ray = np.stack([(column - 20.0) / 150, (70.0 - row) / 60], axis=-1)[inside]
    sigma, rng = 0.02, np.random.default_rng(0)
    functions = weak_form.test_functions(inside, radius=5.0, stencil="continuous")
    found = []
    for _ in range(12):
        N = of_surface(n[inside], ray) + sigma * rng.standard_normal((int(inside.sum()), 3))
        normals = weak_form._RotatedNormals(np.ascontiguousarray(N.T), None if ray is None else ray.T)
        found.append(weak_form._noise_explaining(normals, np.eye(3), functions))
    assert np.mean(found) == pytest.approx(sigma, rel=0.08)
