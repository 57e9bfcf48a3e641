"""Integrability, pointwise and weak; the rotation that the weak form gives, and the choice of the twin."""

import numpy as np
import pytest
from synthesis import TWIN, angles_deg, dome

from huesphere.recover.cues.convexity import choose_twin
from huesphere.recover.ellipsoid.refit import refit_inliers
from huesphere.recover.geometry.rotations import rotation_by
from huesphere.recover.geometry.tangent_uncertainty import expected_length, normal_uncertainty_deg
from huesphere.recover.rotation.weak_form import curl_image, test_functions, weak_rotation, without_specks
from huesphere.recover.status import RecoveryFailure

bumps_within = test_functions  # so that pytest does not take it for a test
del test_functions


def slopes(n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return -n[:, 0] / n[:, 2], -n[:, 1] / n[:, 2]


def rotation_error(n, inside, found) -> float:
    """Median error in degrees of found · N against n, for the better twin."""
    return min(float(np.median(angles_deg(found[inside] @ T, n[inside]))) for T in (np.eye(3), TWIN))


def test_the_pointwise_curl_vanishes_on_a_surface_and_not_on_a_turned_one():
    n, inside = dome(96, bumps=0.2)
    true, turned = curl_image(n, inside), curl_image(n @ rotation_by(np.array([0, 0, 0.5])).T, inside)
    assert np.isnan(true[~inside]).all()
    assert np.nanmedian(true) < 0.05 * np.nanmedian(turned)


@pytest.mark.parametrize("radius", [4.0, 6.0, 10.0])
def test_the_weak_curl_of_a_surface_vanishes_to_quadrature(radius):
    n, inside = dome(128, bumps=0.15, cap=0.8)
    functions = bumps_within(inside, radius=radius, stencil="continuous")
    turned = n @ rotation_by(np.array([0, 0, 0.02])).T
    true, off = (np.abs(functions.curl(*slopes(x[inside]))).mean() for x in (n, turned))
    assert true < 0.05 * off  # a rotation by one degree stands out twentyfold


def test_the_centred_stencil_is_exact_for_centred_differences():
    rng = np.random.default_rng(0)
    z = rng.standard_normal((60, 60)).cumsum(axis=0).cumsum(axis=1)  # as rough as may be
    p, q = np.zeros_like(z), np.zeros_like(z)
    p[:, 1:-1], q[1:-1] = (z[:, 2:] - z[:, :-2]) / 2, (z[:-2] - z[2:]) / 2
    inside = np.zeros_like(z, bool)
    inside[2:-2, 2:-2] = True
    functions = bumps_within(inside, radius=6.0, stencil="centred")
    assert np.abs(functions.curl(p[inside], q[inside])).max() < 1e-9 * np.abs(z).max()


def test_bumps_lie_within_the_mask():
    _, inside = dome(64)
    inside[30, 30] = False
    functions = bumps_within(inside, radius=5.0, stencil="continuous")
    constant = functions.curl(np.ones(inside.sum()), np.zeros(inside.sum()))
    assert np.abs(constant).max() < 1e-12  # ∫ φ_y = 0 only if the whole bump is there


@pytest.mark.parametrize("seed", range(4))
def test_any_rotation_and_reflection_is_found_without_a_start(seed):
    rng = np.random.default_rng(seed)
    n, inside = dome(96, elongation=1.2, bumps=0.15)
    O = rotation_by(rng.normal(size=3) * 2) * (1 if seed % 2 else -1)
    N = np.where(inside[..., None], n @ O.T, 0)
    weak = weak_rotation(N, inside, [])
    assert rotation_error(n, inside, N @ weak.rotation.T) < 0.05
    assert np.linalg.det(weak.rotation) == pytest.approx(np.linalg.det(O))
    assert weak.converged
    assert weak.other_hand > 3


def test_of_two_rotations_with_equal_slopes_the_one_is_found_that_faces_the_camera():
    """n and −n have the same slopes, so a start behind the surface is as good as one before it."""
    n, inside = dome(96, elongation=1.2, bumps=0.15)
    weak = weak_rotation(n, inside, [-np.eye(3)], search=False)
    assert (n[inside] @ weak.rotation.T)[:, 2].min() > 0
    assert rotation_error(n, inside, n @ weak.rotation.T) < 0.05


def test_error_of_the_rotation_falls_with_noise_and_is_near_its_own_estimate():
    n, inside = dome(128, elongation=1.2, bumps=0.15)
    errors, stated = [], []
    for noise in (0.03, 0.01):
        squares, variances = [], []
        for seed in range(5):
            N = n + noise * np.random.default_rng(seed).standard_normal(n.shape)
            N /= np.linalg.norm(N, axis=-1, keepdims=True)
            weak = weak_rotation(N, inside, [np.eye(3)])
            turn = min((weak.rotation, TWIN @ weak.rotation), key=lambda R: np.linalg.norm(R - np.eye(3)))
            squares.append(np.sum((turn - np.eye(3)) ** 2) / 2)
            variances.append(np.trace(weak.covariance))
        errors.append(np.sqrt(np.mean(squares)))
        stated.append(np.sqrt(np.mean(variances)))
    assert errors[1] < 0.6 * errors[0]
    assert 0.2 < errors[1] / stated[1] < 2  # rather too careful than too sure


def test_flat_slopes_cannot_be_won_by_looking_at_the_surface_edge_on():
    n, inside = dome(96, elongation=1.2, bumps=0.3, cap=0.6)
    N = n + 0.1 * np.random.default_rng(0).standard_normal(n.shape)
    N /= np.linalg.norm(N, axis=-1, keepdims=True)
    weak = weak_rotation(N, inside, [])
    assert np.median((N[inside] @ weak.rotation.T)[:, 2]) > 0.7
    assert rotation_error(n, inside, N @ weak.rotation.T) < 12


def test_no_disc_within_the_mask_is_too_scattered():
    inside = np.zeros((40, 40), bool)
    inside[::3] = True
    with pytest.raises(RecoveryFailure, match="too-scattered"):
        weak_rotation(np.ones((40, 40, 3)), inside, [np.eye(3)])


def test_specks_are_forgotten_and_regions_kept():
    inlier = np.zeros((60, 60), bool)
    inlier[10:50, 10:50] = True
    inlier[np.random.default_rng(0).integers(12, 48, 60), np.random.default_rng(1).integers(12, 48, 60)] = False
    inlier[3, 3] = True
    cleaned = without_specks(inlier)
    assert cleaned[14:46, 14:46].all()
    assert not cleaned[:6].any()


@pytest.mark.parametrize("turned", [False, True])
def test_the_outline_tells_a_dome_from_a_dent(turned):
    n, inside = dome(64)
    choice = choose_twin(n @ TWIN if turned else n, inside, inside)
    assert choice.flipped is turned
    assert choice.margin > 0.9
    assert choice.evidence == "silhouette"


@pytest.mark.parametrize("turned", [False, True])
def test_the_outline_testifies_where_no_normal_beside_it_is_known(turned):
    """All-lit pixels lie in the middle; a dent there, which pixels near the middle see alone, must not outvote them."""
    n, inside = dome(128, bumps=-0.35)
    row, column = np.indices(inside.shape)
    valid = (row - 64) ** 2 + (column - 56) ** 2 < 34**2
    choice = choose_twin(n @ TWIN if turned else n, valid, inside)
    assert choice.flipped is turned
    assert choice.margin > 0.3


def test_without_an_outline_there_is_no_margin():
    n, _ = dome(64, cap=0.5)
    everywhere = np.ones((64, 64), bool)
    choice = choose_twin(n @ TWIN, everywhere, everywhere)
    assert choice.flipped
    assert choice.margin == 0


def test_expected_length_of_round_and_flat_gaussians():
    covariance = np.array([[[4.0, 0], [0, 4]], [[4, 0], [0, 0]], [[1, 0.5], [0.5, 2]]])
    sample = np.linalg.norm(np.random.default_rng(0).multivariate_normal([0, 0], covariance[2], 200_000), axis=1).mean()
    expected = [2 * np.sqrt(np.pi / 2), 2 * np.sqrt(2 / np.pi), sample]
    xx, xy, yy = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    assert expected_length(xx, xy, yy) == pytest.approx(expected, rel=5e-3)


def test_uncertainty_is_the_mean_error_that_noise_makes():
    rng = np.random.default_rng(0)
    M = rng.normal(size=(3, 3)) + 2 * np.eye(3)
    n = np.array([0.3, -0.5, np.sqrt(1 - 0.34)])
    rho = np.linalg.solve(M, n)
    sigma = 0.002
    noisy = (rho + sigma * rng.standard_normal((100_000, 3))) @ M.T
    noisy /= np.linalg.norm(noisy, axis=1, keepdims=True)
    stated = normal_uncertainty_deg(n[None], np.ones(1), M, sigma**2 * np.eye(3), np.zeros((3, 3)))
    assert stated[0] == pytest.approx(angles_deg(noisy, n).mean(), rel=0.02)


def test_polish_drops_the_strip_along_a_terminator():
    n, inside = dome(120)
    F = np.array([[0.5, 0.2, 0.7], [-0.3, 0.4, 0.6], [0.1, -0.45, 0.55]])
    lost = np.maximum(0, n @ [0.8, 0.0, -0.6])[..., None] * [0.5, 0.3, 0.1]  # a light that part does not see
    rgb = np.where(inside[..., None], n @ F.T - lost + 1e-3 * np.random.default_rng(0).standard_normal(n.shape), 0)
    polished = refit_inliers(rgb, inside, np.linalg.inv(F @ F.T) * 1.002)
    strangers = polished.inlier & (lost[..., 0] > 0)
    assert strangers.sum() < 0.02 * inside.sum()
    assert (polished.inlier & (lost[..., 0] == 0)).sum() > 0.9 * (inside & (lost[..., 0] == 0)).sum()
    assert polished.noise == pytest.approx(1e-3, rel=0.1)
    assert polished.unbiased
