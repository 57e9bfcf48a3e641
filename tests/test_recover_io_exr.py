"""OpenEXR files of other programs: parts, layers, windows, alpha, primaries."""

import numpy as np
import OpenEXR
import pytest
from picture_files import exr_part, rgb_channels, smooth

from huesphere.configs.errors import InputError
from huesphere.recover.io.picture import ReadOptions, read_picture
from huesphere.render.dataset import CameraInfo, Observation, read_observation, write_observation
from huesphere.scenes.cameras import chromaticities, sensitivity

IMAGE = smooth()
OTHER = smooth()[::-1].copy()
DEPTH = {"Z": OTHER[..., 0]}


def write(path, *parts):
    OpenEXR.File(list(parts)).write(str(path))


@pytest.mark.parametrize(
    "parts",
    [
        [("N", rgb_channels(OTHER)), ("rgba", rgb_channels(IMAGE))],
        [("depth", DEPTH), ("C", rgb_channels(IMAGE))],
        [("albedo", rgb_channels(OTHER)), ("beauty", rgb_channels(IMAGE)), ("normals", rgb_channels(OTHER))],
        [("ViewLayer.Normal", rgb_channels(OTHER)), ("ViewLayer.Combined", rgb_channels(IMAGE, "ViewLayer.Combined"))],
        [("first", rgb_channels(IMAGE)), ("normals", rgb_channels(OTHER))],
    ],
)
def test_the_part_of_colour_is_the_picture(tmp_path, parts):
    write(tmp_path / "a.exr", *(exr_part(name, channels) for name, channels in parts))
    observation, how = read_picture(tmp_path / "a.exr")
    assert observation.rgb == pytest.approx(IMAGE, abs=1e-6)
    assert f"of {len(parts)}" in how


def test_parts_that_may_all_be_meant_are_refused_until_one_is_named(tmp_path):
    write(tmp_path / "a.exr", exr_part("left", rgb_channels(OTHER)), exr_part("right", rgb_channels(IMAGE)))
    with pytest.raises(InputError, match=r"2 parts that may be the picture, got left, right, expected --part NAME"):
        read_picture(tmp_path / "a.exr")
    for part in ("right", "1"):
        observation, how = read_picture(tmp_path / "a.exr", options=ReadOptions(part=part))
        assert observation.rgb == pytest.approx(IMAGE, abs=1e-6)
        assert "part right of 2" in how
    with pytest.raises(InputError, match=r"--part, got middle.*left, right"):
        read_picture(tmp_path / "a.exr", options=ReadOptions(part="middle"))


def test_the_layer_of_colour_is_the_picture_and_another_can_be_named(tmp_path):
    channels = rgb_channels(IMAGE, "ViewLayer.Combined") | rgb_channels(OTHER, "ViewLayer.DiffCol")
    channels |= {"ViewLayer.Normal.X": IMAGE[..., 0]}
    write(tmp_path / "a.exr", exr_part("", channels))
    observation, how = read_picture(tmp_path / "a.exr")
    assert observation.rgb == pytest.approx(IMAGE, abs=1e-6)
    assert "layer ViewLayer.Combined" in how
    for layer in ("ViewLayer.DiffCol", "diffcol"):
        observation, _ = read_picture(tmp_path / "a.exr", options=ReadOptions(layer=layer))
        assert observation.rgb == pytest.approx(OTHER, abs=1e-6)
    with pytest.raises(InputError, match=r"--layer, got Normal.*Combined.*DiffCol"):
        read_picture(tmp_path / "a.exr", options=ReadOptions(layer="Normal"))


def test_channels_without_a_prefix_come_before_layers_and_equal_layers_are_refused(tmp_path):
    write(tmp_path / "a.exr", exr_part("", rgb_channels(IMAGE) | rgb_channels(OTHER, "diffuse")))
    assert read_picture(tmp_path / "a.exr")[0].rgb == pytest.approx(IMAGE, abs=1e-6)
    write(tmp_path / "b.exr", exr_part("", rgb_channels(IMAGE, "key") | rgb_channels(OTHER, "fill")))
    with pytest.raises(InputError, match=r"2 layers that may be the picture.*key, fill|fill, key.*--layer"):
        read_picture(tmp_path / "b.exr")


@pytest.mark.parametrize(("x0", "y0"), [(3, 2), (-4, -3), (0, 7), (-5, 6)])
def test_the_picture_is_the_display_window(tmp_path, x0, y0):
    """A data window is where a program has data: inside the picture, or reaching out of it."""
    height, width = 18, 26
    window = (np.array([x0, y0], np.int32), np.array([x0 + 31, y0 + 23], np.int32))
    display = (np.array([0, 0], np.int32), np.array([width - 1, height - 1], np.int32))
    write(tmp_path / "a.exr", exr_part("", rgb_channels(IMAGE), dataWindow=window, displayWindow=display))
    wanted, inside = np.zeros((height, width, 3)), np.zeros((height, width), bool)
    for y in range(height):
        for x in range(width):
            if 0 <= y - y0 < 24 and 0 <= x - x0 < 32:
                wanted[y, x], inside[y, x] = IMAGE[y - y0, x - x0], True
    observation, how = read_picture(tmp_path / "a.exr")
    assert observation.rgb == pytest.approx(wanted, abs=1e-6)
    assert np.array_equal(observation.mask, inside)
    assert "data window 32×24 in a display window 26×18" in how
    np.save(tmp_path / "mask.npy", np.ones((height, width), np.uint8))
    assert read_picture(tmp_path / "a.exr", mask=tmp_path / "mask.npy")[0].mask.all()


def test_alpha_of_a_renderer_is_the_mask_and_its_colours_are_divided_by_it(tmp_path):
    alpha = np.clip(2 * IMAGE[..., 0] - 0.3, 0, 1)
    write(tmp_path / "a.exr", exr_part("", rgb_channels(IMAGE * alpha[..., None]) | {"A": alpha}))
    observation, how = read_picture(tmp_path / "a.exr")
    inside = alpha > 0.5
    assert np.array_equal(observation.mask, inside)
    assert observation.rgb[inside] == pytest.approx(IMAGE[inside], abs=1e-5)
    assert "object where alpha is over a half" in how


def test_primaries_of_a_file_are_kept_from_reading_to_writing(tmp_path):
    p3 = (0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.3127, 0.329)
    write(tmp_path / "a.exr", exr_part("", rgb_channels(IMAGE), chromaticities=p3))
    observation, how = read_picture(tmp_path / "a.exr")
    assert observation.camera.chromaticities == pytest.approx(p3, abs=1e-6)
    assert observation.rgb == pytest.approx(IMAGE, abs=1e-6)
    assert "primaries" in how
    write_observation(tmp_path / "observation.exr", observation)
    with OpenEXR.File(str(tmp_path / "observation.exr")) as file:
        assert file.header()["chromaticities"] == pytest.approx(p3, abs=1e-6)
    assert read_observation(tmp_path / "observation.exr").camera == observation.camera


def test_a_header_with_impossible_primaries_is_refused(tmp_path):
    camera = CameraInfo(chromaticities=(0.1, 0.2))
    seen = Observation(IMAGE.astype(np.float32), np.ones(IMAGE.shape[:2], bool), camera)
    from huesphere.render import dataset

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dataset, "write_exr", lambda *a, chromaticities, f=dataset.write_exr: f(*a))
        write_observation(tmp_path / "a.exr", seen)
    with pytest.raises(InputError, match=r"camera\.chromaticities"):
        read_observation(tmp_path / "a.exr")


def test_primaries_of_a_camera_are_those_of_the_best_linear_map_to_xyz():
    xyz = chromaticities(sensitivity("CIE 1931"))
    assert xyz == pytest.approx((1, 0, 0, 1, 0, 0, 1 / 3, 1 / 3), abs=0.01)
    nikon = chromaticities(sensitivity("Nikon 5100 (NPL)"))
    red, green, blue = np.array(nikon[:6]).reshape(3, 2)
    assert red[0] > green[0]
    assert green[1] > max(red[1], blue[1])


def test_an_option_that_means_nothing_for_a_file_is_refused(tmp_path):
    np.save(tmp_path / "a.npy", IMAGE)
    for options, said in (
        (ReadOptions(part="0"), "--part"),
        (ReadOptions(layer="x"), "--layer"),
        (ReadOptions(half_size=True), "--half-size"),
        (ReadOptions(white_balance="camera"), "--white-balance"),
    ):
        with pytest.raises(InputError, match=f"{said} is for"):
            read_picture(tmp_path / "a.npy", options=options)
    ours = Observation(IMAGE.astype(np.float32), np.ones(IMAGE.shape[:2], bool))
    write_observation(tmp_path / "observation.exr", ours)
    for options in (ReadOptions(dark=tmp_path / "a.npy"), ReadOptions(layer="x"), ReadOptions(white_level=3.0)):
        with pytest.raises(InputError, match="an observation of a run folder"):
            read_picture(tmp_path / "observation.exr", options=options)
    with pytest.raises(InputError, match="--encoding"):
        read_picture(tmp_path / "observation.exr", encoding="srgb")


def test_windows_of_absurd_size_are_refused_before_they_are_filled(tmp_path):
    display = (np.array([0, 0], np.int32), np.array([29999, 29999], np.int32))
    write(tmp_path / "a.exr", exr_part("", rgb_channels(IMAGE), displayWindow=display))
    with pytest.raises(InputError, match=r"a picture too large, got 3\.35 GiB"):
        read_picture(tmp_path / "a.exr")
