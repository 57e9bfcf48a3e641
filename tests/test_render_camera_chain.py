"""The chain of a real camera, step by step: each has its own law, and none does anything unless it is asked for."""

import numpy as np
import pytest
from scipy import ndimage

from huesphere.configs.camera_chain import PRESETS
from huesphere.configs.load import dump_config, load_config
from huesphere.configs.schema import Camera
from huesphere.render import developing
from huesphere.render.dataset import open_run
from huesphere.render.run import render_configs
from huesphere.render.sensor import camera_info, demosaiced, expose, mosaic, read_out, through_lens
from huesphere.scenes.cameras import sensitivity
from huesphere.scenes.encoding import decode_srgb
from huesphere.scenes.spectra import emission

NIKON = sensitivity("Nikon 5100 (NPL)")
FLAT = np.full((64, 64, 3), 0.5)


def scene(size=48):
    """A smooth colour picture (H, W, 3)."""
    y, x = np.mgrid[:size, :size] / size
    return np.stack([0.2 + 0.6 * x, 0.5 + 0.3 * np.sin(5 * y), 0.7 - 0.5 * x * y], axis=-1)


# ---- lens ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("blur", [0.7, 2.0])
def test_a_point_spreads_to_a_gaussian_of_the_same_light(blur):
    point = np.zeros((41, 41, 3))
    point[20, 20] = [1, 2, 3]
    spread = through_lens(point, Camera(blur=blur))
    assert spread.sum(axis=(0, 1)) == pytest.approx([1, 2, 3])
    offset = np.arange(41) - 20
    variance = (spread[..., 0].sum(axis=0) * offset**2).sum()
    assert variance == pytest.approx(blur**2, rel=0.03)


def test_corners_lose_the_share_and_light_falls_as_the_fourth_power_of_the_cosine():
    seen = through_lens(np.ones((401, 401, 3)), Camera(vignetting=0.4))[..., 0]
    assert seen[200, 200] == pytest.approx(1, abs=1e-4)
    assert seen[0, 0] == pytest.approx(0.6, abs=5e-3)
    # tan θ is proportional to the distance from the middle: 1 / √(cos⁴ θ) − 1 = tan² θ falls on a straight line in r².
    tangent = seen[200, [250, 300, 350]] ** -0.5 - 1
    assert tangent / tangent[0] == pytest.approx([1, 4, 9], rel=1e-3)


# ---- sensor ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("pattern", ["RGGB", "BGGR", "GRBG", "GBRG"])
@pytest.mark.parametrize("method", ["bilinear", "Malvar 2004", "Menon 2007"])
def test_a_filter_array_passes_one_colour_and_demosaicing_keeps_it(pattern, method):
    picture = scene()
    seen = mosaic(picture, pattern)
    for number, letter in enumerate(pattern):
        at = np.s_[number // 2 :: 2, number % 2 :: 2]
        assert (seen[at] == picture[at][..., "RGB".index(letter)]).all()
    full = demosaiced(seen, pattern, method)
    assert mosaic(full, pattern) == pytest.approx(seen)
    assert np.abs(full - picture)[4:-4, 4:-4].max() < 0.01
    assert np.abs(full - picture).max() < 0.06  # at the border too
    uniform = demosaiced(mosaic(np.tile([0.2, 0.5, 0.7], (16, 16, 1)), pattern), pattern, method)
    assert uniform == pytest.approx(np.tile([0.2, 0.5, 0.7], (16, 16, 1)))


def test_pixels_have_gains_that_stay_from_picture_to_picture():
    keys = {"response_spread": 0.02, "read_noise": 0.005}
    first, second = (read_out(FLAT, Camera(**keys, seed=seed)) / 0.5 for seed in (1, 2))
    other = read_out(FLAT, Camera(**keys, seed=1, pattern_seed=9)) / 0.5
    # Two pictures of one sensor have only the gains in common: their covariance is the variance of the gains.
    assert np.mean((first - 1) * (second - 1)) == pytest.approx(0.02**2, rel=0.1)
    assert abs(np.mean((first - 1) * (other - 1))) < 0.02**2 / 4
    brighter = read_out(1.6 * FLAT, Camera(response_spread=0.02))
    assert brighter.std() == pytest.approx(0.8 * 0.02, rel=0.05)


def test_pixels_have_offsets_that_do_not_depend_on_light():
    dark, bright = (read_out(level * FLAT, Camera(dark_spread=0.01)) for level in (0, 1))
    assert dark.std() == pytest.approx(0.01, rel=0.05)
    assert bright - 0.5 == pytest.approx(dark)
    assert camera_info(Camera(dark_spread=0.003, read_noise=0.004)).read_noise == pytest.approx(0.005)


def test_a_pixel_interpolated_from_a_clipped_sample_counts_as_clipped():
    picture = np.full((32, 32, 3), 0.4)
    picture[16, 16] = 3.0
    camera = Camera(filter_array="RGGB", demosaicing="bilinear", bits=12)
    clipped = (expose(picture, camera) >= 1).all(axis=-1)
    assert clipped[15:18, 15:18].all()
    assert clipped.sum() == 9


# ---- developing ------------------------------------------------------------------------------------------------------


def test_white_balance_makes_its_white_grey():
    white = np.tile(emission("D65") @ NIKON / 100, (8, 8, 1))
    gains = developing.white_balance_gains(white, Camera(white_balance="daylight"), NIKON)
    assert np.ptp(white[0, 0] * gains) == pytest.approx(0, abs=1e-12)
    assert gains.min() == 1
    picture = scene()
    gains = developing.white_balance_gains(picture, Camera(white_balance="grey world"), NIKON)
    assert np.ptp((picture * gains).mean(axis=(0, 1))) == pytest.approx(0, abs=1e-12)
    assert (developing.white_balance_gains(picture, Camera(), NIKON) == 1).all()


def test_the_colour_matrix_of_a_camera_that_is_the_observer_is_that_of_srgb():
    # IEC 61966-2-1: D65 white, scaled to Y = 1, is (1, 1, 1), and sRGB's red is at x = 0.64, y = 0.33.
    xyz = sensitivity("CIE 1931")
    camera = Camera(colour_matrix="fitted", white_balance="daylight")
    white = emission("D65") @ xyz
    gains = developing.white_balance_gains(np.ones((2, 2, 3)), camera, xyz)
    matrix = developing.colour_matrix(camera, xyz, gains)
    red = matrix @ (gains * np.array([0.64, 0.33, 0.03]) / white.max())
    assert np.abs(red[1:]).max() < 0.01 * red[0]
    assert matrix.sum(axis=1) == pytest.approx(1)
    assert developing.colour_matrix(camera, NIKON, gains).sum(axis=1) == pytest.approx(1)


@pytest.mark.parametrize("name", ["none", "srgb", "film"])
def test_tone_curves_rise_from_black_to_white(name):
    linear = np.linspace(0, 1, 1001)
    shown = developing.tone_curve(linear, name)
    assert shown[[0, -1]] == pytest.approx([0, 1])
    assert (np.diff(shown) > 0).all()
    if name == "srgb":
        assert decode_srgb(shown) == pytest.approx(linear, abs=1e-6)
    if name == "film":  # middle grey stays, with more contrast about it
        grey = decode_srgb(np.array([0.45, 0.5, 0.55]))
        assert developing.tone_curve(grey, name)[1] == pytest.approx(0.5)
        assert np.ptp(developing.tone_curve(grey, name)) > 0.11


def test_a_jpeg_of_less_quality_is_smaller_and_worse(tmp_path):
    from PIL import Image

    rng = np.random.default_rng(0)
    picture = np.clip(ndimage.gaussian_filter(rng.random((64, 64, 3)), (1, 1, 0)), 0, 1)
    sizes, errors = [], []
    for quality in (95, 40):
        camera = Camera(jpeg_quality=quality)
        developing.write_developed(tmp_path, picture, camera, NIKON)
        path = tmp_path / "developed.jpg"
        sizes.append(path.stat().st_size)
        exact = developing.developed(picture, camera, NIKON)
        errors.append(np.abs(np.asarray(Image.open(path), float) - exact).mean())
    assert sizes[1] < 0.6 * sizes[0]
    assert errors[1] > 1.5 * errors[0]
    developing.write_developed(tmp_path, picture, Camera(), NIKON)
    assert (np.asarray(Image.open(tmp_path / "developed.png")) == developing.developed(picture, Camera(), NIKON)).all()


@pytest.mark.parametrize("pattern", ["RGGB", "GBRG", None])
def test_the_raw_file_is_read_by_libraw_as_it_was_taken(tmp_path, pattern):
    rawpy = pytest.importorskip("rawpy", reason="the extra `photo` is not installed")
    camera = Camera(filter_array=pattern, bits=12, black_level=1 / 16, read_noise=0.01, exposure=1.0)
    samples = read_out(scene(), camera)
    developing.write_raw(tmp_path / "raw.dng", samples, camera, NIKON)
    again = tmp_path / "again.dng"
    developing.write_raw(again, samples, camera, NIKON)
    assert again.read_bytes() == (tmp_path / "raw.dng").read_bytes()
    digital = np.round((1 / 16 + (15 / 16) * samples) * 4095)
    with rawpy.imread(str(tmp_path / "raw.dng")) as raw:
        if pattern is None:
            assert (raw.raw_image[..., :3] == digital).all()
            return
        assert (raw.raw_image == mosaic(digital, pattern)).all()
        assert raw.white_level == 4095
        assert set(raw.black_level_per_channel) == {256}
        colours = "".join("RGBG"[number] for number in raw.raw_pattern.ravel())
        assert colours == pattern


# ---- the whole -------------------------------------------------------------------------------------------------------


def test_a_camera_without_the_chain_changes_nothing():
    assert (expose(scene(), Camera()) == scene().astype(np.float32)).all()


@pytest.mark.parametrize("name", list(PRESETS))
def test_a_preset_gives_the_keys_that_are_not_set(name):
    camera = Camera(preset=name, read_noise=0.25)
    assert camera.read_noise == 0.25
    assert {key: getattr(camera, key) for key in PRESETS[name] if key != "read_noise"} == {
        key: value for key, value in PRESETS[name].items() if key != "read_noise"
    }


def test_an_item_has_its_raw_file_and_developed_picture_beside_the_linear_observation(tmp_path):
    config = load_config(
        "sphere_quick",
        overrides=["camera.preset=phone", "camera.resolution=[32,32]", "render.transport=direct", "shape.detail=16"],
    )
    assert "preset: phone" in dump_config(config)
    quiet = {"engine": "auto", "overwrite": False, "progress": lambda *_: None, "log": lambda _: None}
    render_configs([config], tmp_path / "run", **quiet)
    (item,) = open_run(tmp_path / "run")
    files = {path["path"].rpartition("/")[2] for path in item.entry["files"]}
    assert {"raw.dng", "developed.jpg", "observation.exr"} <= files
    seen = item.observation()
    assert (seen.camera.encoding, seen.camera.bits, seen.camera.full_well) == ("linear", 10, 6000)
    # The observation is light: the lens's blur apart, it is the model F n of the truth to the camera's noise.
    truth = item.truth()
    inside = ndimage.binary_erosion((truth.attached_shadow == 0).all(axis=-1) & truth.mask, iterations=4)
    model = truth.normals[inside] @ np.array(truth.facts["F"]).T
    share = seen.rgb[inside].mean() / model.mean()
    assert 0.85 < share < 1.0  # what vignetting takes
    assert np.corrcoef(seen.rgb[inside].ravel(), model.ravel())[0, 1] > 0.98
