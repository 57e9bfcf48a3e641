"""The Python interface: `import huesphere as hs`, its examples, and what it says to input that cannot be meant."""

import doctest
import subprocess
import sys
from importlib import import_module

import numpy as np
import pytest
from synthesis import angles_deg, dome, median_error, shade

import huesphere as hs
from huesphere.scenes.encoding import encode_srgb

COLOURS = np.array([(1, 0.2, 0.1), (0.1, 1, 0.2), (0.2, 0.1, 1), (0.8, 0.7, 0.1), (0.1, 0.6, 0.9)])


@pytest.fixture(scope="module")
def scene() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(picture, mask, normals) of a bumpy dome under five coloured lights."""
    normals, mask = dome(72, bumps=0.15, elongation=1.15, cap=0.8)
    observation, _ = shade(normals, mask, COLOURS)
    return observation.rgb, mask, normals


@pytest.mark.parametrize("module", ["huesphere", *(f"huesphere.{name}" for name in hs._WHERE.values())])
def test_the_examples_of_the_docstrings_run(module):
    found = doctest.testmod(import_module(module))
    assert found.failed == 0


def test_there_are_examples_of_every_function():
    functions = [hs.recover_normals, hs.integrate, hs.render_scene, hs.score]
    assert all(">>>" in function.__doc__ for function in functions)


def test_importing_it_loads_nothing_heavy():
    code = "import sys, huesphere; print([m for m in sys.modules if m in ('numpy', 'scipy', 'numba', 'mitsuba')])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_public_name_is_there_and_no_other():
    assert all(getattr(hs, name) is not None for name in hs.__all__)
    assert set(hs.__all__) == set(hs._WHERE)
    assert hs.__version__
    with pytest.raises(AttributeError, match="no attribute 'recover_normal'"):
        hs.recover_normal  # noqa: B018


def test_arrays_in_estimate_out(scene):
    rgb, mask, normals = scene
    estimate = hs.recover_normals(rgb, mask=mask)
    assert (estimate.method, estimate.status) == ("auto", "ok")
    assert median_error(estimate, normals) < 0.5
    assert estimate.solution.F.shape == (3, 3)
    assert np.nanmean(estimate.depth[mask]) == pytest.approx(0, abs=1e-3)
    assert "auto, ok" in repr(estimate)
    assert len(repr(estimate)) < 120
    assert estimate._repr_png_().startswith(b"\x89PNG")


def test_normals_do_not_depend_on_scale_or_on_how_samples_are_stored(scene):
    rgb, mask, _ = scene
    by = {
        "linear": hs.recover_normals(rgb, mask, "weak-integrability"),
        "brighter": hs.recover_normals(7 * rgb.astype(float), 255 * mask.astype(np.uint8), "weak-integrability"),
        "display": hs.recover_normals(encode_srgb(rgb), mask.astype(float), "weak-integrability", encoding="srgb"),
    }
    for name in ("brighter", "display"):
        both = by[name].valid & by["linear"].valid
        assert np.median(angles_deg(by[name].normals[both], by["linear"].normals[both])) < 1e-2, name
    bytes_ = np.round(255 * encode_srgb(np.clip(rgb, 0, 1))).astype(np.uint8)
    eight_bits = hs.recover_normals(bytes_, mask, "weak-integrability", encoding="srgb")
    assert eight_bits.verdict != "failed"
    both = eight_bits.valid & by["linear"].valid
    assert np.median(angles_deg(eight_bits.normals[both], by["linear"].normals[both])) < 3


def test_normals_of_a_picture_in_perspective_have_a_depth(scene):
    rgb, mask, _ = scene
    near, far = (hs.recover_normals(rgb, mask, "weak-integrability", focal_px=f) for f in (120.0, 1e6))
    flat = hs.recover_normals(rgb, mask, "weak-integrability")
    both = far.valid & flat.valid
    assert np.median(angles_deg(far.normals[both], flat.normals[both])) < 0.1
    assert np.isfinite(near.depth[mask]).all()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"rgb": np.zeros((8, 8))}, r"rgb, got an array of shape \(8, 8\), expected \(height, width, 3\)"),
        ({"rgb": np.zeros((0, 8, 3))}, "rgb, got an array of shape"),
        ({"rgb": np.full((8, 8, 3), "x")}, "rgb, got an array of <U1, expected numbers"),
        ({"rgb": np.zeros((8, 8, 3), np.uint8)}, "encoding, got none for samples of uint8"),
        ({"rgb": np.zeros((8, 8, 3), np.int64)}, "samples of int64"),
        ({"rgb": np.full((8, 8, 3), np.nan)}, "no finite value"),
        ({"mask": np.ones((4, 4), bool)}, r"mask, got an array of shape \(4, 4\), expected \(8, 8\)"),
        ({"mask": np.zeros((8, 8), bool)}, "no pixel of the object"),
        ({"method": "atuo"}, "'auto' \\(did you mean it\\?\\)"),
        ({"encoding": "gamma"}, "encoding, got gamma, expected linear or srgb"),
        ({"focal_px": -3}, "focal_px, got -3, expected a positive number"),
    ],
)
def test_what_cannot_be_meant_gets_one_line(change, said):
    arguments = {"rgb": np.full((8, 8, 3), 0.5), **change}
    with pytest.raises(hs.InputError, match=said) as caught:
        hs.recover_normals(**arguments)
    assert "\n" not in str(caught.value)


def test_a_failure_is_a_status_and_not_an_exception():
    estimate = hs.recover_normals(np.full((16, 16, 3), 0.5), method="drew-kontsevich")
    assert estimate.status == "flat-surface"
    assert not estimate.valid.any()
    assert estimate.solution is None


def test_scores_are_those_of_the_evaluator(scene):
    rgb, mask, normals = scene
    estimate = hs.recover_normals(rgb, mask, "weak-integrability")
    found = hs.score(estimate.normals, normals, mask=mask)
    assert found.median_deg == pytest.approx(median_error(estimate, normals), abs=1e-4)
    assert found.coverage == pytest.approx(estimate.valid.sum() / mask.sum())
    with pytest.raises(hs.InputError, match="shapes"):
        hs.score(estimate.normals, normals[:5])


def test_render_open_relight_and_score(tmp_path):
    small = {"camera.resolution": [48, 48], "render.transport": ["direct"], "camera.read_noise": 1e-4}
    (item,) = hs.render_scene("sphere_quick", small, out=str(tmp_path / "run"))
    assert item.config().camera.read_noise == 1e-4
    assert [one.id for one in hs.open_run(str(tmp_path / "run"))] == [item.id]
    observation, truth = item.observation(), item.truth()
    estimate = hs.recover_normals(observation.rgb, observation.mask, "weak-integrability")
    assert hs.score(estimate.normals, truth.normals).median_deg < 5
    dark = hs.relight(item, ["lights.0.intensity=0"])
    assert dark.rgb.shape == observation.rgb.shape
    with pytest.raises(hs.InputError, match=r"camera\.read_nois"):
        hs.render_scene("sphere_quick", {"camera.read_nois": 1}, out=tmp_path / "other")
    assert not (tmp_path / "other").exists()


def test_integrate_is_the_inverse_of_differentiation():
    y, x = np.mgrid[:40, :50].astype(float)
    depth = 4 * np.sin(x / 9) * np.cos(y / 11)
    p, q = 4 / 9 * np.cos(x / 9) * np.cos(y / 11), 4 / 11 * np.sin(x / 9) * np.sin(y / 11)
    normals = np.dstack([-p, -q, np.ones_like(p)])
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    found = hs.integrate(normals)
    assert found == pytest.approx(depth - depth.mean(), abs=0.02)
    with pytest.raises(hs.InputError, match="none that is finite"):
        hs.integrate(np.full((4, 4, 3), np.nan))
