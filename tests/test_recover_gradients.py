"""Normal equations of the fits by Gauss–Newton: the right side is the downhill derivative of the loss with its priors.

A step that is built from another gradient still lowers the loss, slowly or to another place: no result looks wrong.
"""

import numpy as np
import pytest
from synthesis import dome, problem_of_colours

from huesphere.recover.depth.joint_fit import Colours, Information
from huesphere.recover.ellipsoid.distance import signed_distance
from huesphere.recover.geometry.harmonics import Harmonics
from huesphere.recover.geometry.quadratic import elements_of, matrix_of
from huesphere.recover.geometry.rays import of_relief
from huesphere.recover.geometry.rotations import rotation_by
from huesphere.recover.geometry.sphere import across
from huesphere.recover.interreflection import albedo
from huesphere.recover.lights import bundle_adjustment, irradiance_map, near_lights
from huesphere.recover.lights.bundle_adjustment import Bundle, LitBlocks, prior_on_F
from huesphere.recover.rotation import tangents as tangents_module
from huesphere.recover.rotation import weak_form
from huesphere.render.dataset import KnownLights

TOWARD = np.array([[0.5, 0.2, 1.0], [-0.5, 0.2, 1.0], [0.0, -0.5, 1.0]])
TOWARD /= np.linalg.norm(TOWARD, axis=1, keepdims=True)
COLOURS = np.array([[0.6, 0.1, 0.1], [0.1, 0.5, 0.2], [0.15, 0.2, 0.55]])
F = COLOURS.T @ TOWARD


def along(loss, step: float = 1e-5) -> float:
    """Derivative at 0 of ``loss``, a function of one number."""
    return (loss(step) - loss(-step)) / (2 * step)


def pictured(size: int = 24):
    """(problem, normals, mask) of a small dome under three lights."""
    normals, mask = dome(size, elongation=1.2, cap=0.9)
    rgb = np.where(mask[..., None], np.maximum(normals @ TOWARD.T, 0) @ COLOURS, 0.0)
    return problem_of_colours(rgb, mask, 1e-3), normals, mask


@pytest.mark.parametrize("seed", range(3))
def test_irradiance_map(seed):
    """The prior on the core's slopes and that on the size of the light take part."""
    problem, normals, _ = pictured()
    given = irradiance_map._given(problem, normals, normals[..., 2] > 0.8)
    rng = np.random.default_rng(seed)
    slope = given.slope + 0.1 * rng.standard_normal(given.slope.shape)
    sigma = 0.3
    fit = irradiance_map._Fit(given, Harmonics((0, 1, 2)), sigma, slope)
    light = rng.standard_normal((9, 3))
    _, g, _, h, _ = fit._equations(slope, light)
    by_slope, by_light = rng.standard_normal(slope.shape), rng.standard_normal(light.shape)
    core = given.core[:, None] * by_slope
    assert given.core.any()
    for direction in (by_slope, core):
        change = along(lambda t, d=direction: fit.loss(slope + t * d, light))
        assert -2 / sigma**2 * (g * direction).sum() == pytest.approx(change, rel=1e-6)
    change = along(lambda t: fit.loss(slope, light + t * by_light))
    assert -2 / sigma**2 * (h @ by_light.ravel()) == pytest.approx(change, rel=1e-7)


def test_a_light_that_nothing_shows_is_drawn_to_none_by_its_prior():
    """Where no colour counts the right side is that of the priors alone."""
    problem, normals, _ = pictured()
    given = irradiance_map._given(problem, normals, normals[..., 2] > 0.8)
    fit = irradiance_map._Fit(given, Harmonics((0, 1, 2)), 0.3, given.slope)
    fit.weight = np.zeros_like(fit.weight)
    moved, light = np.full(given.slope.shape, 0.2), np.ones((9, 3))
    _, g, H, h, _ = fit._equations(given.slope + moved, light)
    assert (h < 0).all()
    np.testing.assert_allclose(np.linalg.solve(H, h), -1.0, rtol=1e-9)
    np.testing.assert_allclose(g, -np.einsum("pij,pj->pi", fit.information, moved), rtol=1e-9)
    assert (np.einsum("pi,pi->p", g, moved)[given.core] < 0).all()


@pytest.mark.parametrize("with_prior", [False, True])
@pytest.mark.parametrize("core_sees_all", [False, True])
def test_bundle_adjustment(with_prior, core_sees_all):
    problem, normals, mask = pictured()
    prior = prior_on_F(1.1 * F, np.radians(3.0) ** 2 * np.eye(3), 0.05) if with_prior else None
    bundle = Bundle(problem, mask & (normals[..., 2] > 0.8), 600, prior)
    rng = np.random.default_rng(0)
    slope = 0.5 * rng.standard_normal((len(bundle.core), 2))
    colour = COLOURS + 0.05 * rng.standard_normal(COLOURS.shape)
    colour[0, 1] = -0.02  # the prior on negative colours
    lit = LitBlocks(slope, TOWARD, colour, np.nan)
    descent = bundle_adjustment._Descent(bundle, lit, 0.1, 0.05, core_sees_all)
    _, g, _, h, _ = descent._equations(lit)
    by_slope, by_colour, by_turn = (rng.standard_normal(shape) for shape in (slope.shape, (3, 3), (3, 2)))

    def loss(slope=slope, colour=colour, turn=0.0):
        toward = TOWARD + turn * np.einsum("kd,kdx->kx", by_turn, np.stack(across(TOWARD), axis=1))
        toward /= np.linalg.norm(toward, axis=1, keepdims=True)
        return len(slope) * descent.loss(LitBlocks(slope, toward, colour, np.nan))

    assert -2 * (g * by_slope).sum() == pytest.approx(along(lambda t: loss(slope=slope + t * by_slope)), rel=1e-6)
    change = along(lambda t: loss(colour=colour + t * by_colour))
    assert -2 * (h[:9] @ by_colour.ravel()) == pytest.approx(change, rel=1e-6)
    assert -2 * (h[9:] @ by_turn.ravel()) == pytest.approx(along(lambda t: loss(turn=t)), rel=1e-6)


def colours_of_pixels(slope: np.ndarray, F: np.ndarray, residual: float) -> Colours:
    """Colours of pixels in perspective, some of which see less light, with correlated channels."""
    rng = np.random.default_rng(1)
    ray = 0.2 * rng.standard_normal((len(slope), 2))
    lost = np.where((np.arange(len(slope)) % 3 == 0)[:, None, None], 0.3 * F, 0.0)
    sure = rng.standard_normal((len(slope), 3, 3))
    sure = np.eye(3) + sure @ sure.swapaxes(1, 2)
    n = np.column_stack([-slope, 1 - (ray * slope).sum(axis=1)])
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    rho = np.einsum("pij,pj->pi", F - lost, n) + residual * rng.standard_normal((len(slope), 3))
    return Colours(rho, lost, sure, ray)


@pytest.mark.parametrize("weights", ["cauchy", "geman-mcclure"])
def test_joint_fit_of_depth_and_F(weights):
    rng = np.random.default_rng(0)
    slope, scaled = 0.5 * rng.standard_normal((40, 2)), 20 * F
    colours, information = colours_of_pixels(slope, scaled, 2.0), Information(40)
    loss = information.at(colours, slope, scaled, weights)
    assert loss == pytest.approx(colours.loss(slope, scaled, weights), rel=1e-12)
    by_slope, by_F = rng.standard_normal(slope.shape), rng.standard_normal((3, 3))
    change = along(lambda t: colours.loss(slope + t * by_slope, scaled, weights))
    assert -2 * (information.g * by_slope).sum() == pytest.approx(change, rel=1e-6)
    change = along(lambda t: colours.loss(slope, scaled + t * by_F, weights))
    assert -2 * (information.h @ by_F.ravel()) == pytest.approx(change, rel=1e-6)


@pytest.mark.parametrize("weights", ["cauchy", "geman-mcclure"])
def test_joint_fits_information_is_half_the_curvature_of_the_loss_where_no_residual_is_left(weights):
    rng = np.random.default_rng(0)
    slope, scaled = 0.5 * rng.standard_normal((40, 2)), 20 * F
    colours, information = colours_of_pixels(slope, scaled, 0.0), Information(40)
    information.at(colours, slope, scaled, weights)
    by_slope, by_F, step = rng.standard_normal(slope.shape), rng.standard_normal((3, 3)), 1e-4
    for s, m in ((1, 0), (0, 1), (1, 1), (1, -1)):
        ends = [colours.loss(slope + t * s * by_slope, scaled + t * m * by_F, weights) for t in (step, -step)]
        xx, xy, yy = information.W.T
        p, q = s * by_slope.T
        flat = m * by_F.ravel()
        form = (xx * p * p + 2 * xy * p * q + yy * q * q).sum() + flat @ information.H @ flat
        form += 2 * np.einsum("pd,pdk,k->", s * by_slope, information.cross, flat)
        assert sum(ends) / (2 * step**2) == pytest.approx(form, rel=1e-4)


@pytest.mark.parametrize("perspective", [False, True])
def test_weak_form(perspective):
    normals, inside = dome(40, elongation=1.2, bumps=0.2)
    rng = np.random.default_rng(0)
    ray = 0.1 * rng.standard_normal((2, int(inside.sum()))) if perspective else None
    turned = rotation_by(np.array([0.1, -0.05, 0.2])) @ normals[inside].T
    seen = weak_form._RotatedNormals(np.ascontiguousarray(turned), ray)
    functions = weak_form.test_functions(inside, radius=4.0, stencil="continuous")
    state = weak_form._State(np.eye(3), *seen.slopes(np.eye(3)))
    weights, width = rng.uniform(0.5, 2.0, functions.phi_x.shape[0]), 0.3
    parts = weak_form._cauchy(seen, functions, weights, width)
    now, _, g = parts["linearise"](state)
    assert now == pytest.approx(parts["loss"](state), rel=1e-12)
    for axis in np.eye(3):

        def loss(t: float, axis=axis) -> float:
            rotation = rotation_by(t * axis)
            return parts["loss"](weak_form._State(rotation, *seen.slopes(rotation)))

        # Slopes are tamed where a normal is edge on, which the derivative leaves out.
        assert 2 / width**2 * (g @ axis) == pytest.approx(along(loss), rel=2e-2, abs=2e-2 * np.linalg.norm(g))


def test_near_lights():
    """With the stiffness of depth; weights of Cauchy's loss."""
    rng = np.random.default_rng(0)
    _, mask = dome(16, cap=0.9)
    surface = near_lights._Surface(mask)
    told = KnownLights(np.array([[12.0, 4.0, 30.0], [-10.0, 6.0, 25.0]]), np.array([[0.0, -0.4, 0.9165]]))
    z = 3 * rng.random(surface.count)
    light = near_lights._Field(told, surface.points(z).mean(axis=0))
    c = rng.uniform(0.2, 1.0, (3, 3))
    state = near_lights._State(z, c, near_lights._View.of(surface, light, z))
    rho = state.view.shading @ c + 0.1 * rng.standard_normal((len(surface.x), 3))
    counts, scale = rng.random(len(rho)) < 0.8, 0.15
    e = state.residual(rho)
    weight = counts / (1 + (e**2).sum(axis=1) / scale**2)
    equations = near_lights._Equations(surface, z, state.view, c, e, weight)

    def loss(dz: np.ndarray, dc: np.ndarray) -> float:
        moved = state.moved(surface, light, dz, dc)
        return scale**2 * near_lights._cost(moved.residual(rho), counts, scale) + surface.bending(moved.z)

    by_z, by_c, still = rng.standard_normal(len(z)), rng.standard_normal((3, 3)), np.zeros_like(c)
    assert -2 * equations.g @ by_z == pytest.approx(along(lambda t: loss(t * by_z, still), 1e-6), rel=1e-4)
    change = along(lambda t: loss(0 * z, t * by_c), 1e-6)
    assert -2 * equations.h @ by_c.T.ravel() == pytest.approx(change, rel=1e-6)


def test_precision_of_tangents_is_the_inverse_of_their_covariance():
    """Residuals are (1, 0, p)·m and (0, 1, q)·m with m the mean of so many pixels' normals."""
    rng = np.random.default_rng(0)
    slope, count = rng.standard_normal((5, 2)), np.array([1, 2, 4, 9, 16])
    half = rng.standard_normal((5, 3, 3))
    noise = half @ half.swapaxes(1, 2)
    tangents = np.zeros((5, 2, 3))
    tangents[:, [0, 1], [0, 1]], tangents[..., 2] = 1.0, slope
    covariance = tangents @ noise @ tangents.swapaxes(1, 2) / count[:, None, None]
    np.testing.assert_allclose(tangents_module._precision(slope, noise, count), np.linalg.inv(covariance), rtol=1e-9)


@pytest.mark.parametrize("perspective", [False, True])
def test_change_of_tangents_by_a_stretch(perspective):
    rng = np.random.default_rng(0)
    slope = rng.standard_normal((5, 2))
    ray = 0.2 * rng.standard_normal((5, 2)) if perspective else None
    n = np.column_stack([-slope, np.ones(5)]) if ray is None else np.column_stack([-slope, 1 - (ray * slope).sum(1)])
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    rotation = rotation_by(np.array([0.3, -0.2, 0.5]))
    M = rotation @ (np.eye(3) + 0.05 * tangents_module.SYMMETRIC.sum(axis=0))
    N = n @ np.linalg.inv(M).T
    m3 = of_relief(n, ray)[:, 2]
    change = tangents_module._stretching(slope, m3, rotation, M, ray)
    for k, symmetric in enumerate(tangents_module.SYMMETRIC):

        def residual(t: float, symmetric=symmetric) -> np.ndarray:
            m = of_relief(N @ (M + t * rotation @ symmetric).T, ray)
            return m[:, :2] + slope * m[:, 2:]

        np.testing.assert_allclose(change[..., k], along(residual), atol=1e-8)


@pytest.mark.parametrize("width", [0.01, 1e6])
def test_albedos(width):
    """The slope of Cauchy's loss of the distances to the ellipsoid, by its six elements and the three albedos.

    Under a very wide loss, which is least squares, the curvature is JᵀJ of the distances.
    """
    rng = np.random.default_rng(0)
    n = rng.normal(size=(300, 3)) + np.array([0, 0, 2.0])
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    gathered = rng.uniform(0.05, 0.3, (300, 3))
    rgb = n @ F.T + 0.5 * gathered + 0.01 * rng.standard_normal((300, 3))
    z = elements_of(np.linalg.inv(F @ F.T))
    unit = np.abs(z) + 0.1
    x = np.concatenate([z / unit, [0.4, 0.5, 0.7]])

    def parts(x):
        return matrix_of(x[:6] * unit), x[6:]

    def distance(x):
        C, alpha = parts(x)
        return signed_distance(rgb - alpha * gathered, C)

    curvature, slope = albedo._normal_equations(rgb, gathered, *parts(x), unit, width)
    toward = np.eye(9)
    change = [
        along(lambda t, e=e: width**2 * albedo._loss(rgb, gathered, *parts(x + t * e), width), 1e-6) for e in toward
    ]
    np.testing.assert_allclose(slope, change, rtol=1e-5, atol=1e-6 * np.abs(slope).max())
    assert np.array_equal(curvature, curvature.T)
    if width > 1:
        J = np.stack([along(lambda t, e=e: distance(x + t * e), 1e-6) for e in toward], axis=-1)
        np.testing.assert_allclose(curvature, J.T @ J, rtol=1e-5, atol=1e-6 * np.abs(curvature).max())
