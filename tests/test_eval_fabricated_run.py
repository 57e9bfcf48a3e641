"""A run folder made by hand, with the repo's own writers and no renderer: evaluation from end to end."""

import csv
import hashlib
import io
import json
import re
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from huesphere.configs.errors import InputError, Unfinished
from huesphere.eval.cli import main
from huesphere.eval.report import write_report
from huesphere.eval.table import best_cells
from huesphere.recover.io.estimate import AngleCurves, EllipsoidFit, Estimate, read_estimate, write_estimate
from huesphere.recover.solution import Solution
from huesphere.render.dataset import Observation, Truth, read_observation, read_truth, write_observation, write_truth
from huesphere.render.exr import read_exr
from huesphere.render.jobs import Lost

ROOT = Path(__file__).resolve().parent.parent

LIGHTS = np.array([[0.5, 0.2, 1.0], [-0.5, 0.2, 1.0], [0.0, -0.5, 1.0]])
COLOURS = np.array([[0.60, 0.10, 0.05], [0.10, 0.50, 0.12], [0.05, 0.15, 0.55]])


def bump(size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """An ellipsoid with a dent: depth (H, W) in pixels, normals (H, W, 3), mask (H, W); analytic."""
    y, x = (size - 1) / 2 - np.mgrid[:size, :size][0], np.mgrid[:size, :size][1] - (size - 1) / 2
    a, b, c = 0.46 * size, 0.42 * size, 0.30 * size
    inside = 1 - (x / a) ** 2 - (y / b) ** 2
    mask = inside > 0.06
    root = np.sqrt(np.where(mask, inside, 1.0))
    s = 0.09 * size
    dent = 0.05 * size * np.exp(-((x - 0.1 * size) ** 2 + (y + 0.08 * size) ** 2) / (2 * s**2))
    depth = c * root - dent
    p = -c * x / a**2 / root + dent * (x - 0.1 * size) / s**2
    q = -c * y / b**2 / root + dent * (y + 0.08 * size) / s**2
    normals = np.stack([-p, -q, np.ones_like(p)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    normals[~mask], depth[~mask] = np.nan, np.nan
    return depth, normals, mask


def rotation(axis: str, degrees: float) -> np.ndarray:
    """Rotation by ``degrees`` about the axis "x", "y" or "z", right-handed."""
    i = "xyz".index(axis)
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    R = np.eye(3)
    j, k = (i + 1) % 3, (i + 2) % 3
    R[j, j] = R[k, k] = c
    R[j, k], R[k, j] = -s, s
    return R


def fabricate_item(folder: Path, *, size: int = 64, noise: float = 0.0, methods: tuple[str, ...] = ()) -> None:
    """Write the files of one item under ``folder``: picture, truth, config, preview, no estimates."""
    import imageio.v3

    folder.mkdir(parents=True, exist_ok=True)
    depth, normals, mask = bump(size)
    towards = LIGHTS / np.linalg.norm(LIGHTS, axis=1, keepdims=True)
    cosines = np.nan_to_num(normals) @ towards.T
    rgb = np.maximum(cosines, 0.0) @ COLOURS
    rgb = rgb + noise * np.random.default_rng(0).normal(size=rgb.shape)
    rgb = np.where(mask[..., None], rgb, 0.0).astype(np.float32)
    attached = (cosines <= 0).astype(np.float32)
    F = COLOURS.T @ towards
    truth = Truth(normals, depth, mask, attached, np.zeros_like(attached), facts={"F": F.tolist()})
    write_observation(folder / "observation.exr", Observation(rgb, mask))
    write_truth(folder / "truth.exr", truth)
    (folder / "config.yaml").write_text(f"name: fabricated\nrecover:\n  methods: {json.dumps(list(methods))}\n")
    imageio.v3.imwrite(folder / "preview.png", (255 * np.clip(rgb, 0, 1) ** (1 / 2.2)).astype(np.uint8))


def fabricate_run(run: Path, items: dict[str, dict[str, np.ndarray]], *, size: int = 64, noise: float = 0.0) -> None:
    """Write a run folder. ``items``: id -> {method: 3×3 matrix that turns the true normals into the estimate}."""
    entries = []
    for identity, methods in items.items():
        folder = run / identity
        fabricate_item(folder, size=size, noise=noise, methods=tuple(methods))
        for method, turn in methods.items():
            fabricate_estimate(folder, method, turn)
        entries.append(manifest_entry(run, identity))
    (run / "manifest.json").write_text(json.dumps({"format_version": 1, "versions": {}, "items": entries}))


def manifest_entry(run: Path, identity: str, status: str = "done") -> dict[str, object]:
    names = ("config.yaml", "observation.exr", "truth.exr", "preview.png") if status == "done" else ()
    paths = [run / identity / name for name in names]
    digest = [{"path": f"{identity}/{p.name}", "sha256": hashlib.sha256(p.read_bytes()).hexdigest()} for p in paths]
    return {"id": identity, "status": status, "seed": 0, "seconds": 1.0, "files": digest}


def fabricate_estimate(
    folder: Path, method: str, turn: np.ndarray, *, declined: float = 0.0, status: str = "ok"
) -> None:
    """Write an estimate: the true normals times ``turn``; the left share ``declined`` of the object is given up."""
    _, normals, mask = bump(size=_size(folder))
    towards = LIGHTS / np.linalg.norm(LIGHTS, axis=1, keepdims=True)
    estimate = normals @ turn.T
    valid = mask.copy()
    valid.ravel()[np.flatnonzero(mask)[: round(declined * mask.sum())]] = False
    estimate[~valid] = np.nan
    inlier = valid & (np.nan_to_num(normals) @ towards.T > 0.0).all(axis=-1)
    F = COLOURS.T @ towards
    angles = np.linspace(0.0, 90.0, 91)
    value = np.stack([0.2 + np.sin(np.radians(2 * (angles - a))) ** 2 for a in (20.0, 65.0)])
    slope = np.stack([np.sin(np.radians(4 * (angles - a))) for a in (20.0, 65.0)])
    stated = np.where(valid, 1.0, np.nan).astype(np.float32)
    message = "" if status == "ok" else "the colours say too little: use more lights"
    made = Estimate(
        method,
        status,
        message,
        estimate,
        valid,
        inlier,
        stated,
        seconds=0.5,
        solution=Solution(F, inlier, 1e-3, 1e-6 * np.eye(3)),
        ellipsoid=EllipsoidFit(s0=1e-3, r2=0.9998, accepted=int(inlier.sum())),
        curves=AngleCurves(angles, value, slope, candidate=0, chosen=20.0),
    )
    write_estimate(folder / "estimates", made, folder / "observation.exr")


def _size(folder: Path) -> int:
    return read_observation(folder / "observation.exr").mask.shape[0]


# --- the run as a whole -----------------------------------------------------------------------------------------------

METHODS = {
    "drew-kontsevich": rotation("z", 10),
    "weak-integrability": rotation("y", 0.05),
    "least-squares": rotation("x", 15) @ rotation("z", 4),
}


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """Two pictures, three methods, sound in every way."""
    fabricate_run(tmp_path, {"bump/linear": METHODS, "bump/full": METHODS}, noise=1e-3)
    return tmp_path


@pytest.fixture(scope="module")
def reported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same with its report, to be read only."""
    folder = tmp_path_factory.mktemp("reported")
    fabricate_run(folder, {"bump/linear": METHODS, "bump/full": METHODS}, noise=1e-3)
    before = {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    write_report(folder)
    after = {
        p: p.read_bytes() for p in folder.rglob("*") if p.is_file() and "report" not in p.relative_to(folder).parts
    }
    assert after == before, "only the report is written"
    return folder


def table(run: Path) -> list[dict[str, str]]:
    with (run / "report" / "metrics.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def evaluate(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "huesphere.eval.cli", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=60)


def evaluated(*arguments: object) -> subprocess.CompletedProcess[str]:
    """The same without another process, which takes seconds to import what draws and scores."""
    words = list(map(str, arguments))
    out, err = (io.TextIOWrapper(io.BytesIO(), encoding="utf-8") for _ in range(2))
    with redirect_stdout(out), redirect_stderr(err), pytest.raises(SystemExit) as end:
        main(words)
    return subprocess.CompletedProcess(words, end.value.code, *(one.buffer.getvalue().decode() for one in (out, err)))


def test_the_table_has_the_columns_of_the_contract_and_one_row_per_result(reported: Path):
    rows = table(reported)
    assert ",".join(rows[0]).startswith(
        "config,transport,method,status,pixels,scored,coverage,mean_deg,median_deg,p90_deg,p95_deg,rms_deg,within_1,"
        "within_5,within_11_25,within_22_5,within_30,median_deg_flip,median_deg_gauge,oracle_linear_median_deg,cond_F,"
        "seconds,"
    )
    assert [(r["transport"], r["method"]) for r in rows] == [(t, m) for t in ("linear", "full") for m in METHODS]
    assert all(r["status"] == "ok" and float(r["coverage"]) == 1.0 for r in rows)


def test_known_errors_come_out_of_the_whole_chain(reported: Path):
    row = next(r for r in table(reported) if r["method"] == "weak-integrability")
    truth = read_truth(reported / "bump/linear/truth.exr")
    n = truth.normals[truth.mask].astype(np.float64)
    chord = np.hypot(n[:, 0], n[:, 2]) * np.sin(np.radians(0.025))  # a turn about y moves n by its distance from y
    assert float(row["median_deg"]) == pytest.approx(np.median(2 * np.degrees(np.arcsin(chord))), rel=1e-4)
    assert float(row["median_deg_gauge"]) < 1e-5
    assert float(row["cond_F"]) == pytest.approx(np.linalg.cond(np.array(truth.facts["F"])))


def test_every_file_of_the_report_is_there_and_the_page_needs_no_other(reported: Path):
    report = reported / "report"
    assert {p.name for p in report.iterdir()} == {
        "index.html", "metrics.csv", "metrics.json", "table.md", "table.tex", "paired.csv", "regions.csv",
        "calibration.csv", "figures", "errors"
    }  # fmt: skip
    html = without_scripts((report / "index.html").read_text())
    links = re.findall(r"""(?:src|href)\s*=\s*["']([^"']{0,30})""", html)
    assert links
    assert all(link.startswith(("data:", "#")) for link in links)
    anchors = set(re.findall(r'id="([^"]+)"', html))
    assert {link[1:] for link in links if link.startswith("#")} <= anchors


def test_the_figures_of_the_report_of_1994_are_all_there(reported: Path):
    of_picture = {p.stem for p in (reported / "report/figures/bump/linear").glob("*.png")}
    of_method = {p.stem for p in (reported / "report/figures/bump/linear/drew-kontsevich").glob("*.png")}
    assert of_picture >= {"picture", "truth_normals", "truth_depth", "truth_shaded", "cumulative_methods"}
    assert of_method == {
        "normals", "error", "inliers", "histogram", "colour_cloud", "integrability_unrotated", "integrability", "alpha",
        "alpha_integral", "doubtful", "calibration",
        "truth_shaded_accepted", "recovered_shaded",
    }  # fmt: skip


def test_the_error_image_on_disk_is_what_the_table_sums_up(reported: Path):
    channels, _ = read_exr(reported / "report/errors/bump/full/least-squares.exr")
    error = channels["error_deg"]
    row = next(r for r in table(reported) if (r["transport"], r["method"]) == ("full", "least-squares"))
    assert np.isfinite(error).sum() == int(row["scored"])
    assert np.nanmean(error) == pytest.approx(float(row["mean_deg"]), rel=1e-6)


@pytest.mark.usefixtures("without_figures")
def test_metrics_json_holds_the_rows_and_their_distributions(run: Path):
    fabricate_estimate(run / "bump/linear", "least-squares", np.eye(3), declined=1.0, status="flat-surface")
    write_report(run)
    record = json.loads((run / "report/metrics.json").read_text(), parse_constant=pytest.fail)  # no bare NaN
    row = record["rows"][0]
    assert sum(row["histogram"]) == row["scored"]
    assert np.interp(0.5, record["quantiles"], row["quantiles_deg"]) == pytest.approx(row["median_deg"], rel=1e-2)
    failed = record["rows"][2]
    assert (failed["status"], failed["median_deg"], failed["scored"]) == ("flat-surface", None, 0)


def test_the_contract_of_the_run_folder_is_kept(reported: Path):
    checker = ROOT.parent / "shared" / "contract_check.py"
    if not checker.is_file():
        pytest.skip("the contract checker is not part of this repository")
    done = subprocess.run([sys.executable, checker, reported], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


def test_the_same_run_gives_the_same_report_by_one_process_or_two(run: Path, monkeypatch: pytest.MonkeyPatch):
    write_report(run, ["least-squares"])
    one = {p: p.read_bytes() for p in (run / "report").rglob("*") if p.is_file()}
    monkeypatch.setattr("huesphere.eval.report.PARALLEL_FROM", 2)
    write_report(run, ["least-squares"], jobs=2)
    assert {p: p.read_bytes() for p in (run / "report").rglob("*") if p.is_file()} == one


@pytest.mark.usefixtures("without_figures")
def test_a_page_of_too_many_pictures_goes_without_small_ones_and_says_so(run: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("huesphere.eval.report.PAGE_BYTES", 3e6)
    write_report(run, ["least-squares"])
    split = (run / "report/index.html").read_text()
    assert split.count('<div class="thumbs">') == 2
    monkeypatch.setattr("huesphere.eval.report.PAGE_BYTES", len(split) - 1)
    write_report(run, ["least-squares"])
    bare = (run / "report/index.html").read_text()
    assert '<div class="thumbs">' not in bare
    assert "too many pictures to show each small" in bare
    assert [f'href="pictures/picture-{n}.html#picture-{n}-1"' in bare for n in (1, 2)] == [True, True]
    assert '<div class="thumbs">' in (run / "report/pictures/picture-2.html").read_text()
    assert not [path for path in (run / "report").iterdir() if path.name.startswith(".")]


def test_a_worker_that_dies_while_scoring_is_told_with_its_picture(run: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(
        "huesphere.eval.report.each", lambda _, tasks, **__: (pair for pair in [(1, Lost("the worker died"))])
    )
    with pytest.raises(Unfinished, match="bump/full: the worker died"):
        write_report(run, ["least-squares"])


def without_scripts(html: str) -> str:
    return re.sub(r"<script\b.*?</script>", "", html, flags=re.DOTALL)


# --- what does not go well is said ------------------------------------------------------------------------------------


def test_an_estimate_of_another_picture_is_refused(run: Path):
    fabricate_item(run / "bump/linear", noise=2e-3, methods=tuple(METHODS))
    with pytest.raises(InputError, match=r"drew-kontsevich\.json: .*another picture.*--overwrite"):
        write_report(run)


@pytest.mark.usefixtures("without_figures")
def test_a_failed_method_keeps_its_status_and_gives_empty_cells(run: Path):
    fabricate_estimate(run / "bump/full", "drew-kontsevich", np.eye(3), declined=1.0, status="no-dominant-shell")
    write_report(run)
    row = next(r for r in table(run) if (r["transport"], r["method"]) == ("full", "drew-kontsevich"))
    assert (row["status"], row["scored"], row["coverage"]) == ("no-dominant-shell", "0", "0.0")
    assert row["mean_deg"] == row["median_deg_flip"] == row["within_5"] == ""
    html = (run / "report/index.html").read_text()
    assert "no-dominant-shell" in html
    assert "the colours say too little" in html


@pytest.mark.usefixtures("without_figures")
def test_a_failed_method_that_gives_normals_is_scored_and_marked_and_never_best(run: Path):
    fabricate_estimate(run / "bump/full", "drew-kontsevich", np.eye(3), status="n3-signs")
    report = write_report(run)
    rows = [score.row for score in report.scores]
    index = next(i for i, r in enumerate(rows) if r.status == "n3-signs")
    assert rows[index].median_deg == 0.0
    assert not [key for i, key in best_cells(rows) if i == index]


@pytest.mark.usefixtures("without_figures")
def test_what_was_not_run_or_not_rendered_is_listed(run: Path):
    (run / "bump/full/estimates/least-squares.json").unlink()
    manifest = json.loads((run / "manifest.json").read_text())
    manifest["items"].append(manifest_entry(run, "broken/full", "failed"))
    (run / "manifest.json").write_text(json.dumps(manifest))
    write_report(run)
    rows = {(r["config"], r["transport"], r["method"]): r for r in table(run)}
    assert rows["bump", "full", "least-squares"]["status"] == "missing"
    assert rows["bump", "full", "least-squares"]["coverage"] == ""
    assert [r["status"] for key, r in rows.items() if key[0] == "broken"] == ["failed"] * 3
    assert "broken/full" in (run / "report/index.html").read_text()


@pytest.mark.usefixtures("without_figures")
def test_names_and_messages_are_escaped(tmp_path: Path):
    evil = "<script>alert(1)</script>&\"'|_$%\x1b[2J"
    fabricate_run(tmp_path, {"<b>bold</b>_1|$x$/linear": {"least-squares": np.eye(3), "weak-integrability": np.eye(3)}})
    folder = tmp_path / "<b>bold</b>_1|$x$/linear"
    made, _ = read_estimate(folder / "estimates", "least-squares")
    write_estimate(folder / "estimates", replace(made, status=evil, message=evil), folder / "observation.exr")
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    manifest["versions"] = {"<i>": "<u>"}
    (tmp_path / "manifest.json").write_text(json.dumps(manifest))
    write_report(tmp_path)
    html = (tmp_path / "report/index.html").read_text()
    assert "<script>alert" not in html  # nor in the data of the scripts
    assert not re.findall(r"<(?:b>bold|i>|u>)", without_scripts(html))
    assert "&lt;script&gt;alert(1)" in html
    assert r"<b>bold" not in (tmp_path / "report/table.md").read_text()
    assert r"\_1|\$x\$" in (tmp_path / "report/table.tex").read_text()
    for name in ("index.html", "table.md", "table.tex"):
        assert "\x1b" not in (tmp_path / "report" / name).read_text()  # printed, it would reach the terminal


def test_an_estimate_without_a_solution_is_drawn_as_far_as_it_goes(run: Path):
    folder = run / "bump/linear"
    made, _ = read_estimate(folder / "estimates", "least-squares")
    without = replace(made, solution=None, ellipsoid=None, curves=None)
    write_estimate(folder / "estimates", without, folder / "observation.exr")
    write_report(run, ["least-squares"])
    drawn = {p.stem for p in (run / "report/figures/bump/linear/least-squares").glob("*.png")}
    assert {"normals", "error", "inliers", "histogram", "colour_cloud"} <= drawn  # the colours alone
    assert not {"alpha", "alpha_integral"} & drawn


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("solution", {"F": [[1, 2], [3, 4]]}),
        ("solution", {"F": [[None] * 3] * 3}),
        ("solution", []),
        ("lights", {"found": [{"direction": [1.0]}], "missing": 0}),
        ("lights", {"found": "<b>"}),
        ("alpha_curve", {"alpha_deg": [1], "value": [[1]], "condition": [[1]], "candidate": 0, "chosen": 0}),
        ("ellipsoid", {"s0": "x"}),
    ],
)
def test_a_record_that_is_damaged_is_named_and_refused(run: Path, key: str, value: object):
    path = run / "bump/linear/estimates/least-squares.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {key: value}))
    with pytest.raises(InputError, match="not a readable estimate"):
        read_estimate(path.parent, "least-squares")


def damage_manifest(run: Path) -> None:
    (run / "manifest.json").write_text('{"items": 3')


def damage_truth(run: Path) -> None:
    path = run / "bump/linear/truth.exr"
    path.write_bytes(path.read_bytes()[:2000])


def damage_estimate(run: Path) -> None:
    path = run / "bump/linear/estimates/least-squares.exr"
    path.write_bytes(path.read_bytes()[:1500])


def escape_folder(run: Path) -> None:
    entry = manifest_entry(run, "../elsewhere/linear", "done-not")
    (run / "manifest.json").write_text(json.dumps({"format_version": 1, "versions": {}, "items": [entry]}))


def future_format(run: Path) -> None:
    (run / "manifest.json").write_text(json.dumps({"format_version": 99, "versions": {}, "items": []}))


def no_items(run: Path) -> None:
    (run / "manifest.json").write_text(json.dumps({"format_version": 1, "versions": {}, "items": []}))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (damage_manifest, "manifest.json: a damaged manifest"),
        (damage_truth, "truth.exr: not a readable OpenEXR picture"),
        (damage_estimate, "not a readable OpenEXR picture"),
        (escape_folder, "leads out of the run folder"),
        (future_format, "format_version, got 99, expected 1"),
        (no_items, "holds no items"),
        (lambda run: (run / "manifest.json").unlink(), "not a run folder"),
    ],
)
def test_a_damaged_run_is_one_line_that_names_the_file(run: Path, damage, message: str):
    damage(run)
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        write_report(run)
    assert "\n" not in str(caught.value)
    assert str(run) in str(caught.value)


# --- the command ------------------------------------------------------------------------------------------------------


def test_the_command_prints_the_table_within_80_columns_and_the_path_of_the_page(run: Path):
    done = evaluate(run)
    assert done.returncode == 0, done.stderr
    assert max(map(len, done.stdout.splitlines()[:-1])) <= 80
    for word in ("linear", "full", "weak-integrability", "least-squares", "<0.001"):
        assert word in done.stdout
    assert done.stdout.splitlines()[-1] == f"report: {run / 'report' / 'index.html'}"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["{run}/nowhere"], "no such run folder"),
        (["{run}", "--method", "least-square"], "did you mean"),
        (["{run}", "--metod", "least-squares"], "did you mean --method?"),
        ([], "required: RUN_DIR"),
    ],
)
def test_bad_arguments_are_one_line_and_exit_code_2(run: Path, arguments: list[str], message: str):
    done = evaluate(*(a.replace("{run}", str(run)) for a in arguments))
    assert done.returncode == 2
    assert message in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_help_is_quick_for_it_loads_nothing_heavy():
    code = "import sys, huesphere.eval.cli as c; c.parser().format_help(); print([m for m in sys.modules if m in %r])"
    heavy = ("numpy", "scipy", "matplotlib", "mitsuba", "OpenEXR", "jinja2", "rich", "numba")
    done = subprocess.run([sys.executable, "-c", code % (heavy,)], capture_output=True, text=True, cwd=ROOT)
    assert done.stdout.strip() == "[]", done.stdout + done.stderr


def test_evaluation_needs_no_renderer(run: Path):
    code = (
        "import sys; sys.modules['mitsuba'] = sys.modules['drjit'] = None\n"
        "from pathlib import Path; from eval.report import write_report\n"
        "write_report(Path(sys.argv[1]), ['least-squares'])"
    )
    done = subprocess.run([sys.executable, "-c", code, run], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
