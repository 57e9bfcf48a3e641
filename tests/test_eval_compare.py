"""Factors of a run, methods in pairs, and the figures across configs."""

import itertools
from pathlib import Path

import numpy as np
import pytest
import yaml
from test_eval_fabricated_run import fabricate_run, rotation

from huesphere.eval.compare import LEAST_SCENES, Comparison, Pair, compare, pairs
from huesphere.eval.factor_figures import comparison_panel
from huesphere.eval.factors import read_factors
from huesphere.eval.report import write_report
from huesphere.eval.score import Item, read_items, read_scene, score_case


def made(folder: Path, *configs: dict[str, object]) -> list[Item]:
    items = []
    for number, config in enumerate(configs):
        where = folder / str(number)
        where.mkdir()
        (where / "config.yaml").write_text(yaml.safe_dump(config, sort_keys=False))
        items.append(Item(f"c{number}", "full", "done", where, ()))
    return items


# --- factors ----------------------------------------------------------------------------------------------------------


def test_a_factor_is_a_key_whose_values_differ_and_numbers_are_in_order(tmp_path: Path):
    noise = [1e-2, 0, 1e-3]
    items = made(tmp_path, *({"name": f"n{n}", "camera": {"read_noise": n, "seed": i}} for i, n in enumerate(noise)))
    (factor,) = read_factors(items)
    assert (factor.key, factor.numeric, factor.levels) == ("camera.read_noise", True, [0.0, 1e-3, 1e-2])
    assert factor.values["c0/full"] == 1e-2


def test_keys_that_vary_together_are_one_factor(tmp_path: Path):
    shapes = [("sphere", 1), ("bust", 2), ("sphere", 1)]
    items = made(tmp_path, *({"shape": {"kind": kind, "detail": d}, "lights": []} for kind, d in shapes))
    assert [f.key for f in read_factors(items)] == ["shape.kind"]


def test_lights_are_compared_one_by_one_and_a_direction_is_one_value(tmp_path: Path):
    def config(x: float, spectrum: object) -> dict[str, object]:
        return {"lights": [{"direction": [0, 0, 1], "spectrum": "A"}, {"direction": [x, 0, 1], "spectrum": spectrum}]}

    items = made(tmp_path, config(0.5, "B"), config(0.25, "B"), config(0.5, 7))
    found = {f.key: f for f in read_factors(items)}
    assert list(found) == ["lights.1.direction", "lights.1.spectrum"]
    assert found["lights.1.direction"].levels == ["0.5 0 1", "0.25 0 1"]
    assert not found["lights.1.spectrum"].numeric


def test_transport_is_a_factor_and_a_damaged_config_takes_none_from_the_others(tmp_path: Path):
    items = made(tmp_path, {"a": 1}, {"a": 1})
    linear = Item("c0", "linear", "done", items[0].folder, ())
    (items[1].folder / "config.yaml").write_text("{")
    (factor,) = read_factors([items[0], linear, items[1]])
    assert (factor.key, dict(factor.values)) == ("transport", {"c0/full": "full", "c0/linear": "linear"})


# --- pairs ------------------------------------------------------------------------------------------------------------


def ratios(values: list[float], scenes: list[str] | None = None) -> list[Pair]:
    names = scenes or [f"scene{n}" for n in range(len(values))]
    return [Pair(name, "full", "a", "b", value, 1.0, 100) for name, value in zip(names, values, strict=True)]


def test_the_ratio_is_the_geometric_mean_and_a_constant_ratio_has_no_spread():
    (one,) = compare(ratios([0.5, 2.0, 0.5, 0.5, 2.0, 0.25]))
    assert one.ratio == pytest.approx((0.5**3 * 2**2 * 0.25) ** (1 / 6))
    assert one.first_better == pytest.approx(4 / 6)
    (steady,) = compare(ratios([0.5] * 6))
    assert (steady.low, steady.high) == pytest.approx((0.5, 0.5))
    assert steady.decided


def test_the_interval_is_that_of_the_normal_law_where_scenes_are_many():
    logs = np.random.default_rng(3).normal(0.2, 0.5, 400)
    (one,) = compare(ratios(list(np.exp(logs))))
    half = 1.96 * logs.std() / 20  # standard error of a mean over 400 scenes
    assert np.log([one.low, one.high]) == pytest.approx([logs.mean() - half, logs.mean() + half], abs=0.15 * half)


def test_the_interval_covers_the_truth_about_as_often_as_it_says():
    rng = np.random.default_rng(5)
    runs = [compare(ratios(list(np.exp(rng.normal(0.0, 1.0, 30)))), seed=n)[0] for n in range(200)]
    covered = np.mean([one.low <= 1.0 <= one.high for one in runs])
    assert 0.88 <= covered <= 0.98  # 0.95 less what 30 scenes cost a percentile interval


def test_pictures_of_one_scene_are_no_independent_trials():
    values, names = [0.5, 0.5, 0.5, 2.0, 1.0, 1.0], ["s", "s", "s", "t", "u", "v"]
    (one,) = compare(ratios(values, names))
    assert one.scenes == 4
    assert one.ratio == pytest.approx(1.0)  # s counts once
    assert np.isnan(one.low)  # and four scenes are too few for an interval
    assert LEAST_SCENES == 5
    assert not one.decided


def test_a_pair_is_judged_on_the_pixels_that_both_give(tmp_path: Path):
    from test_eval_fabricated_run import fabricate_estimate

    fabricate_run(tmp_path, {"bump/linear": {"robust": rotation("x", 3.0)}})
    fabricate_estimate(tmp_path / "bump/linear", "unbounce", rotation("x", 3.0), declined=0.5)
    scene = read_scene(read_items(tmp_path)[0])
    cases = [score_case(scene, method) for method in ("robust", "unbounce")]
    (pair,) = pairs("bump", "linear", cases)
    assert pair.first_deg == pair.second_deg
    assert pair.pixels == cases[1].score.row.scored
    assert cases[0].score.row.median_deg != cases[1].score.row.median_deg  # as the table alone would have it


def test_a_run_of_several_configs_has_boxes_curves_and_pairs(tmp_path: Path):
    methods = {"robust": rotation("x", 1.0), "unbounce": rotation("x", 0.5)}
    fabricate_run(tmp_path, {f"bump{n}/linear": methods for n in range(5)}, size=24)
    for n in range(5):
        path = tmp_path / f"bump{n}/linear/config.yaml"
        path.write_text(path.read_text() + f"camera: {{read_noise: 0.00{n}}}\nshape: {{kind: k{n % 2}}}\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("huesphere.eval.report.ALL_FIGURES_UP_TO", 0)
        patch.setattr("huesphere.eval.report.FIRST_AND_WORST", 1)
        write_report(tmp_path)
    figures = tmp_path / "report/figures"
    drawn = {path.stem for path in figures.glob("*.png")}
    assert {"by_camera.read-noise", "against_camera.read-noise", "by_shape.kind", "paired_linear"} <= drawn
    header, line = (tmp_path / "report/paired.csv").read_text().splitlines()
    row = dict(zip(header.split(","), line.split(","), strict=True))
    assert (row["first"], row["second"], row["scenes"]) == ("robust", "unbounce", "5")
    assert float(row["ratio"]) == pytest.approx(2.0, rel=1e-3)  # angles this small double with the turn
    # One picture each, for the first is among the worst too, and the page says so.
    assert [path.name for path in figures.iterdir() if path.is_dir()] == ["bump0"]
    html = (tmp_path / "report/index.html").read_text()
    assert "Figures are drawn for 1 of 5 pictures" in html


def test_of_many_methods_only_the_pairs_with_the_best_are_drawn():
    names = [f"m{n}" for n in range(7)]
    every = [Comparison("full", a, b, 6, 2.0, 1.5, 2.5, 0.0) for a, b in itertools.combinations(names, 2)]
    of_best = [c for c in every if "m3" in (c.first, c.second)]
    assert (len(every), len(of_best)) == (21, 6)
    drawn = comparison_panel(every, "m3").image
    np.testing.assert_array_equal(drawn, comparison_panel(of_best, "m3").image)
    assert len(comparison_panel(every[:15], "m3").image) > len(drawn)
