"""recover --calibrate and --rig: files in, rig.json and a folder of results out; bad input in one line."""

import numpy as np
import pytest
from PIL import Image
from test_recover_rig import PLACES, RADIUS, SIZE, flat, frame, press

from huesphere.configs.errors import InputError
from huesphere.recover import cli
from huesphere.recover.io.estimate import read_estimate
from huesphere.recover.rig.ball import Ball
from huesphere.recover.rig.command import RigOptions, calibrate_rig, recover_by_rig
from huesphere.recover.rig.model import read_rig


def save(path, rgb):
    Image.fromarray(np.round(255 * np.clip(rgb, 0, 1)).astype(np.uint8)).save(path)
    return path


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """(folder, pictures of presses, their balls, the reference, rig.json)."""
    folder = tmp_path_factory.mktemp("rig")
    known = [Ball(x, y, RADIUS, 4.0) for x, y in PLACES]
    pictures = [save(folder / f"{i}.png", frame(press(ball, 0.6), 0.003, i)) for i, ball in enumerate(known)]
    reference = save(folder / "empty.png", frame(flat()))
    path = calibrate_rig(pictures, known, RigOptions(reference=reference, encoding="linear", out=folder))
    return folder, pictures, known, reference, path


def test_presses_become_a_rig_and_a_picture_an_estimate(rig, tmp_path):
    folder, _, known, reference, path = rig
    model = read_rig(path)
    assert model.size == SIZE
    assert model.mm_per_px == pytest.approx(4.0 / RADIUS)
    assert model.divided
    said = []
    picture = save(folder / "touch.png", frame(press(Ball(40, 30, RADIUS), 0.6), 0.003, 50))
    options = RigOptions(reference=reference, encoding="linear", out=tmp_path / "out")
    [out] = recover_by_rig([picture], path, options, report=said.append)
    estimate, _ = read_estimate(out / "estimates", "rig")
    assert estimate.verdict == "trust", estimate.doubts
    assert estimate.depth is not None
    assert estimate.solution is not None
    assert (out / "report.html").is_file()
    assert any("trust" in line for line in said)
    assert len(known) == model.balls


def test_a_ball_in_full_view_is_found_and_calibrates(tmp_path):
    normals, distance = Ball(*PLACES[2], RADIUS).normals((SIZE[1], SIZE[0]))
    rgb = frame(np.where((distance < 1)[..., None], normals, 0))  # a part of it is in the shadow of each lamp
    picture = save(tmp_path / "ball.png", rgb)
    said = []
    path = calibrate_rig([picture], options=RigOptions(encoding="linear", out=tmp_path), report=said.append)
    assert any("found a ball" in line for line in said)
    assert read_rig(path).leave_one_out_deg < 5


def refused(*arguments, capsys, monkeypatch) -> str:
    monkeypatch.setattr("sys.argv", ["recover", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 2
    return capsys.readouterr().err


@pytest.mark.parametrize(
    ("ball", "message"),
    [
        ("500,20,16", "outside the picture"),
        ("40,30,3", "too small"),
        ("40,30", "expected X,Y,R"),
        ("a,b,c", "expected X,Y,R"),
        ("40,30,16,-1", "expected X,Y,R"),
    ],
)
def test_balls_that_cannot_be_meant_are_refused_in_one_line(rig, ball, message, capsys, monkeypatch, tmp_path):
    _, pictures, _, reference, _ = rig
    given = ["--calibrate", pictures[0], "--ball", ball, "--reference", reference, "--out", tmp_path]
    assert message in refused(*given, capsys=capsys, monkeypatch=monkeypatch)
    assert not (tmp_path / "rig.json").exists()


def test_pictures_references_and_options_that_do_not_fit_are_refused(rig, capsys, monkeypatch, tmp_path):
    folder, pictures, _, reference, path = rig
    small = save(folder / "small.png", frame(flat((40, 30))))
    out = ["--out", tmp_path / "out"]
    cases = [
        ([small, "--rig", path, "--reference", reference], "another size than the rig's"),
        ([pictures[0], "--rig", path, "--reference", small], "another size than the rig's"),
        ([pictures[0], "--rig", path], "reference"),
        ([pictures[0], "--rig", folder / "none.json"], "no such rig"),
        ([pictures[0], "--rig", path, "--method", "auto"], "--method cannot go with --rig"),
        ([pictures[0], "--rig", path, "--ball", "4,4,20"], "--ball cannot go with --rig"),
        ([pictures[0], "--reference", reference], "--reference is for --calibrate and --rig"),
        (["--calibrate", *pictures, "--ball", "4,4,20"], "5 pictures"),
        (["--calibrate", pictures[0], "--reference", reference], "without --ball"),
        (["--calibrate", pictures[0], small, "--ball", "40,30,16", "--ball", "20,15,9"], "another size"),
    ]
    for given, message in cases:
        assert message in refused(*given, *out, capsys=capsys, monkeypatch=monkeypatch)
    assert not (tmp_path / "out").exists()


def test_a_rig_that_is_there_is_kept(rig):
    folder, pictures, known, _, _ = rig
    with pytest.raises(InputError, match="overwrite"):
        calibrate_rig(pictures, known, RigOptions(out=folder))
