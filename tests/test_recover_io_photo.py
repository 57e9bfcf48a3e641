"""Cameras' own files, HEIC and AVIF, levels of samples, dark and flat frames, masks of labels."""

import sys

import numpy as np
import pytest
import tifffile
from picture_files import mosaic, png_with, smooth, write_dng, write_packed_tiff
from PIL import Image

from huesphere.configs.errors import InputError
from huesphere.recover.io.levels import levels
from huesphere.recover.io.picture import ReadOptions, open_picture, read_mask, read_picture
from huesphere.scenes.encoding import encode_srgb

IMAGE = smooth(64, 80, 0.05, 0.8)


# ---- raw files -------------------------------------------------------------------------------------------------------


def test_a_raw_file_is_linear_light_of_the_sensors_own_colours(tmp_path):
    pytest.importorskip("rawpy", reason="rawpy is in the extra 'photo'")
    write_dng(tmp_path / "a.dng", mosaic(IMAGE, black=256, white=16383), black=256, white=16383)
    read = open_picture(tmp_path / "a.dng")
    inner = np.s_[4:-4, 4:-4]
    assert read.observation.rgb[inner] == pytest.approx(IMAGE[inner], abs=2e-3)  # interpolated, of a smooth picture
    assert read.certain
    assert (read.observation.camera.bits, read.observation.camera.saturation) == (14, 1.0)
    for said in ("linear", "black level 256 subtracted, white level 16383", "no white balance"):
        assert said in read.how


def test_half_size_takes_each_cell_of_the_mosaic_as_a_pixel(tmp_path):
    pytest.importorskip("rawpy", reason="rawpy is in the extra 'photo'")
    seen = mosaic(IMAGE)
    write_dng(tmp_path / "a.dng", seen)
    observation, how = read_picture(tmp_path / "a.dng", options=ReadOptions(half_size=True))
    light = (seen.astype(float) - 64) / (4095 - 64)
    green = (light[0::2, 1::2] + light[1::2, 0::2]) / 2
    wanted = np.stack([light[0::2, 0::2], green, light[1::2, 1::2]], axis=-1)
    assert observation.rgb == pytest.approx(wanted, abs=1e-4)
    assert "one pixel for each cell" in how


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_a_raw_file_is_turned_upright(tmp_path, orientation):
    pytest.importorskip("rawpy", reason="rawpy is in the extra 'photo'")
    turns = {1: 0, 3: 2, 6: 1, 8: 3}
    stored = np.ascontiguousarray(np.rot90(IMAGE, turns[orientation]))
    write_dng(tmp_path / "a.dng", mosaic(stored), orientation=orientation)
    observation, _ = read_picture(tmp_path / "a.dng")
    assert observation.rgb.shape == IMAGE.shape
    assert observation.rgb[4:-4, 4:-4] == pytest.approx(IMAGE[4:-4, 4:-4], abs=3e-3)


def test_white_balance_and_white_level_of_a_raw_file_are_the_users_to_choose(tmp_path):
    pytest.importorskip("rawpy", reason="rawpy is in the extra 'photo'")
    write_dng(tmp_path / "a.dng", mosaic(IMAGE), neutral=(0.5, 1.0, 0.8))
    plain, _ = read_picture(tmp_path / "a.dng")
    balanced, how = read_picture(tmp_path / "a.dng", options=ReadOptions(white_balance="camera"))
    dark = np.s_[8:12, 8:12]  # where no channel is clipped by the balance
    ratio = balanced.rgb[dark] / plain.rgb[dark]
    assert ratio.mean(axis=(0, 1)) == pytest.approx([2.0, 1.0, 1.25], rel=5e-3)
    assert "white balance of the camera" in how
    level = 64 + (4095 - 64) // 2
    halved, how = read_picture(tmp_path / "a.dng", options=ReadOptions(white_level=level))
    assert f"white level {level}" in how
    assert halved.rgb[dark][..., :2] == pytest.approx(2 * plain.rgb[dark][..., :2], rel=2e-3)
    assert (halved.rgb[..., 2] >= halved.camera.saturation).any()
    assert not (plain.rgb >= plain.camera.saturation).any()


def test_a_mosaic_in_a_tiff_is_read_as_raw(tmp_path):
    pytest.importorskip("rawpy", reason="rawpy is in the extra 'photo'")
    write_dng(tmp_path / "a.tif", mosaic(IMAGE))
    assert "mosaic interpolated" in read_picture(tmp_path / "a.tif")[1]


@pytest.mark.parametrize(("name", "package"), [("a.nef", "rawpy"), ("a.heic", "pillow_heif")])
def test_a_missing_package_is_named_with_the_line_that_installs_it(tmp_path, monkeypatch, name, package):
    (tmp_path / name).write_bytes(b"anything")
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(InputError, match=r"pip install 'huesphere\[photo\]'"):
        read_picture(tmp_path / name)


@pytest.mark.parametrize("name", ["a.dng", "a.cr2", "a.cr3", "a.nef", "a.arw", "a.raf", "a.heic", "a.avif"])
def test_damaged_files_of_cameras_are_refused_in_one_line(tmp_path, name):
    pytest.importorskip("rawpy", reason="rawpy is in the extra 'photo'")
    pytest.importorskip("pillow_heif", reason="pillow-heif is in the extra 'photo'")
    (tmp_path / name).write_bytes(b"II*\0" + bytes(range(256)) * 9)
    with pytest.raises(InputError, match="not a readable") as caught:
        read_picture(tmp_path / name)
    assert "\n" not in str(caught.value)


# ---- HEIC and AVIF ---------------------------------------------------------------------------------------------------


def test_heic_is_read_with_all_bits_and_upright(tmp_path):
    pillow_heif = pytest.importorskip("pillow_heif", reason="pillow-heif is in the extra 'photo'")
    encoded = encode_srgb(IMAGE)
    ten_bits = np.round(1023 * encoded).astype(np.uint16) << 6
    height, width = IMAGE.shape[:2]
    file = pillow_heif.from_bytes("RGB;16", (width, height), ten_bits.tobytes())
    file.save(tmp_path / "a.heic", quality=-1, chroma=444)
    observation, how = read_picture(tmp_path / "a.heic")
    assert observation.rgb == pytest.approx(IMAGE, abs=0.01)
    assert observation.camera.bits == 10
    assert "10-bit, sRGB" in how
    exif = Image.Exif()
    exif[0x0112] = 6
    turned = Image.fromarray(np.rot90(np.round(255 * encoded).astype(np.uint8)).copy())
    pillow_heif.from_pillow(turned).save(tmp_path / "b.heic", quality=-1, chroma=444, exif=exif.tobytes())
    assert read_picture(tmp_path / "b.heic")[0].rgb == pytest.approx(IMAGE, abs=0.05)


def test_avif_is_read_with_all_bits_and_upright(tmp_path):
    imagecodecs = pytest.importorskip("imagecodecs")
    encoded = encode_srgb(IMAGE)
    for bits in (10, 12):
        samples = np.round((2**bits - 1) * encoded).astype(np.uint16)
        (tmp_path / "a.avif").write_bytes(imagecodecs.avif_encode(samples, bitspersample=bits, level=100))
        observation, how = read_picture(tmp_path / "a.avif")
        assert observation.rgb == pytest.approx(IMAGE, abs=0.01)
        assert f"{bits}-bit" in how
    exif = Image.Exif()
    exif[0x0112] = 8
    turned = Image.fromarray(np.rot90(np.round(255 * encoded).astype(np.uint8), -1).copy())
    turned.save(tmp_path / "b.avif", quality=100, exif=exif)
    observation, how = read_picture(tmp_path / "b.avif")
    assert observation.rgb == pytest.approx(IMAGE, abs=0.05)
    assert "upright" in how


# ---- levels ----------------------------------------------------------------------------------------------------------


def sixteen(image: np.ndarray, full: int = 65535) -> np.ndarray:
    return np.round(full * np.clip(image, 0, 1)).astype(np.uint16)


def test_twelve_bits_in_sixteen_have_their_own_full_scale_and_clip_level(tmp_path):
    bright = smooth(60, 70, 0.1, 1.4)  # a part is clipped
    tifffile.imwrite(tmp_path / "low.tif", sixteen(bright, 4095), photometric="rgb")
    tifffile.imwrite(tmp_path / "moved.tif", sixteen(bright, 4095) << 4, photometric="rgb")
    clipped = (bright >= 1 - 0.5 / 4095).any(axis=-1)
    assert 0.05 < clipped.mean() < 0.9
    for name in ("low.tif", "moved.tif"):
        observation, how = read_picture(tmp_path / name)
        assert observation.rgb == pytest.approx(np.clip(bright, 0, 1), abs=2e-4), name
        found = (observation.rgb >= observation.camera.saturation).any(axis=-1)
        assert np.array_equal(found, clipped), name
        assert observation.camera.bits == 12
        assert "GUESSED to be linear" in how


@pytest.mark.parametrize("bits", [10, 12, 14])
def test_packed_samples_are_read_with_their_number_of_bits(tmp_path, bits):
    image = smooth(30, 41)
    write_packed_tiff(tmp_path / "a.tif", np.round((2**bits - 1) * image).astype(np.uint16), bits)
    observation, how = read_picture(tmp_path / "a.tif")
    assert observation.rgb == pytest.approx(image, abs=1.0 / 2**bits)
    assert observation.camera.bits == bits
    assert "GUESSED to be linear" in how


def test_a_full_scale_in_the_tags_is_obeyed(tmp_path):
    image = smooth(60, 70, 0.05, 0.5)
    largest = (281, "H", 3, (4000, 4000, 4000), True)
    tifffile.imwrite(tmp_path / "a.tif", sixteen(image, 4000), photometric="rgb", extratags=[largest])
    observation, how = read_picture(tmp_path / "a.tif")
    assert observation.rgb == pytest.approx(image, abs=2e-4)
    assert "full scale 4000, as its tags say" in how
    assert "GUESSED to be linear" in how


def test_a_flat_part_of_the_surface_is_not_taken_for_clipped():
    image = smooth(60, 70)
    image[20:50, 20:50] = [0.95, 0.4, 0.3]
    assert levels(sixteen(image), 65535.0, 16, None).remark is None


def test_a_clip_level_below_full_scale_is_found_where_samples_pile_up(tmp_path):
    bright = smooth(60, 70, 0.1, 1.4)
    samples = np.minimum(sixteen(bright), 52000)
    np.save(tmp_path / "a.npy", samples)
    observation, how = read_picture(tmp_path / "a.npy", encoding="linear")
    assert "clipped at 52000" in how
    assert np.array_equal((observation.rgb >= observation.camera.saturation), samples == 52000)


def test_a_picture_that_uses_its_range_keeps_its_levels():
    for image in (smooth(60, 70), 0.3 * smooth(60, 70), np.zeros((9, 9, 3))):
        found = levels(sixteen(image), 65535.0, 16, None)
        assert (found.full_scale, found.clip, found.of_sensor, found.remark) == (65535.0, 65535.0, False, None)


def test_the_white_level_of_the_user_is_used_or_refused(tmp_path):
    image = smooth(60, 70, 0.1, 1.4)
    tifffile.imwrite(tmp_path / "a.tif", sixteen(image), photometric="rgb")
    level = 50000
    observation, how = read_picture(tmp_path / "a.tif", encoding="linear", options=ReadOptions(white_level=level))
    assert "--white-level" in how
    stored = sixteen(image)
    assert np.array_equal(observation.rgb >= observation.camera.saturation, stored >= level)
    with pytest.raises(InputError, match=r"--white-level, got 70000, expected at most 65535"):
        read_picture(tmp_path / "a.tif", options=ReadOptions(white_level=70000))
    png_with(tmp_path / "b.png", (stored >> 8).astype(np.uint8))
    observation, _ = read_picture(tmp_path / "b.png", options=ReadOptions(white_level=250))
    assert np.array_equal(observation.rgb >= observation.camera.saturation, stored >> 8 >= 250)
    np.save(tmp_path / "c.npy", 30 * image)
    observation, _ = read_picture(tmp_path / "c.npy", options=ReadOptions(white_level=25))
    assert np.array_equal(observation.rgb >= observation.camera.saturation, np.float32(30 * image) >= 25)


# ---- dark and flat frames --------------------------------------------------------------------------------------------


def frames(folder):
    """A picture, its dark and its flat frame as a camera gives them, and the light that came in, to one factor."""
    light = smooth(48, 56, 0.1, 0.7)
    y, x = np.mgrid[:48, :56] / 50 - 0.5
    falloff = (1 - 0.6 * (x**2 + y**2))[..., None] * np.array([1.0, 0.9, 0.8])
    black = 0.02 + 0.01 * np.random.default_rng(0).random((48, 56, 3))
    seen = {"picture": light * falloff + black, "dark": black, "flat": 0.9 * falloff + black}
    for name, image in seen.items():
        tifffile.imwrite(folder / f"{name}.tif", sixteen(image), photometric="rgb")
    return light


def test_dark_and_flat_frames_give_the_light_that_came_in(tmp_path):
    light = frames(tmp_path)
    options = ReadOptions(dark=tmp_path / "dark.tif", flat=tmp_path / "flat.tif")
    observation, how = read_picture(tmp_path / "picture.tif", encoding="linear", options=options)
    ratio = observation.rgb / light
    assert ratio.reshape(-1, 3).std(axis=0) / ratio.mean() == pytest.approx(0, abs=2e-3)
    assert "dark frame dark.tif subtracted" in how
    assert "divided by flat frame flat.tif" in how


def test_frames_of_raw_files(tmp_path):
    """A raw frame of a camera held upright corrects a picture of the same camera held across: both are as it lies."""
    pytest.importorskip("rawpy", reason="rawpy is in the extra 'photo'")
    light, falloff = smooth(64, 80, 0.1, 0.6), 1 - 0.4 * smooth(64, 80)
    glow = np.full_like(light, 0.01)
    for name, image, orientation in (("a", light * falloff, 6), ("flat", 0.9 * falloff, 1), ("dark", 0 * light, 8)):
        write_dng(tmp_path / f"{name}.dng", mosaic(image + glow, white=16383), white=16383, orientation=orientation)
    options = ReadOptions(dark=tmp_path / "dark.dng", flat=tmp_path / "flat.dng", half_size=True)
    observation, _ = read_picture(tmp_path / "a.dng", options=options)
    cells = light.reshape(32, 2, 40, 2, 3).mean(axis=(1, 3))
    ratio = observation.rgb / np.rot90(cells, -1)
    assert ratio.reshape(-1, 3).std(axis=0) / ratio.mean() == pytest.approx(0, abs=0.01)


def test_frames_are_applied_before_a_picture_is_turned(tmp_path):
    light = frames(tmp_path)
    stored = tifffile.imread(tmp_path / "picture.tif")
    tifffile.imwrite(tmp_path / "turned.tif", stored, photometric="rgb", extratags=[(274, "H", 1, 6, True)])
    options = ReadOptions(dark=tmp_path / "dark.tif", flat=tmp_path / "flat.tif")
    observation, _ = read_picture(tmp_path / "turned.tif", encoding="linear", options=options)
    ratio = observation.rgb / np.rot90(light, -1)
    assert ratio.reshape(-1, 3).std(axis=0) / ratio.mean() == pytest.approx(0, abs=2e-3)


def test_what_was_clipped_stays_clipped_and_nothing_else_is(tmp_path):
    frames(tmp_path)
    stored = tifffile.imread(tmp_path / "picture.tif")
    stored[10:14, 20:26, 1] = 65535
    tifffile.imwrite(tmp_path / "clipped.tif", stored, photometric="rgb")
    options = ReadOptions(dark=tmp_path / "dark.tif", flat=tmp_path / "flat.tif")
    observation, _ = read_picture(tmp_path / "clipped.tif", encoding="linear", options=options)
    found = (observation.rgb >= observation.camera.saturation).any(axis=-1)
    assert found[10:14, 20:26].all()
    assert found.sum() == 24


def test_frames_that_cannot_be_meant_are_refused(tmp_path):
    frames(tmp_path)
    np.save(tmp_path / "small.npy", np.ones((5, 5, 3)))
    tifffile.imwrite(tmp_path / "white.tif", np.full((48, 56, 3), 65535, np.uint16), photometric="rgb")
    for options, said in (
        (ReadOptions(dark=tmp_path / "small.npy"), "another size"),
        (ReadOptions(dark=tmp_path / "flat.tif"), "brighter than the picture"),
        (ReadOptions(flat=tmp_path / "white.tif"), "flat frame that is clipped"),
        (ReadOptions(flat=tmp_path / "dark.tif", dark=tmp_path / "dark.tif"), "flat frame without light"),
        (ReadOptions(dark=tmp_path / "none.tif"), "no such frame"),
    ):
        with pytest.raises(InputError, match=said):
            read_picture(tmp_path / "picture.tif", encoding="linear", options=options)


def test_pixels_where_the_flat_frame_is_dark_have_no_value(tmp_path):
    frames(tmp_path)
    flat = tifffile.imread(tmp_path / "flat.tif")
    flat[:3] = 0
    tifffile.imwrite(tmp_path / "flat.tif", flat, photometric="rgb")
    options = ReadOptions(flat=tmp_path / "flat.tif")
    observation, how = read_picture(tmp_path / "picture.tif", encoding="linear", options=options)
    assert np.isnan(observation.rgb[:3]).all()
    assert np.isfinite(observation.rgb[3:]).all()
    assert "168 px where it is dark" in how


# ---- masks -----------------------------------------------------------------------------------------------------------

INSIDE = smooth()[..., 0] > 0.5


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("a.png", INSIDE.astype(np.uint8)),
        ("a.png", 7 * INSIDE.astype(np.uint8)),
        ("a.png", 255 * INSIDE.astype(np.uint8)),
        ("a.png", np.dstack([0 * INSIDE, 0 * INSIDE, 90 * INSIDE]).astype(np.uint8)),
        ("a.png", np.dstack([0 * INSIDE] * 3 + [255 * INSIDE]).astype(np.uint8)),
        ("a.png", 3 * INSIDE.astype(np.uint16)),
        ("a.npy", INSIDE),
        ("a.npy", INSIDE.astype(np.int64)),
        ("a.npy", INSIDE.astype(np.float32)),
        ("a.npy", 255.0 * INSIDE),
        ("a.npy", INSIDE[None].astype(np.uint8)),
        ("a.tif", 12 * INSIDE.astype(np.uint8)),
        ("a.tif", INSIDE),
    ],
)
def test_masks_of_any_two_values_of_which_one_is_0(tmp_path, name, values):
    write = {"png": png_with, "npy": np.save, "tif": tifffile.imwrite}[name[-3:]]
    write(tmp_path / name, values)
    inside, how = read_mask(tmp_path / name, INSIDE.shape)
    assert np.array_equal(inside, INSIDE)
    assert f"{INSIDE.sum()} px" in how


def test_a_soft_mask_is_cut_at_half_of_full_scale(tmp_path):
    soft = np.round(255 * np.clip(smooth()[..., 0], 0, 1)).astype(np.uint8)
    png_with(tmp_path / "a.png", soft)
    inside, how = read_mask(tmp_path / "a.png", soft.shape)
    assert np.array_equal(inside, soft > 127)
    assert "over half of full scale" in how


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (np.zeros((9, 9), np.uint8), "0 everywhere"),
        (np.arange(81).reshape(9, 9).astype(np.uint8) % 3, "nowhere over half bright, got values 0, 1, 2"),
        (np.arange(81).reshape(9, 9).astype(np.uint8), "values from 0 to 80"),
    ],
)
def test_a_mask_without_an_object_is_refused_with_its_values(tmp_path, values, said):
    png_with(tmp_path / "a.png", values)
    with pytest.raises(InputError, match=said):
        read_mask(tmp_path / "a.png", (9, 9))
