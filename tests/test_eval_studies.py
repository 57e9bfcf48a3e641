"""Studies: what their configs refuse, what their pages hold, and claims of the report that have known answers."""

import csv
import io
from pathlib import Path

import numpy as np
import pytest

from huesphere.configs.errors import InputError
from huesphere.configs.load import load_configs, packaged_names
from huesphere.configs.study import Assumptions, Curve, OneBounce, load_study, packaged_studies
from huesphere.eval.studies.attitude_claims import attitude_section
from huesphere.eval.studies.breaking import attitude
from huesphere.eval.studies.cases import estimate_of, measure_all
from huesphere.eval.studies.light_claims import _ambient, _confidence, _half_the_data
from huesphere.eval.studies.page import Claim, Figure, Section, Study, Table, csv_text, html, markdown, write_study
from huesphere.eval.studies.pictures import ball, ellipsoid_error_deg, lights_around, read, shaded, text
from huesphere.eval.studies.run import run_study
from huesphere.recover.status import REMEDIES

GELS = np.array([[0.9, 0.2, 0.05], [0.25, 0.9, 0.2], [0.05, 0.2, 0.9], [0.7, 0.7, 0.1], [0.1, 0.6, 0.6]])


@pytest.mark.parametrize("name", packaged_studies())
def test_packaged_studies_load_and_are_no_scenes(name):
    study = load_study(name)
    assert name not in packaged_names()
    with pytest.raises(InputError, match=f"evaluate --study {name}"):
        load_configs(name)
    assert load_study(name.removesuffix(".yaml")) == study


def test_a_study_that_is_none_is_refused_in_one_line(tmp_path):
    (tmp_path / "a.yaml").write_text("study: report_1994\ntrails: 3\n")
    with pytest.raises(InputError, match="trails"):
        load_study(str(tmp_path / "a.yaml"))
    (tmp_path / "b.yaml").write_text("name: b\n")
    with pytest.raises(InputError, match="not a study"):
        load_study(str(tmp_path / "b.yaml"))
    with pytest.raises(InputError, match="did you mean report_1994"):
        load_study("report_1995")


def small_study(claim_text: str = "a | b") -> Study:
    claim = Claim("key", "2.1", claim_text, "we <b>measure</b>", "holds", {"x": 1 / 3, "y": float("nan")})
    figure = Figure("one", "One", np.zeros((8, 9, 3), np.uint8), "said")
    table = Table(("name", "value"), (("row", "1"),), "caption")
    return Study(
        "tiny", "A <title>", ("Answer & more.",), (Section("First part", ("text",), (claim,), (table,), (figure,)),), ()
    )


def test_a_page_escapes_needs_no_network_and_shows_every_part():
    page = html(small_study())
    assert "A &lt;title&gt;" in page
    assert "&lt;b&gt;measure" in page
    assert "Answer &amp; more." in page
    assert 'src="http' not in page
    assert "<script" not in page
    assert page.count("data:image/webp") == 1
    assert 'id="one"' in page
    assert "1 holds" in page


def test_markdown_keeps_bars_within_their_cells_and_names_the_figures():
    lines = markdown(small_study()).splitlines()
    row = next(line for line in lines if line.startswith("| 2.1"))
    assert row.replace("\\|", "").count("|") == 5
    assert "![One](figures/one.png)" in lines


def test_numbers_go_to_the_csv_with_every_digit_and_what_is_not_known_is_empty():
    rows = list(csv.DictReader(io.StringIO(csv_text(small_study()))))
    assert float(rows[0]["value"]) == 1 / 3
    assert rows[1]["value"] == ""


def test_a_study_is_three_files_and_its_figures(tmp_path):
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures" / "of_before.png").touch()
    page = write_study(tmp_path, small_study())
    assert {p.name for p in tmp_path.iterdir()} == {"index.html", "study.md", "results.csv", "figures"}
    assert page.read_text().startswith("<!doctype html>")
    assert [p.name for p in (tmp_path / "figures").iterdir()] == ["one.png"]


def test_two_figures_of_one_name_are_refused():
    figure = Figure("same", "One", np.zeros((4, 4, 3), np.uint8))
    twice = Study("tiny", "t", ("a",), (Section("s", figures=(figure, figure)),), ())
    with pytest.raises(ValueError, match="same"):
        html(twice)


@pytest.mark.parametrize(
    ("value", "said"),
    [(0.0, "0"), (15.63, "16"), (0.0123, "0.012"), (1e-7, "1.0·10⁻⁷"), (-3e12, "−3.0·10¹²"), (float("nan"), "–")],
)
def test_numbers_as_people_read_them(value, said):
    assert text(value) == said


def test_shading_follows_the_linear_model_where_every_light_is_seen():
    normals, mask = ball(41, radius_deg=30)
    A = lights_around(20, (0, 90, 180, 270, 45))
    observation, F = shaded(normals, mask, A, GELS)
    np.testing.assert_allclose(observation.rgb[mask], normals[mask] @ F.T, atol=1e-6)
    G = np.linalg.inv(F)
    assert ellipsoid_error_deg(G.T @ G, F, normals[mask]) < 1e-5
    assert ellipsoid_error_deg(G.T @ np.diag([1, 2, 1]) @ G, F, normals[mask]) > 1


def test_what_is_known_of_the_closed_form_comes_out():
    claims = {claim.key: claim for claim in attitude_section(3).claims}
    assert claims["hemisphere"].verdict == "holds"
    assert claims["signs"].verdict == "holds"
    assert claims["flat"].numbers["largest eigenvalue"] == 0
    assert claims["off-axis"].numbers["r3 deg at 0"] < 0.01 < 5 < claims["off-axis"].numbers["r3 deg at 30"]
    assert claims["background"].numbers["with deg"] < claims["background"].numbers["without deg"]


def test_least_median_of_squares_breaks_at_a_half():
    claim, _ = _half_the_data(GELS)
    assert claim.verdict == "holds"
    assert 0.45 < claim.numbers["least share found"] < 0.6


def test_confidence_limits_cover_less_where_noise_enters_squared():
    claim = _confidence(GELS, 8)
    assert claim.numbers["covered at 1 %"] < claim.numbers["covered at 0.1 %"]


def test_the_printed_ambient_relation_is_off_and_the_corrected_one_is_not():
    from types import SimpleNamespace

    normals, mask = ball(61, radius_deg=75)
    found, formula = _ambient(GELS, SimpleNamespace(truth=SimpleNamespace(normals=normals), mask=mask))
    assert found.verdict == "holds"
    assert formula.numbers["corrected"] < 1e-9 < 1e-2 < formula.numbers["printed"]


# ---- whole studies, small --------------------------------------------------------------------------------------------

GELS_CONFIG = [
    {"direction": [0.4, 0.0, 1.0], "spectrum": {"gaussian": {"centre": 610, "sigma": 25}}},
    {"direction": [-0.2, 0.35, 1.0], "spectrum": {"gaussian": {"centre": 540, "sigma": 25}}},
    {"direction": [-0.2, -0.35, 1.0], "spectrum": {"gaussian": {"centre": 460, "sigma": 20}}},
]


def quiet(line: str) -> None:
    pass


@pytest.fixture(scope="module")
def bounces(tmp_path_factory):
    study = OneBounce(
        study="one_bounce",
        base={"camera": {"resolution": [36, 36]}, "render": {"target_rms": 1e-2}},
        shapes={
            "convex": {"shape": {"kind": "ellipsoid", "detail": 32}},
            "groove": {"shape": {"kind": "v_groove", "angle": 120, "detail": 16}},
        },
        lights={"gels": GELS_CONFIG},
        albedos=(0.2, 0.8),
        methods=("drew-kontsevich", "weak-integrability"),
        maps=("groove", "gels", 0.8),
    )
    folder = tmp_path_factory.mktemp("bounces")
    found, page = run_study(study, folder, jobs=1, log=quiet)
    return found, page, study, folder


def test_light_by_bounce_is_what_is_known_of_convex_shapes_and_grows_with_albedo(bounces):
    rows = [row for row in bounces[0].rows if row["transport"] == "full" and row["method"] == "known lights"]
    convex = [row for row in rows if row["shape"] == "convex"]
    assert all(row["share_one_bounce"] == row["share_rest"] == 0 for row in convex)
    assert all(row["median_deg"] < 1e-3 for row in convex)
    dim, bright = sorted((row for row in rows if row["shape"] == "groove"), key=lambda row: row["albedo"])
    assert bright["share_rest"] > 4 * dim["share_rest"] > 0
    assert bright["median_deg"] > dim["median_deg"] > 0.1


def test_more_bounces_are_further_from_known_lights_than_one(bounces):
    rows = {
        row["transport"]: row["median_deg"]
        for row in bounces[0].rows
        if (row["shape"], row["albedo"], row["method"]) == ("groove", 0.8, "known lights")
    }
    assert rows["linear"] < 1e-3
    assert rows["full"] > rows["one-bounce"] > rows["direct"]


def test_the_answer_is_made_of_the_numbers(bounces):
    found, page, *_ = bounces
    assert "convex any (there is no interreflection)" in found.answer[1]
    assert "of 2 scenes that have interreflection" in found.answer[0].replace("in any of", "of")
    assert page.read_text().count("<figure") >= 8


def test_estimates_that_are_there_are_not_made_again_unless_the_picture_changed(bounces, monkeypatch):
    folder = bounces[3]
    method = "drew-kontsevich"
    item = next(
        p.parent.relative_to(folder / "run").as_posix() for p in folder.glob("run/groove*8/full/observation.exr")
    )
    monkeypatch.setattr("huesphere.eval.studies.cases.recover_one", lambda *_: pytest.fail("recovered again"))
    measured = measure_all(folder / "run", [(item, (method,))], 1, quiet)
    assert measured[item].status(method) in REMEDIES or measured[item].status(method) == "ok"
    picture = read(folder / "run", item)
    record = picture.folder / "estimates" / f"{method}.json"
    record.write_text(record.read_text().replace('"observation_sha256": "', '"observation_sha256": "0'))
    with pytest.raises(pytest.fail.Exception, match="recovered again"):
        estimate_of(picture, method)


def test_a_broken_assumption_shows_in_its_curve(tmp_path):
    study = Assumptions(
        study="assumptions",
        base={
            "shape": {"kind": "ellipsoid", "semi_axes": [1, 0.7, 0.8], "rotation": [0, 0, 20], "detail": 48},
            "lights": GELS_CONFIG,
            "surface": {"reflectance": 0.5},
            "camera": {"resolution": [64, 64], "read_noise": 1e-4},
            "render": {"transport": ["direct"]},
        },
        methods=("weak-integrability",),
        curves={
            "noise": Curve(title="Noise", axis="noise", key="camera.read_noise", values=(1e-4, 1e-2), log=True),
            "encoding": Curve(title="Encoding", axis="γ", key="gamma", values=(1.0, 2.2)),
            "gels": Curve(title="Gels", axis="cond(F)", key="gel_width", values=(20, 120), x="cond_F"),
            "near": Curve(title="Near", axis="distance", key="light_distance", values=(1000, 3), log=True),
        },
        tolerance_deg=1.0,
    )
    found, page = run_study(study, tmp_path, jobs=1, log=quiet)
    error = {(row["curve"], row["value"]): row for row in found.rows}
    assert error["noise", 1e-2]["median_deg"] > 5 * error["noise", 1e-4]["median_deg"]
    assert not error["encoding", 2.2]["median_deg"] < 3 * error["encoding", 1.0]["median_deg"]
    assert error["near", 3]["median_deg"] > 3 * error["near", 1000]["median_deg"]
    assert error["gels", 120]["x"] > 2 * error["gels", 20]["x"] > 2
    assert "Encoding" in page.read_text()


def test_a_setting_that_does_not_fit_the_base_is_refused(tmp_path):
    with pytest.raises(InputError, match="bust"):
        attitude({"shape": {"kind": "sphere"}}, 10, tmp_path)


def test_a_figure_of_a_study_opens_and_its_plot_is_there_as_svg_and_pdf(tmp_path: Path):
    from matplotlib.figure import Figure as Canvas

    from huesphere.eval.studies.page import Figure, Section, Study, write_study

    canvas = Canvas()
    canvas.add_subplot().plot([0, 1], [0, 1])
    image = np.zeros((8, 8, 3), np.uint8)
    figures = (Figure("line", "A line", image, "", canvas), Figure("map", "A map", image))
    page = write_study(tmp_path, Study("s", "S", ("Yes.",), (Section("Part one", figures=figures),), ()))
    names = {path.name for path in (tmp_path / "figures").iterdir()}
    assert names == {"line.png", "line.svg", "line.pdf", "map.png"}
    before = (tmp_path / "figures/line.svg").read_bytes()
    write_study(tmp_path, Study("s", "S", ("Yes.",), (Section("Part one", figures=figures),), ()))
    assert (tmp_path / "figures/line.svg").read_bytes() == before  # without a date
    assert 'href="#line" aria-label="Enlarge: A line"' in page.read_text()
