"""The folder of one picture's results: methods are added, and results of two pictures never share it."""

import json

import imageio.v3 as imageio
import numpy as np
import pytest
from test_recover_methods import relief

from huesphere.configs.errors import InputError
from huesphere.recover.one_picture import recover_picture

SIDE = 32  # pixels


def picture(path, *, mirrored=False):
    path.parent.mkdir(parents=True, exist_ok=True)
    rgb = np.round(255 * np.clip(relief(SIDE)[0].rgb, 0, 1)).astype(np.uint8)
    imageio.imwrite(path, rgb[:, ::-1] if mirrored else rgb)
    return path


def names(folder):
    return sorted(p.name for p in (folder / "estimates").glob("*.json")), sorted(p.name for p in folder.glob("*.png"))


def test_a_second_method_of_the_same_picture_is_added_and_both_are_on_the_page(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = picture(tmp_path / "shots/ball.png")
    folder = recover_picture(path, ["least-squares"])
    before = (folder / "estimates/least-squares.exr").read_bytes()
    assert recover_picture(path, ["drew-kontsevich", "least-squares"]) == folder
    assert (folder / "estimates/least-squares.exr").read_bytes() == before
    assert names(folder)[0] == ["drew-kontsevich.json", "least-squares.json"]
    page = (folder / "report.html").read_text()
    assert "<h2>least-squares</h2>" in page
    assert "<h2>drew-kontsevich</h2>" in page
    with pytest.raises(InputError, match="estimates already"):
        recover_picture(path, ["least-squares"])
    record = json.loads((folder / "estimates/least-squares.json").read_text())
    recover_picture(path, ["least-squares"], overwrite=True)
    assert json.loads((folder / "estimates/least-squares.json").read_text())["seconds"] != record["seconds"]
    assert "<h2>drew-kontsevich</h2>" in (folder / "report.html").read_text()


@pytest.mark.parametrize("change", ["another picture", "encoding", "mask"])
def test_results_of_another_picture_are_refused_and_removed_when_overwritten(tmp_path, monkeypatch, change):
    monkeypatch.chdir(tmp_path)
    folder = recover_picture(picture(tmp_path / "a/shot.png"), ["least-squares"])
    first = (folder / "observation.exr").read_bytes()
    other = picture(tmp_path / "b/shot.png", mirrored=change == "another picture")
    mask = np.zeros((SIDE, SIDE), np.uint8)
    mask[4:-4, 4:-4] = 255
    imageio.imwrite(tmp_path / "mask.png", mask)
    options = {
        "encoding": {"encoding": "linear"},
        "mask": {"mask": tmp_path / "mask.png"},
    }.get(change, {})
    (folder / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="results of another picture, or of this one read otherwise"):
        recover_picture(other, ["weak-integrability"], **options)
    assert (folder / "observation.exr").read_bytes() == first
    recover_picture(other, ["weak-integrability"], overwrite=True, **options)
    estimates, images = names(folder)
    assert estimates == ["weak-integrability.json"]
    assert not (folder / "estimates/least-squares.exr").exists()
    assert all(name.startswith("weak-integrability") for name in images)
    assert "least-squares" not in (folder / "report.html").read_text()
    assert (folder / "notes.txt").read_text() == "mine"


def test_a_copy_of_the_picture_is_the_same_picture(tmp_path):
    one, two = picture(tmp_path / "a/shot.png"), picture(tmp_path / "b/shot.png")
    recover_picture(one, ["least-squares"], out=tmp_path / "out")
    recover_picture(two, ["drew-kontsevich"], out=tmp_path / "out")
    assert names(tmp_path / "out")[0] == ["drew-kontsevich.json", "least-squares.json"]


def test_a_method_that_now_fails_leaves_no_old_images(tmp_path):
    path = picture(tmp_path / "shot.png")
    folder = recover_picture(path, ["least-squares"], out=tmp_path / "out")
    (folder / "drew-kontsevich-normals.png").write_bytes(b"old")
    recover_picture(path, ["drew-kontsevich"], out=folder)
    assert (folder / "drew-kontsevich-normals.png").read_bytes() != b"old"


def test_a_damaged_estimate_is_made_again(tmp_path):
    path = picture(tmp_path / "shot.png")
    folder = recover_picture(path, ["least-squares"], out=tmp_path / "out")
    (folder / "estimates/least-squares.exr").write_bytes(b"")
    recover_picture(path, ["least-squares"], out=folder)
    assert (folder / "estimates/least-squares.exr").stat().st_size > 1000


def test_a_linked_folder_of_estimates_is_not_written_into(tmp_path):
    (tmp_path / "theirs").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "out/estimates").symlink_to(tmp_path / "theirs")
    with pytest.raises(InputError, match="a link, expected a folder of estimates"):
        recover_picture(picture(tmp_path / "shot.png"), ["least-squares"], out=tmp_path / "out")
    assert list((tmp_path / "theirs").iterdir()) == []
