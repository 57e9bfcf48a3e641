"""The metrics on cases worked by hand."""

import numpy as np
import pytest
from test_eval_fabricated_run import COLOURS, LIGHTS, bump, rotation

from huesphere.eval import metrics
from huesphere.eval.align import TWIN
from huesphere.eval.metrics import Row


def measured(turn: np.ndarray, truth: np.ndarray, *, declined: int = 0) -> Row:
    """The row of the estimate ``turn`` times truth, (N, 3); the first ``declined`` pixels are given up."""
    normals = (truth @ turn.T)[None]
    mask, valid = np.ones((1, len(truth)), bool), np.ones((1, len(truth)), bool)
    valid[0, :declined] = False
    error = metrics.error_image(normals, valid, truth[None], mask)
    stated = np.where(valid, 2.0, np.nan)
    return metrics.measure(Row("c", "linear", "m", "ok"), error, normals, truth[None], mask, valid, stated)


def ring(count: int = 360) -> np.ndarray:
    """Unit vectors around the horizon: a turn about z moves each of them by the whole angle."""
    a = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return np.stack([np.cos(a), np.sin(a), np.zeros(count)], axis=-1)


def cap(count: int = 400) -> np.ndarray:
    _, normals, mask = bump(64)
    return normals[mask][:: mask.sum() // count]


@pytest.mark.parametrize("degrees", [1e-6, 1e-3, 0.01, 10.0, 90.0, 179.9, 180.0 - 1e-6])
def test_an_angle_keeps_its_digits_near_0_and_180(degrees: float):
    a = np.radians(degrees)
    got = metrics.angular_error_deg(np.array([np.cos(a), np.sin(a), 0.0]), np.array([1.0, 0.0, 0.0]))
    assert got == pytest.approx(degrees, rel=1e-9)


def test_equal_single_precision_normals_have_no_error_that_arccos_would_show():
    n = cap().astype(np.float32)
    assert metrics.angular_error_deg(n, n).max() == 0.0
    dots = np.einsum("ni,ni->n", n, n)
    assert np.degrees(np.arccos(np.clip(dots, -1, 1))).max() > 0.005  # what the usual formula says


def test_an_angle_does_not_depend_on_length():
    a, b = np.array([3.0, 0.0, 0.0]), np.array([0.0, 1e-20, 0.0])
    assert metrics.angular_error_deg(a, b) == pytest.approx(90.0)


@pytest.mark.parametrize("nothing", [[0.0, 0.0, 0.0], [np.nan, 0.0, 1.0], [np.inf, 0.0, 1.0]])
def test_what_has_no_direction_has_no_error(nothing: list[float]):
    assert np.isnan(metrics.angular_error_deg(np.array(nothing), np.array([0.0, 0.0, 1.0])))


def test_a_turn_by_10_degrees_about_z_on_the_horizon_is_10_degrees_in_every_statistic():
    row = measured(rotation("z", 10), ring())
    for name in ("mean_deg", "median_deg", "p90_deg", "p95_deg", "rms_deg"):
        assert getattr(row, name) == pytest.approx(10.0, abs=1e-9), name
    assert (row.within_1, row.within_5, row.within_11_25, row.within_22_5, row.within_30) == (0, 0, 1, 1, 1)


def test_a_turn_about_z_is_less_than_its_angle_away_from_the_horizon():
    # n at 60 degrees from z turned by 10 about z: the chord shrinks by sin 60.
    n = np.array([[np.sin(np.pi / 3), 0.0, 0.5]])
    expected = 2 * np.degrees(np.arcsin(np.sin(np.pi / 3) * np.sin(np.radians(5.0))))
    assert measured(rotation("z", 10), n).median_deg == pytest.approx(expected)


def test_gauge_takes_any_rotation_and_mirror_out():
    row = measured(rotation("y", 33) @ rotation("z", 10) @ np.diag([1.0, -1.0, 1.0]), cap())
    assert row.median_deg > 5
    assert row.median_deg_gauge < 1e-9


def test_flip_takes_the_better_of_the_twins():
    twin, straight = measured(TWIN, cap()), measured(np.eye(3), cap())
    assert twin.median_deg > 10
    assert (twin.median_deg_flip, straight.median_deg_flip) == (pytest.approx(0, abs=1e-9), pytest.approx(0, abs=1e-9))


def test_half_declined_is_half_coverage_and_never_an_error_of_0():
    row = measured(rotation("z", 10), ring(100), declined=50)
    assert (row.pixels, row.scored, row.coverage) == (100, 50, 0.5)
    assert row.mean_deg == pytest.approx(10.0)
    assert row.stated_median_deg == 2.0


def test_nothing_scored_is_nan_in_every_error():
    row = measured(np.eye(3), ring(100), declined=100)
    assert (row.scored, row.coverage) == (0, 0.0)
    errors = [name for name in metrics.COLUMNS if name.endswith("_deg") or name.startswith(("within", "median"))]
    assert all(np.isnan(getattr(row, name)) for name in errors)
    assert len(errors) > 10


def test_percentiles_and_shares_of_a_ramp():
    columns = metrics.error_columns(np.arange(0.5, 100.0, 1.0))  # 0.5, 1.5 … 99.5
    assert columns["median_deg"] == 50.0
    assert columns["p90_deg"] == pytest.approx(0.5 + 0.9 * 99)
    assert (columns["within_1"], columns["within_5"], columns["within_30"]) == (0.01, 0.05, 0.30)


def linear_colours(normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    towards = LIGHTS / np.linalg.norm(LIGHTS, axis=1, keepdims=True)
    F = COLOURS.T @ towards
    return normals @ F.T, F


def test_the_floor_of_colours_that_are_linear_in_the_normal_is_0():
    colours, F = linear_colours(cap())
    G, floor = metrics.linear_floor(colours, cap())
    assert floor < 1e-6
    np.testing.assert_allclose(G / np.linalg.norm(G), np.linalg.inv(F) / np.linalg.norm(np.linalg.inv(F)), atol=1e-6)


def test_the_floor_is_0_though_a_fifth_of_the_pixels_miss_a_light():
    # Least squares alone would end several degrees up: the pixels in shadow pull at it.
    rng = np.random.default_rng(3)
    n = cap()
    colours, _ = linear_colours(n)
    hidden = rng.random(len(n)) < 0.2
    colours[hidden] -= np.outer(n[hidden] @ (LIGHTS[0] / np.linalg.norm(LIGHTS[0])), COLOURS[0])
    G, *_ = np.linalg.lstsq(colours, n, rcond=None)
    assert np.median(metrics.angular_error_deg(colours @ G, n)) > 1.0
    assert metrics.linear_floor(colours, n)[1] < 1e-4


@pytest.mark.parametrize("noise", [1e-3, 1e-2])
def test_the_floor_is_not_above_the_true_matrix_under_noise(noise: float):
    colours, F = linear_colours(cap())
    noisy = colours + noise * np.random.default_rng(1).normal(size=colours.shape)
    true = np.median(metrics.angular_error_deg(noisy @ np.linalg.inv(F).T, cap()))
    assert metrics.linear_floor(noisy, cap())[1] <= 1.02 * true


def test_the_floor_is_the_same_each_time():
    colours = np.random.default_rng(0).random(cap().shape)
    assert metrics.linear_floor(colours, cap())[1] == metrics.linear_floor(colours, cap())[1]


def test_the_floor_stands_black_pixels_and_colours_on_one_line():
    n = cap()
    grey = np.outer(np.maximum(n[:, 0], 0.0), [1.0, 1.0, 1.0])
    _, floor = metrics.linear_floor(grey, n)
    assert 1.0 < floor <= 180.0


def test_the_condition_of_a_fitted_matrix_is_that_of_the_true_one_despite_shadows():
    n = cap()
    colours, F = linear_colours(n)
    colours[:100] *= 0.3
    assert metrics.colour_condition(metrics.fit_colour_matrix(colours, n)) == pytest.approx(np.linalg.cond(F), rel=1e-6)
