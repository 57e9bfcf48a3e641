"""Where the object is in a picture without a mask: found on dark and plain backgrounds, not claimed on others."""

import numpy as np
import pytest
from PIL import Image

from huesphere.recover.io.object_finding import FoundObject, find_object
from huesphere.recover.one_picture import recover_picture

SIZE = 64
Y, X = np.mgrid[:SIZE, :SIZE]


def ball(background: np.ndarray, centre: tuple[float, float] = (32.0, 32.0), radius: float = 20.0):
    """(picture of a shaded ball on a background, where the ball is): three lights of three colours, no shadows."""
    x, y = (X - centre[0]) / radius, (centre[1] - Y) / radius
    inside = x**2 + y**2 < 1
    z = np.sqrt(np.where(inside, 1 - x**2 - y**2, 0.0))
    lights = np.array([[0.4, 0.0, 0.9], [-0.3, 0.3, 0.9], [-0.3, -0.3, 0.9]])
    colours = np.maximum(0, np.stack([x, y, z], axis=-1) @ lights.T)
    return np.where(inside[..., None], colours, background).astype(np.float32), inside


def plain(*rgb: float) -> np.ndarray:
    return np.broadcast_to(np.array(rgb), (SIZE, SIZE, 3))


def overlap(found: FoundObject, truth: np.ndarray) -> float:
    """Intersection over union of the object found and the true one."""
    assert found.mask is not None, found.said
    return float((found.mask & truth).sum() / (found.mask | truth).sum())


@pytest.mark.parametrize(
    ("background", "kind"),
    [
        (plain(0, 0, 0), "dark"),
        (plain(0.005, 0.004, 0.006), "dark"),
        (plain(0.1, 0.2, 0.9), "plain"),
        (plain(1, 1, 1), "plain"),
    ],
)
def test_a_ball_on_a_plain_background_is_found(background, kind):
    picture, truth = ball(background)
    found = find_object(picture)
    assert overlap(found, truth) > 0.85
    assert f"{found.mask.mean():.0%} of the picture" in found.said
    assert f"its {kind} background" in found.said
    assert "--mask" in found.said


def test_noise_of_a_camera_does_not_hide_the_object():
    picture, truth = ball(plain(0.02, 0.02, 0.02))
    noisy = picture + np.random.default_rng(5).normal(0, 0.004, picture.shape)
    assert overlap(find_object(noisy), truth) > 0.8


def test_an_object_may_touch_the_border():
    picture, truth = ball(plain(0, 0, 0), centre=(14.0, 32.0))
    assert truth[:, 0].any()
    assert overlap(find_object(picture), truth) > 0.85


def test_a_dark_hole_in_the_object_belongs_to_it():
    picture, truth = ball(plain(0, 0, 0))
    picture[28:34, 26:34] = 0
    assert overlap(find_object(picture), truth) > 0.85


@pytest.mark.parametrize(
    "picture",
    [
        ball(np.repeat(X[..., None] / SIZE, 3, axis=2))[0],
        ball(np.repeat(0.3 + 0.1 * Y[..., None] / SIZE, 3, axis=2))[0],
        ball(plain(0, 0, 0), radius=60.0)[0],
        np.random.default_rng(1).uniform(size=(SIZE, SIZE, 3)),
        plain(0.4, 0.4, 0.4),
        plain(0, 0, 0),
        np.full((SIZE, SIZE, 3), np.nan),
        ball(plain(0, 0, 0))[0][:9, :9],
        np.maximum(ball(plain(0, 0, 0), (16, 32), 12)[0], ball(plain(0, 0, 0), (48, 32), 12)[0]),
    ],
    ids=["gradient", "faint gradient", "fills it", "noise", "even", "black", "nan", "tiny", "two balls"],
)
def test_where_it_is_not_sure_the_whole_picture_is_taken_and_a_mask_is_asked_for(picture):
    found = find_object(picture)
    assert found.mask is None
    assert "whole picture" in found.said
    assert "--mask or --region" in found.said


def test_a_large_picture_is_reduced_and_its_mask_is_of_full_size():
    picture, truth = (np.repeat(np.repeat(one, 20, axis=0), 20, axis=1)[:-3] for one in ball(plain(0, 0, 0)))
    found = find_object(picture)
    assert found.mask.shape == truth.shape
    assert overlap(found, truth) > 0.85


def recovered(folder, name: str, values: np.ndarray, **asked) -> list[str]:
    """The lines that `recover` says of a picture that is stored as PNG."""
    Image.fromarray(np.round(255 * np.clip(values, 0, 1)).astype(np.uint8)).save(folder / name)
    lines: list[str] = []
    recover_picture(
        folder / name, ["least-squares"], encoding="linear", out=folder / "out", report=lines.append, **asked
    )
    return lines


def test_recover_says_what_it_took_and_leaves_what_has_a_region_or_an_alpha_alone(tmp_path):
    picture, truth = ball(plain(0, 0, 0))
    lines = recovered(tmp_path, "a.png", picture)
    assert sum("object found" in line for line in lines) == 1
    assert "Object found" in (tmp_path / "out/report.html").read_text(encoding="utf-8")
    lines = recovered(tmp_path, "b.png", picture, region=(8, 8, 56, 56), overwrite=True)
    assert not any("object found" in line or "taken for the object" in line for line in lines)
    with_alpha = np.dstack([picture, truth])
    lines = recovered(tmp_path, "c.png", with_alpha, overwrite=True)
    assert not any("object found" in line or "taken for the object" in line for line in lines)
    assert any("object where alpha is over a half" in line for line in lines)
