"""Whole methods on whole pictures: accuracy, invariance, uncertainty, and every named failure."""

import json
import re
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthesis import (
    DIRECTIONS,
    aligned_error,
    angles_deg,
    cast_shadows,
    dome,
    light_colours,
    median_error,
    mozart,
    needs_mozart,
    shade,
)
from test_recover_interreflection_removal import ALBEDO, picture

from huesphere.recover.methods.table import METHODS
from huesphere.recover.status import REMEDIES
from huesphere.recover.trust.verdict import judged
from huesphere.render.dataset import CameraInfo, Observation

pytestmark = pytest.mark.usefixtures("as_the_method_says")  # the verdict has tests of its own

WEAK, REPORT, LEAST = (METHODS[name] for name in ("weak-integrability", "drew-kontsevich", "least-squares"))
RED_GREEN_BLUE = np.array([[1.0, 0.1, 0.1], [0.1, 0.9, 0.1], [0.2, 0.1, 0.8], [0.7, 0.6, 0.1], [0.1, 0.5, 0.6]])


def relief(size: int = 96, **options) -> tuple[Observation, np.ndarray, np.ndarray]:
    """(observation, normals, F) of a dome with waves under five coloured lights."""
    normals, mask = dome(size, elongation=1.15, bumps=0.15, cap=0.75)
    observation, F = shade(normals, mask, RED_GREEN_BLUE, **options)
    return observation, normals, F


# ---- accuracy --------------------------------------------------------------------------------------------------------


@needs_mozart
@pytest.mark.parametrize(("shadows", "most"), [(False, 0.05), (True, 0.1)])
@pytest.mark.parametrize("lights", ["natural", "gels"])
def test_mozart_without_noise(lights, shadows, most):
    normals, mask, depth = mozart()
    hidden = cast_shadows(depth, mask, DIRECTIONS) if shadows else None
    observation, _ = shade(normals, mask, light_colours(lights), hidden=hidden)
    weak, report = WEAK(observation), REPORT(observation)
    assert weak.status == report.status == "ok"
    assert median_error(weak, normals) <= most  # measured: 0.001 to 0.004
    assert median_error(report, normals) <= 8.0  # "well under the report's 15.6°"; measured: 3.9 to 5.3
    assert weak.valid.sum() > 0.9 * mask.sum()
    assert aligned_error(report, normals) < 0.001
    robust = METHODS["robust"](observation)
    assert robust.status == "ok"
    assert median_error(robust, normals) < 0.15  # measured: 0.00 to 0.09


@needs_mozart
@pytest.mark.parametrize(("lights", "noise"), [("natural", 3e-4), ("natural", 1e-3), ("gels", 1e-3), ("gels", 3e-3)])
def test_mozart_under_noise_is_as_good_as_any_rotation_could_make_it(lights, noise):
    normals, mask, _ = mozart()
    observation, _ = shade(normals, mask, light_colours(lights), noise=noise)
    estimate = WEAK(observation)
    assert estimate.status == "ok"
    assert median_error(estimate, normals) <= 1.1 * aligned_error(estimate, normals)


def test_hemisphere_facing_the_camera_is_exact_in_closed_form():
    """Report 3.2, on a picture: lights fourfold around the camera, so that what all of them see is fourfold too."""
    normals, mask = dome(128, cap=0.999)
    ring = np.array([(0.2, 0, 1), (0, 0.2, 1), (-0.2, 0, 1), (0, -0.2, 1)]) / np.sqrt(1.04)
    observation, _ = shade(normals, mask, RED_GREEN_BLUE[:4], directions=ring)
    estimate = REPORT(observation)
    assert estimate.status == "ok"
    assert median_error(estimate, normals) < 0.5


def test_least_squares_is_pulled_by_outliers_where_lms_is_not():
    normals, mask = dome(128, bumps=0.2, cap=0.9)
    wide = DIRECTIONS * [2.0, 2.0, 1.0]
    wide /= np.linalg.norm(wide, axis=1, keepdims=True)
    observation, _ = shade(normals, mask, RED_GREEN_BLUE, directions=wide, noise=3e-4)
    assert aligned_error(WEAK(observation), normals) < 0.1
    assert aligned_error(LEAST(observation), normals) > 1.0


@pytest.mark.parametrize("order", [slice(None), slice(None, None, -1)])
def test_lights_in_either_order_around_the_object(order):
    """Reversed colours turn det F negative: the report's root is then a reflection away from the truth."""
    normals, mask = dome(96, elongation=1.15, bumps=0.15, cap=0.75)
    colours = RED_GREEN_BLUE[:3][order]
    observation, F = shade(normals, mask, colours, directions=DIRECTIONS[:3])
    estimate = WEAK(observation)
    assert median_error(estimate, normals) < 0.1
    assert estimate.diagnostics["reflection"] == (np.linalg.det(F) < 0)


def test_F_and_C_are_those_of_the_scene():
    observation, _, F = relief()
    estimate = WEAK(observation)
    assert np.array(estimate.diagnostics["F"]) == pytest.approx(F, abs=0.002)
    C = np.array(estimate.diagnostics["C"])
    assert pytest.approx(np.eye(3), abs=1e-3) == C @ F @ F.T


# ---- laws ------------------------------------------------------------------------------------------------------------


@settings(max_examples=8, deadline=None)
@given(st.floats(1e-3, 1e3), st.permutations(range(3)))
def test_normals_do_not_depend_on_exposure_or_channel_order(exposure, channels):
    observation, _, _ = relief(64, noise=5e-4)
    a = WEAK(observation)
    b = WEAK(replace(observation, rgb=(observation.rgb * np.float32(exposure))[..., channels]))
    assert a.status == b.status == "ok"
    both = a.valid & b.valid
    assert both.sum() > 0.99 * a.valid.sum()
    assert np.median(angles_deg(a.normals[both], b.normals[both])) < 0.05


def test_turning_the_picture_turns_the_normals():
    observation, _, _ = relief(noise=3e-4)
    a = WEAK(observation)
    b = WEAK(Observation(np.rot90(observation.rgb).copy(), np.rot90(observation.mask).copy(), observation.camera))
    turned = np.rot90(a.normals)[..., [1, 0, 2]] * [-1, 1, 1]
    both = np.rot90(a.valid) & b.valid
    assert np.median(angles_deg(turned[both], b.normals[both])) < 0.2


@pytest.mark.parametrize("method", METHODS)
def test_an_estimate_is_unit_normals_where_valid_and_nothing_elsewhere(method):
    observation, _, _ = relief(noise=1e-3)
    estimate = METHODS[method](observation)
    assert estimate.method == method
    length = np.linalg.norm(estimate.normals, axis=-1)
    assert length[estimate.valid] == pytest.approx(1, abs=1e-5)
    assert np.isnan(estimate.normals[~estimate.valid]).all()
    assert np.isnan(estimate.uncertainty_deg[~estimate.valid]).all()
    assert (estimate.uncertainty_deg[estimate.valid] > 0).all()
    assert not (estimate.valid & ~observation.mask).any()


@pytest.mark.parametrize("method", METHODS)
def test_diagnostics_are_plain_json(method):
    estimate = METHODS[method](relief()[0])
    text = json.dumps(estimate.diagnostics, allow_nan=False)
    if METHODS[method].name in FREE_BRIGHTNESS:  # no ellipsoid is fitted
        return
    for key in ("C", "F", "rotation", "reflection", "s0", "r2", "coefficients", "s_eigen", "r3_negative_share"):
        assert key in json.loads(text)
    assert set(estimate.diagnostics["twin"]) == {"flipped", "margin", "evidence"}
    curve = estimate.diagnostics["alpha_curve"]
    assert np.array(curve["value"]).shape == (2, len(curve["alpha_deg"]))


@pytest.mark.parametrize("noise", [3e-4, 2e-3])
def test_uncertainty_is_the_mean_error(noise):
    observation, normals, _ = relief(noise=noise)
    estimate = WEAK(observation)
    v = estimate.valid
    error = angles_deg(estimate.normals[v].astype(float), normals[v]).mean()
    assert estimate.uncertainty_deg[v].mean() == pytest.approx(error, rel=0.3)
    assert estimate.diagnostics["noise"]["sigma"] == pytest.approx(noise, rel=0.25)


def test_the_reports_own_bias_is_in_its_uncertainty():
    observation, normals, _ = relief()
    estimate = REPORT(observation)
    assert median_error(estimate, normals) < 2 * np.median(estimate.uncertainty_deg[estimate.valid]) + 0.1


def test_noise_that_the_camera_is_known_to_have_counts():
    observation, _, _ = relief()
    noisy = replace(observation, camera=CameraInfo(read_noise=0.01))
    assert np.nanmedian(WEAK(noisy).uncertainty_deg) > 10 * np.nanmedian(WEAK(observation).uncertainty_deg)


# ---- failures --------------------------------------------------------------------------------------------------------


def plane(rgb: np.ndarray, noise: float) -> np.ndarray:
    return np.broadcast_to(rgb, (64, 64, 3)) + noise * np.random.default_rng(0).standard_normal((64, 64, 3))


def degenerate(case: str, noise: float) -> tuple[Observation, tuple[str, ...]]:
    """A picture that determines no normals, and the statuses that say why."""
    normals, mask = dome(64, elongation=1.1, bumps=0.1, cap=0.75)
    rank = ("rank-deficient-colours",)
    if case == "coplanar lights":
        flat = np.array([(-0.6, 0, 1), (-0.2, 0, 1), (0.1, 0, 1), (0.4, 0, 1), (0.7, 0, 1)])
        flat /= np.linalg.norm(flat, axis=1, keepdims=True)
        return shade(normals, mask, RED_GREEN_BLUE, directions=flat, noise=noise)[0], rank
    if case == "one light":
        return shade(normals, mask, RED_GREEN_BLUE[:1], directions=DIRECTIONS[:1], noise=noise)[0], rank
    if case == "grey light":
        return shade(normals, mask, np.ones((5, 3)), noise=noise)[0], rank
    if case == "two lights":
        return shade(normals, mask, RED_GREEN_BLUE[:2], directions=DIRECTIONS[:2], noise=noise)[0], rank
    if case == "flat surface":
        rgb = plane(np.array([0.6, 0.5, 0.4]), noise)
        return Observation(rgb.astype(np.float32), np.ones((64, 64), bool)), ("flat-surface",)
    if case == "cylinder":
        x = np.linspace(-0.8, 0.8, 64)[None].repeat(64, axis=0)
        normals = np.stack([x, np.zeros_like(x), np.sqrt(1 - x * x)], axis=-1)
        return shade(normals, np.ones((64, 64), bool), RED_GREEN_BLUE, noise=noise)[0], rank
    if case == "cone":
        y, x = np.mgrid[1:-1:64j, -1:1:64j]
        normals = np.stack([x, y, 2 * np.hypot(x, y)], axis=-1) / np.hypot(x, y)[..., None] / np.sqrt(5)
        mask = (np.hypot(x, y) < 0.95) & (np.hypot(x, y) > 0.15)
        # Its colours lie on a plane curve: no ellipsoid is determined, and none has to be found.
        expected = ("ellipsoid-undetermined", "no-ellipsoid", "no-dominant-shell")
        return shade(normals, mask, RED_GREEN_BLUE, noise=noise)[0], expected
    if case == "noise":
        rgb = np.random.default_rng(0).uniform(0, 1, (64, 64, 3))
        expected = ("flat-surface", "rank-deficient-colours", "no-dominant-shell", "no-ellipsoid")
        return Observation(rgb.astype(np.float32), np.ones((64, 64), bool)), expected
    raise ValueError(case)


FREE_BRIGHTNESS = ("silhouette-matrix", "uniform-hue")
CASES = ("coplanar lights", "one light", "grey light", "two lights", "flat surface", "cylinder", "cone", "noise")


@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("method", METHODS)
def test_degenerate_pictures_have_a_named_status(method, case, noise):
    observation, expected = degenerate(case, noise)
    estimate = METHODS[method](observation)
    if method in FREE_BRIGHTNESS:  # they do not see that colours of a cone lie in a plane, and are never trusted
        expected = (*expected, "no-silhouette", *(("ok",) if case == "cone" else ()))
        if case == "cone":
            assert judged(estimate, observation).verdict == "doubtful"
            return
    assert estimate.status in expected
    assert estimate.message.endswith(REMEDIES[estimate.status])
    assert "\n" not in estimate.message


def test_an_empty_mask_and_a_small_one_have_too_few_pixels():
    observation, _, _ = relief()
    for count in (0, 49):
        mask = np.zeros_like(observation.mask)
        mask.ravel()[np.flatnonzero(observation.mask)[:count]] = True
        estimate = WEAK(replace(observation, mask=mask))
        assert estimate.status == "too-few-pixels"
        assert str(count) in estimate.message
        assert not estimate.valid.any()


def test_pixels_that_are_not_finite_are_left_out():
    observation, normals, _ = relief()
    rgb = observation.rgb.copy()
    rgb[40:50, 40:50] = np.nan
    rgb[60, 60, 1] = np.inf
    estimate = WEAK(replace(observation, rgb=rgb))
    assert estimate.status == "ok"
    assert not estimate.valid[40:50, 40:50].any()
    assert median_error(estimate, normals) < 0.1
    assert WEAK(replace(observation, rgb=np.full_like(rgb, np.nan))).status == "not-finite"


def test_saturated_pixels_are_left_out():
    observation, normals, _ = relief()
    clipped = np.minimum(observation.rgb, 0.86)
    estimate = WEAK(replace(observation, rgb=clipped, camera=CameraInfo(saturation=0.86)))
    assert estimate.status == "ok"
    assert estimate.diagnostics["pixels"]["saturated"] > 100
    assert not (estimate.valid & (clipped >= np.float32(0.86)).any(axis=-1)).any()
    assert median_error(estimate, normals) < 0.3
    white = np.ones_like(clipped)
    assert WEAK(replace(observation, rgb=white, camera=CameraInfo(saturation=1.0))).status == "saturated"


def test_display_encoded_pictures_are_decoded():
    observation, normals, _ = relief()
    x = observation.rgb
    encoded = np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 0) ** (1 / 2.4) - 0.055).astype(np.float32)
    right = WEAK(replace(observation, rgb=encoded, camera=CameraInfo(encoding="srgb")))
    assert median_error(right, normals) < 0.1


def test_lone_pixels_are_too_scattered():
    observation, _, _ = relief()
    mask = observation.mask.copy()
    mask[::2] = False
    mask[:, ::2] = False
    for method in METHODS.values():
        assert method(replace(observation, mask=mask)).status in ("too-scattered", "no-dominant-shell", "singular")


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    kind=st.sampled_from(["uniform", "constant", "huge", "tiny", "negative", "binary", "nan"]),
    height=st.integers(1, 24),
    width=st.integers(1, 24),
)
def test_no_picture_makes_a_method_raise(seed, kind, height, width):
    rng = np.random.default_rng(seed)
    rgb = rng.uniform(0, 1, (height, width, 3))
    if kind == "constant":
        rgb[:] = rng.uniform(0, 1, 3)
    elif kind in ("huge", "tiny"):
        rgb *= 1e30 if kind == "huge" else 1e-30
    elif kind == "negative":
        rgb -= 0.5
    elif kind == "binary":
        rgb = np.round(rgb)
    elif kind == "nan":
        rgb[rng.uniform(size=(height, width)) < 0.3] = np.nan
    observation = Observation(rgb.astype(np.float32), rng.uniform(size=(height, width)) < 0.9)
    for method in METHODS.values():
        estimate = method(observation)
        assert estimate.status == "ok" or estimate.status in REMEDIES


def test_recovery_never_imports_mitsuba():
    code = "import sys, huesphere.recover.run; sys.exit(bool({'mitsuba', 'drjit'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


DOCUMENT = Path(__file__).parents[1] / "docs" / "recover" / "diagnostics.md"


def documented() -> dict[str, set[str]]:
    """Of each diagnostics key with a row in docs/recover/diagnostics.md, what stands there in code type."""
    section = DOCUMENT.read_text(encoding="utf-8").split("## Keys")[1]
    rows = [line.strip("| ").split(" | ", 1) for line in section.splitlines() if line.startswith("| `")]
    return {key: set(re.findall("`([^`]+)`", what)) for keys, what in rows for key in re.findall("`([^`]+)`", keys)}


@cache
def diagnosed(method: str) -> dict[str, object]:
    if method == "unbounce":  # which takes nothing out of a picture without light between its parts
        return METHODS[method](picture(ALBEDO)[0]).diagnostics
    return METHODS[method](relief(56, noise=1e-3)[0]).diagnostics


@pytest.mark.parametrize("method", METHODS)
def test_every_key_of_the_diagnostics_is_documented(method):
    rows = documented()
    for key, value in diagnosed(method).items():
        assert key in rows
        parts = value[0] if isinstance(value, list) and value and isinstance(value[0], dict) else value
        if isinstance(parts, dict):
            assert set(parts) <= rows[key], f"of {key}"


def test_no_key_is_documented_that_is_not_there():
    # Of pictures under wide lights, of those whose header tells of near ones, of noisy ones in doubt, of judged and of
    # large ones.
    elsewhere = {"irradiance", "near", "whole_picture", "trust", "reduction"}
    written = {key for method in METHODS for key in diagnosed(method)} | elsewhere
    assert set(documented()) == written
