"""What must not matter: the order of pixels and channels, exposure, the channels' units, which way up the picture is.

Each law is checked on what the method takes its decisions from; where rounding may move single pixels across a cut,
normals are compared where both are valid and these have to be nearly all.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from synthesis import angles_deg, dome, median_error, shade
from test_recover_ellipsoid_fit import colours
from test_recover_methods import RED_GREEN_BLUE

from huesphere.recover.ellipsoid.fit import fit_accepted, least_squares, reweighted, whitening
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.methods.table import METHODS
from huesphere.render.dataset import CameraInfo, Observation
from huesphere.scenes.encoding import encode_srgb

pytestmark = pytest.mark.usefixtures("as_the_method_says")  # the verdict has tests of its own

SIMPLE = ("least-squares", "drew-kontsevich", "weak-integrability")
SLOWER = ("drew-kontsevich-ambient", "alternation", "robust")  # one example each
# Whole methods take a tenth of a second: few examples, and none spent on making a failing one smaller.
FEW = settings(max_examples=2, deadline=None, phases=(Phase.explicit, Phase.generate))

exposures = st.floats(1e-3, 1e3)
orders = st.permutations(range(3))
units = st.tuples(*[st.floats(0.2, 5.0)] * 3)


@cache
def relief(noise: float = 5e-4, *, size: int = 56, camera: CameraInfo | None = None) -> tuple[Observation, np.ndarray]:
    normals, mask = dome(size, elongation=1.15, bumps=0.15, cap=0.75)
    return shade(normals, mask, RED_GREEN_BLUE, noise=noise, camera=camera)[0], normals


@cache
def unchanged(method: str, camera: CameraInfo | None = None) -> Estimate:
    return METHODS[method](relief(camera=camera)[0])


def apart(a: Estimate, b: Estimate, *, share: float = 0.98) -> float:
    """Median angle in degrees between the normals of two estimates, of which a ``share`` has to be valid in both."""
    assert (a.status, b.status) == ("ok", "ok")
    both = a.valid & b.valid
    assert both.sum() > share * max(a.valid.sum(), b.valid.sum())
    return float(np.median(angles_deg(a.normals[both], b.normals[both])))


# ---- the fit ---------------------------------------------------------------------------------------------------------


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 1000), noise=st.sampled_from([0.0, 1e-3, 1e-2]))
def test_least_squares_does_not_depend_on_pixel_order(seed, noise):
    rho = colours(900, noise=noise, seed=seed % 7)
    order = np.random.default_rng(seed).permutation(len(rho))
    assert least_squares(rho[order]) == pytest.approx(least_squares(rho), rel=1e-9, abs=1e-9)


@settings(max_examples=12, deadline=None)
@given(exposure=exposures, channels=orders, balance=units)
def test_a_fit_and_what_is_known_of_it_follow_units_and_channels(exposure, channels, balance):
    """C turns into D C D with D the inverse units; residuals, s0, R², and each |t| stay, signs and places aside."""
    rho = colours(900, noise=5e-3)
    scale = exposure * np.array(balance)
    a = reweighted(rho, least_squares(rho))
    changed = (rho * scale)[:, channels]
    b = reweighted(changed, least_squares(changed))
    back = np.diag(scale[list(channels)])
    assert back @ b.C @ back == pytest.approx(a.C[np.ix_(channels, channels)], rel=1e-6, abs=1e-6)
    assert np.array_equal(a.accepted, b.accepted)
    assert b.residual == pytest.approx(a.residual, abs=1e-7)
    assert (b.s0, b.r2) == pytest.approx((a.s0, a.r2), rel=1e-6)
    t = [sorted(abs(float(c["t"])) for c in fit.coefficients) for fit in (a, b)]
    assert t[1] == pytest.approx(t[0], rel=1e-5)


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 1000))
def test_any_invertible_mixture_of_channels_changes_only_C(seed):
    """Nor does it matter whether a camera's matrix came first: C turns into B⁻ᵀ C B⁻¹."""
    B = np.eye(3) + 0.6 * np.random.default_rng(seed).uniform(-1, 1, (3, 3))
    rho = colours(900, noise=5e-3)
    a, b = least_squares(rho), least_squares(rho @ B.T)
    assert B.T @ b @ B == pytest.approx(a, rel=1e-6, abs=1e-6 * np.abs(a).max())
    turn = whitening(rho @ B.T) @ B @ np.linalg.inv(whitening(rho))  # whitened colours are turned, no more
    assert turn @ turn.T == pytest.approx(np.eye(3), abs=1e-6)


@settings(max_examples=15, deadline=None)
@given(exposure=exposures)
def test_taking_out_noise_scales_with_the_noise(exposure):
    rho = colours(900, noise=0.02)
    everything = np.ones(len(rho), bool)
    a = fit_accepted(rho, everything, noise=0.02).C
    b = fit_accepted(rho * exposure, everything, noise=0.02 * exposure).C
    assert b * exposure**2 == pytest.approx(a, rel=1e-6, abs=1e-6)


# ---- whole methods ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", SIMPLE)
@FEW
@given(exposure=exposures, known=st.booleans())
def test_normals_do_not_depend_on_exposure(method, exposure, known):
    """Read noise, where the camera is known to have it, is scaled alike: it is the ratio that counts."""
    camera = CameraInfo(read_noise=5e-4) if known else CameraInfo()
    a, (observation, _) = unchanged(method, camera), relief(camera=camera)
    camera = replace(camera, read_noise=camera.read_noise * exposure)
    b = METHODS[method](replace(observation, rgb=observation.rgb * np.float32(exposure), camera=camera))
    assert apart(a, b) < 0.05
    both = a.valid & b.valid
    assert np.median(b.uncertainty_deg[both] / a.uncertainty_deg[both]) == pytest.approx(1, rel=0.05)


@pytest.mark.parametrize("method", SIMPLE)
@FEW
@given(channels=orders)
def test_normals_do_not_depend_on_channel_order(method, channels):
    observation, _ = relief()
    changed = np.ascontiguousarray(observation.rgb[..., channels])
    assert apart(unchanged(method), METHODS[method](replace(observation, rgb=changed))) < 0.05


@pytest.mark.parametrize("method", SIMPLE)
@FEW
@given(balance=units)
def test_normals_do_not_depend_on_the_channels_units(method, balance):
    """Without noise: it is taken to be the same in all channels, which no two systems of units can both have.

    For the same reason which pixels are sure enough to be valid may differ by some.
    """
    observation, _ = relief(noise=0.0)
    changed = observation.rgb * np.array(balance, np.float32)
    a, b = (METHODS[method](replace(observation, rgb=rgb)) for rgb in (observation.rgb, changed))
    assert apart(a, b, share=0.75) < 0.1


@pytest.mark.parametrize("method", SLOWER)
def test_normals_of_slower_methods_depend_on_neither(method):
    observation, _ = relief(noise=3e-4, size=40)
    a = METHODS[method](observation)
    b = METHODS[method](replace(observation, rgb=np.ascontiguousarray(37 * observation.rgb[..., [2, 0, 1]])))
    assert apart(a, b) < 0.2  # their optimisers stop where progress is small, not at a point


FLIPS = {  # of the picture's axes, and what x and y of a normal become
    "left to right": (lambda image: image[:, ::-1], [-1, 1, 1]),
    "upside down": (lambda image: image[::-1], [1, -1, 1]),
    "half a turn": (lambda image: image[::-1, ::-1], [-1, -1, 1]),
}


@pytest.mark.parametrize("flip", FLIPS)
@pytest.mark.parametrize("method", SIMPLE)
def test_normals_are_flipped_with_the_picture(method, flip):
    image, signs = FLIPS[flip]
    observation, _ = relief()
    rgb, mask = (np.ascontiguousarray(image(x)) for x in (observation.rgb, observation.mask))
    a, b = unchanged(method), METHODS[method](Observation(rgb, mask, observation.camera))
    turned = replace(a, normals=image(a.normals) * signs, valid=image(a.valid))
    assert apart(turned, b) < 0.1


# ---- display-encoded pictures ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", SIMPLE)
def test_eight_display_encoded_bits_are_as_good_as_eight_linear_ones(method):
    """What a phone writes, decoded before any fit; the last line says what it would cost to forget that."""
    observation, normals = relief(noise=0.0, size=96)
    levels = {
        "linear": np.round(np.clip(observation.rgb, 0, 1) * 255) / 255,
        "srgb": np.round(encode_srgb(np.clip(observation.rgb, 0, 1)) * 255) / 255,
    }
    pictures = {
        name: Observation(values.astype(np.float32), observation.mask, CameraInfo(encoding=name, bits=8, saturation=1))
        for name, values in levels.items()
    }
    linear, display = (METHODS[method](pictures[name]) for name in ("linear", "srgb"))
    forgotten = METHODS[method](replace(pictures["srgb"], camera=pictures["linear"].camera))
    assert apart(linear, display, share=0.9) < 2.5
    assert median_error(display, normals) < median_error(linear, normals) + 0.3
    assert median_error(forgotten, normals) > 2.5 + median_error(display, normals)
