"""The frozen test set, submissions and the leaderboard, on a reduced set of fabricated pictures."""

import json
import os
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_eval_fabricated_run import fabricate_item

from huesphere.configs.errors import InputError
from huesphere.configs.load import validate
from huesphere.eval.benchmark import (
    EDITIONS,
    V1,
    Benchmark,
    check_sums,
    digest,
    find_edition,
    make_benchmark,
    open_benchmark,
    scenes_of,
)
from huesphere.eval.cli import evaluate, parser
from huesphere.eval.leaderboard import leaderboard, ranks, read_rows
from huesphere.eval.submission import points_of, read_row, submit
from huesphere.render.dataset import read_observation
from huesphere.render.manifest import read_manifest

ONLY = ["sphere-skin-1", "bust-two-2", "octant-coated-1", "bowl-bright-1"]
ROOT = Path(__file__).resolve().parent.parent


def fabricated(folder: Path) -> Path:
    """A part of v1 whose pictures are those of a bump, in place of rendered ones."""

    def render(configs, run, **_):
        for config in configs:
            fabricate_item(run / config.name / config.render.transport[0], size=24)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("huesphere.render.run.render_configs", render)
        return make_benchmark(V1, folder, only=ONLY).parent


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fabricated(tmp_path_factory.mktemp("set"))


def test_v1_has_forty_scenes_and_every_shape_meets_every_surface_light_and_noise():
    scenes = scenes_of(V1)
    assert len(scenes) == len({scene.id for scene in scenes}) == len({scene.seed for scene in scenes}) == 40
    assert len({scene.cell for scene in scenes}) == 20
    for shape in V1.shapes:
        assert {s.lights for s in scenes if s.shape == shape} == set(V1.lights)
        assert {s.noise for s in scenes if s.shape == shape} == set(V1.noises)
    for surface in V1.surfaces:
        assert {s.lights for s in scenes if s.surface == surface} == set(V1.lights)
    for scene in scenes:
        assert validate(scene.config, where="v1").camera.resolution == (128, 128)


def test_the_scenes_of_v1_never_change():
    text = json.dumps([scene.config for scene in scenes_of(V1)], sort_keys=True)
    assert digest({"v1": np.frombuffer(text.encode(), np.uint8)}) == (
        "5c5d6c7131a32f6ad27fb667cb53eba452a471ba5548e0ce9efb3951b82870c7"
    )


def test_a_misspelt_edition_is_refused_with_the_names():
    assert find_edition("v1") is EDITIONS["v1"]
    with pytest.raises(InputError, match=r"did you mean"):
        find_edition("v11")


def test_a_set_made_twice_is_the_same_byte_for_byte(folder: Path, tmp_path: Path):
    again = fabricated(tmp_path / "again")
    files = {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    assert files == {path.relative_to(again): path.read_bytes() for path in again.rglob("*") if path.is_file()}
    assert check_sums(open_benchmark(again)) == []


def test_the_pictures_are_a_run_folder_without_truth(folder: Path):
    items = read_manifest(folder / "pictures")["items"]
    assert {item["id"].partition("/")[0] for item in items} == set(ONLY)
    assert not list((folder / "pictures").rglob("truth*"))
    assert not (folder / ".making").exists()
    for item in items:
        assert read_observation(folder / "pictures" / item["id"] / "observation.exr").mask.any()


def test_a_changed_picture_is_found(tmp_path: Path):
    changed = fabricated(tmp_path / "set")
    item = changed / "pictures" / "bust-two-2" / "full"
    fabricate_item(item, size=24, noise=0.01)
    assert check_sums(open_benchmark(changed)) == ["bust-two-2"]


def test_sums_do_not_depend_on_the_layout_of_an_array_or_the_kind_of_nan():
    a = np.array([[1.0, np.nan], [3.0, 4.0]], "<f4")
    other = a.T.copy().T
    other[0, 1] = np.frombuffer(b"\x01\x00\xc0\xff", "<f4")[0]  # a NaN with other bits
    assert digest({"x": a}) == digest({"x": other})
    assert digest({"x": a}) != digest({"y": a})


def write_maps(folder: Path, maps: Path, *, ending: str = ".npy", turn=None, leave: int = 0) -> Path:
    """The true normals as maps of another program, all but ``leave`` scenes."""
    benchmark = open_benchmark(folder)
    maps.mkdir(parents=True)
    for scene in benchmark.scenes[leave:]:
        normals = benchmark.truth(scene).normals
        normals = normals if turn is None else normals @ turn.T
        if ending == ".npy":
            np.save(maps / f"{scene.id}.npy", normals)
        elif ending == ".mat":
            import scipy.io

            scipy.io.savemat(maps / f"{scene.id}.mat", {"Normal_est": normals})
        elif ending == ".exr":
            from huesphere.render.exr import write_exr

            write_exr(maps / f"{scene.id}.exr", {axis: normals[..., i] for i, axis in enumerate("XYZ")}, {})
        else:
            import tifffile

            coded = np.nan_to_num((normals + 1) / 2 * 65535).round().astype(np.uint16)
            tifffile.imwrite(maps / f"{scene.id}{ending}", coded, photometric="rgb")
    return maps


@pytest.mark.parametrize("ending", [".npy", ".mat", ".exr", ".tif"])
def test_the_truth_itself_gets_all_points_in_every_format(folder: Path, tmp_path: Path, ending: str):
    maps = write_maps(folder, tmp_path / "maps", ending=ending)
    row, archive = submit(open_benchmark(folder), str(maps), "the truth", tmp_path / "out")
    assert row.points == pytest.approx(100.0, abs=1e-6)
    assert row.coverage == 1.0
    assert row.median_deg < 0.01
    assert archive.name == "the-truth-v1.zip"
    names = set(zipfile.ZipFile(archive).namelist())
    assert names == {"row.json", "scenes.csv", *(f"normals/{name}.npy" for name in ONLY)}
    assert read_row(archive.with_suffix(".json")).points == pytest.approx(100.0)


def test_a_submission_made_twice_is_the_same_file(folder: Path, tmp_path: Path):
    maps = write_maps(folder, tmp_path / "maps")
    made = [submit(open_benchmark(folder), str(maps), "a", tmp_path / place)[1].read_bytes() for place in "xy"]
    assert made[0] == made[1]


def test_missing_scenes_are_worth_nothing_and_too_many_are_refused(folder: Path, tmp_path: Path):
    row, _ = submit(open_benchmark(folder), str(write_maps(folder, tmp_path / "a", leave=1)), "a", tmp_path)
    assert row.points == pytest.approx(75.0)
    assert row.coverage == 0.75
    assert row.missing == (open_benchmark(folder).scenes[0].id,)
    with pytest.raises(InputError, match="of 1 of 4 scenes"):
        submit(open_benchmark(folder), str(write_maps(folder, tmp_path / "b", leave=3)), "b", tmp_path)


def test_maps_in_another_frame_are_refused_until_the_frame_is_named(folder: Path, tmp_path: Path):
    from huesphere.eval.frames import parse_frame

    maps = write_maps(folder, tmp_path / "maps", turn=np.diag([1.0, -1.0, 1.0]))
    with pytest.raises(InputError, match="--frame directx"):
        submit(open_benchmark(folder), str(maps), "a", tmp_path)
    row, _ = submit(open_benchmark(folder), str(maps), "a", tmp_path, frame=parse_frame("directx"))
    assert row.points == pytest.approx(100.0, abs=1e-6)


def test_a_function_of_the_user_is_called_with_picture_and_mask(folder: Path, tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = "import numpy as np\ndef up(rgb, mask):\n    return np.where(mask[..., None], [0.0, 0.0, 5.0], np.nan)\n"
    (tmp_path / "my_method.py").write_text(text)
    row, _ = submit(open_benchmark(folder), "my_method:up", "flat", tmp_path)
    assert row.coverage == 1.0
    assert 0 < row.points < 30
    assert all(score.seconds >= 0 for score in row.scenes)
    with pytest.raises(InputError, match="module:function"):
        submit(open_benchmark(folder), "my_method:down", "flat", tmp_path)


def test_a_name_may_say_by_which_script_and_its_files_lie_in_the_folder_all_the_same(folder: Path, tmp_path: Path):
    maps = write_maps(folder, tmp_path / "maps")
    row, archive = submit(open_benchmark(folder), str(maps), "a network (lab/../net.py)", tmp_path / "out")
    assert row.name == "a network (lab/../net.py)"
    assert archive == tmp_path / "out" / "a-network-lab-..-net.py-v1.zip"
    assert {path.name for path in tmp_path.iterdir()} == {"maps", "out"}
    for name in ("/a", "(a)", "a\nb", "a|b", ""):
        with pytest.raises(InputError, match="--name"):
            submit(open_benchmark(folder), str(maps), name, tmp_path / "out")


def test_points_are_linear_in_the_logarithm_of_the_error_and_leaving_out_never_pays():
    middle = np.sqrt(0.1 * 30.0)
    assert points_of(np.full(7, middle), 7) == pytest.approx(50.0)
    assert points_of(np.zeros(3), 3) == 100.0
    errors = np.array([0.5, 2.0, 40.0])
    assert points_of(errors[:2], 3) == pytest.approx(points_of(errors, 3))
    assert points_of(errors[:1], 3) < points_of(errors, 3)
    assert points_of(np.zeros(0), 0) == 0.0


def test_the_leaderboard_ranks_by_points_and_overlapping_intervals_share_a_place(folder: Path, tmp_path: Path):
    benchmark = open_benchmark(folder)
    rows = tmp_path / "rows"
    submit(benchmark, str(write_maps(folder, tmp_path / "a")), "all of it", rows)
    submit(benchmark, str(write_maps(folder, tmp_path / "b", leave=2)), "half of it", rows)
    found = read_rows(rows)
    assert found[0].name == "all of it"
    assert [row.points for row in found] == sorted((row.points for row in found), reverse=True)
    text = leaderboard(found)
    assert text.index("| all of it |") < text.index("| half of it |")
    matrix = text.split("### half of it")[1]
    first, _second, *others = (scene.cell for scene in benchmark.scenes)
    for shape, surface in others:
        assert f"| {shape} | " + " | ".join("100" if s == surface else "–" for s in surfaces(benchmark)) in matrix
    assert f"| {first[0]} | " + " | ".join("0" if s == first[1] else "–" for s in surfaces(benchmark)) in matrix
    spread = [replace(found[0], points=p, low=a, high=b) for p, a, b in ((90, 85, 95), (80, 70, 86), (60, 50, 69))]
    assert ranks(spread) == [1, 1, 3]
    (rows / "copy.json").write_bytes(next(rows.glob("all*.json")).read_bytes())
    with pytest.raises(InputError, match="two rows of one name"):
        read_rows(rows)


def surfaces(benchmark: Benchmark) -> list[str]:
    """The surfaces of a set, in the order of the leaderboard's columns."""
    return list(dict.fromkeys(scene.surface for scene in benchmark.scenes))


def test_the_command_scores_and_prints_the_page(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    maps = write_maps(folder, tmp_path / "maps")
    words = ["--submit", str(maps), "--name", "mine", "--benchmark", str(folder), "--out", str(tmp_path / "rows")]
    evaluate(parser().parse_args(words))
    evaluate(parser().parse_args(["--leaderboard", str(tmp_path / "rows")]))
    out = capsys.readouterr().out
    assert "mine on v1: 100.0 points" in out
    assert "# Leaderboard, benchmark v1" in out
    assert max(map(len, out.split("# Leaderboard")[0].replace(str(tmp_path), "").splitlines())) <= 80
    with pytest.raises(InputError, match="--name NAME"):
        evaluate(parser().parse_args(["--submit", str(maps), "--benchmark", str(folder)]))


@pytest.mark.slow
def test_a_rendered_part_has_the_same_sums_when_made_twice_by_different_processes(tmp_path: Path):
    code = (
        "import sys; from pathlib import Path; from dataclasses import replace\n"
        "from huesphere.eval.benchmark import V1, make_benchmark\n"
        "make_benchmark(replace(V1, resolution=24), Path(sys.argv[1]), only=['sphere-skin-1'])"
    )
    for name, seed in (("a", "1"), ("b", "2")):  # dictionaries and sets of texts are hashed otherwise
        done = subprocess.run(
            [sys.executable, "-c", code, tmp_path / name],
            env={**os.environ, "PYTHONHASHSEED": seed},
            capture_output=True,
            text=True,
            cwd=ROOT,
        )
        assert done.returncode == 0, done.stderr
    files = [{p.relative_to(tmp_path / n): p.read_bytes() for p in (tmp_path / n).rglob("*.*")} for n in "ab"]
    assert files[0] == files[1]
