"""The tactile membrane: the object's height where it is touched, a fall to its plane around, all in millimetres."""

import numpy as np
import pytest

from huesphere.configs.errors import InputError
from huesphere.configs.load import load_configs, validate
from huesphere.configs.schema import Camera, Gel
from huesphere.render.dataset import open_run
from huesphere.render.run import render_configs
from huesphere.scenes.gel import gel_mesh, gel_view, membrane

STEP = 0.1
X, Y = np.meshgrid((np.arange(240) - 119.5) * STEP, -(np.arange(200) - 99.5) * STEP)


def pressed(**keys):
    return membrane(X, Y, Gel(kind="gel", **keys), STEP)


def test_at_rest_it_is_the_plane():
    assert (pressed(indenter="none") == 0).all()


def test_under_a_ball_it_is_that_sphere_and_beyond_it_falls_off():
    height = pressed(indenter="ball", diameter=8, press=1.0, softness=0.4)
    r = np.hypot(X, Y)
    sphere = 1.0 - 4 + np.sqrt(np.maximum(16 - r**2, 0))
    # The circle of contact has the radius sqrt(R² − (R − d)²) = 2.65 mm; its inside is not touched by the smoothing.
    inside = r < 2.0
    assert height[inside] == pytest.approx(sphere[inside], abs=0.01)
    along = height[100, 120:]
    assert (np.diff(along) <= 1e-12).all()
    assert 0.02 < along[30] < 0.6
    assert along[-1] < 0.01


def test_a_softer_membrane_falls_off_farther_away():
    near, far = (pressed(diameter=8, softness=softness)[100, 160] for softness in (0.2, 0.8))
    assert far > near + 0.02


def test_pressing_deeper_touches_more():
    areas = [(pressed(diameter=8, press=press) > 0.3 * press).sum() for press in (0.5, 1.5)]
    assert areas[1] > 2 * areas[0]


def test_a_screw_is_periodic_in_its_pitch_and_a_turned_key_is_the_turned_picture():
    crest = pressed(indenter="screw", diameter=10, press=1.0, softness=0.2)[100, 20:220]
    assert crest[20:] == pytest.approx(crest[:-20], abs=2e-3)  # a pitch of a fifth of 10 mm
    assert np.ptp(crest) > 0.3
    key, turned = (pressed(indenter="key", diameter=6, softness=0.3, turn=turn) for turn in (0, 180))
    assert turned == pytest.approx(key[::-1, ::-1], abs=1e-9)
    assert (key > 0.9).mean() > 0.02


def test_a_depth_map_is_pressed_like_the_ball_it_shows(tmp_path):
    row, column = np.mgrid[:160, :160]
    square = 80.0**2 - (row - 79.5) ** 2 - (column - 79.5) ** 2
    np.savez(tmp_path / "ball.npz", depth=np.sqrt(np.maximum(square, 0)), mask=square > 0)
    own = pressed(indenter="ball", diameter=8)
    read = pressed(indenter={"path": str(tmp_path / "ball.npz"), "width": 8.0})
    assert read == pytest.approx(own, abs=0.01)
    with pytest.raises(InputError, match="no such depth map"):
        pressed(indenter={"path": str(tmp_path / "none.npz")})


def test_the_camera_stands_still_whatever_is_pressed():
    camera = Camera(projection="perspective", resolution=(40, 30))
    views = [
        gel_view(gel_mesh(Gel(kind="gel", detail=40, indenter=i), lambda _: None), camera) for i in ("none", "ball")
    ]
    assert views[0].eye == views[1].eye
    assert views[0].pixel_size == views[1].pixel_size
    assert views[0].reference == 0


def test_truth_is_in_millimetres_and_black_dots_are_a_second_material(tmp_path):
    names = ["camera.resolution=[48,36]", "shape.detail=104", "shape.turn=0", "sweep.shape.indenter=[none, ball]"]
    configs = load_configs("tactile_gel", overrides=[*names, "render.transport=direct", "render.target_rms=0.05"])
    quiet = {"engine": "auto", "overwrite": False, "progress": lambda *_: None, "log": lambda _: None}
    render_configs(configs, tmp_path / "run", **quiet)
    ball, rest = open_run(tmp_path / "run")
    assert rest.config().shape.indenter == "none"
    truth, at_rest = ball.truth(), rest.truth()
    assert truth.facts["unit"] == "mm"
    assert np.nanmax(truth.extra["depth_mm"]) == pytest.approx(1.2, abs=0.1)
    assert np.nanmax(np.abs(at_rest.extra["depth_mm"])) < 1e-6
    # Black dots cover π r² / s² of the membrane; here 2.2 and 0.4 mm.
    dots = at_rest.extra["material"][at_rest.mask] == 1
    assert dots.mean() == pytest.approx(np.pi * 0.4**2 / 2.2**2, rel=0.3)
    rgb = rest.observation().rgb[at_rest.mask]
    assert rgb[dots].mean() < 0.2 * rgb[~dots].mean()
    # Green comes from the left, blue from above, red from below right.
    picture = rest.observation().rgb
    assert picture[12:24, :6, 1].mean() > 2 * picture[12:24, -6:, 1].mean()
    assert picture[:5, 18:30, 2].mean() > 2 * picture[-5:, 18:30, 2].mean()
    assert picture[-5:, 24:, 0].mean() > 2 * picture[:5, :24, 0].mean()


def test_a_wrong_indenter_is_one_line():
    with pytest.raises(InputError, match=r"shape\.indenter") as caught:
        validate(
            {"name": "x", "shape": {"kind": "gel", "indenter": "kee"}, "lights": [{"direction": [0, 0, 1]}]}, where="x"
        )
    assert "\n" not in str(caught.value)
