"""Pictures from elsewhere: bits, encodings, regions, masks, and what is refused."""

import struct
import zlib
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest
import tifffile
from synthesis import median_error
from test_recover_methods import relief

from huesphere.configs.errors import InputError
from huesphere.recover.io.picture import read_mask, read_picture
from huesphere.recover.methods.table import METHODS
from huesphere.render.dataset import write_observation
from huesphere.render.exr import write_exr
from huesphere.scenes.encoding import decode_srgb


def write_png(path: Path, samples: np.ndarray) -> None:
    """A PNG of uint8 or uint16 samples (H, W, C), rows filtered in turn as all five of the format's filters say."""
    height, width, channels = samples.shape
    size = samples.dtype.itemsize
    rows = samples.astype(samples.dtype.newbyteorder(">")).view(np.uint8).reshape(height, -1).astype(int)
    reach = channels * size
    lines = []
    for y, row in enumerate(rows):
        up = rows[y - 1] if y else np.zeros_like(row)
        left, up_left = (np.concatenate([np.zeros(reach, int), line[:-reach]]) for line in (row, up))
        p = left + up - up_left
        distance = np.abs(np.stack([p - left, p - up, p - up_left]))
        paeth = np.choose(distance.argmin(axis=0), [left, up, up_left])
        predicted = (np.zeros_like(row), left, up, (left + up) // 2, paeth)[y % 5]
        lines.append(bytes([y % 5]) + ((row - predicted) % 256).astype(np.uint8).tobytes())

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8 * size, {1: 0, 3: 2, 4: 6}[channels], 0, 0, 0)
    data = zlib.compress(b"".join(lines))
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b""))


def samples(kind, channels=3):
    top = np.iinfo(kind).max
    return np.random.default_rng(0).integers(0, top, (23, 31, channels), endpoint=True).astype(kind)


@pytest.mark.parametrize("channels", [3, 4])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_png_is_read_with_all_its_bits(tmp_path, kind, channels):
    written = samples(kind, channels)
    if channels == 4:
        written[..., 3] = np.iinfo(kind).max
    write_png(tmp_path / "a.png", written)
    observation, how = read_picture(tmp_path / "a.png", encoding="linear")
    top = np.iinfo(kind).max
    assert np.array_equal(np.round(observation.rgb.astype(float) * top), written[..., :3])
    assert observation.camera.bits == 8 * np.dtype(kind).itemsize
    assert "linear" in how


def test_sixteen_bit_png_is_what_common_readers_cut(tmp_path):
    """The reason for our own reading: should this fail, the common reader has learnt it and ours can go."""
    write_png(tmp_path / "a.png", samples(np.uint16))
    assert imageio.imread(tmp_path / "a.png").dtype == np.uint8


def test_tiff_of_sixteen_bits_and_of_floats(tmp_path):
    written = samples(np.uint16)
    tifffile.imwrite(tmp_path / "a.tif", written)
    tifffile.imwrite(tmp_path / "b.tif", (written / 65535).astype(np.float32), photometric="rgb")
    a, _ = read_picture(tmp_path / "a.tif")
    b, how = read_picture(tmp_path / "b.tif")
    assert a.rgb == pytest.approx(decode_srgb(b.rgb), abs=5e-7)  # single precision, stretched by up to 2.3
    assert (a.camera.stored_as, b.camera.stored_as) == ("srgb", "linear")
    assert "linear" in how


def test_jpeg_is_taken_as_srgb_and_said_so(tmp_path):
    imageio.imwrite(tmp_path / "a.jpg", np.full((32, 32, 3), 128, np.uint8))
    observation, how = read_picture(tmp_path / "a.jpg")
    assert "sRGB" in how
    assert (observation.camera.encoding, observation.camera.stored_as) == ("linear", "srgb")
    assert observation.rgb == pytest.approx(0.2158605, abs=0.004)  # of 128 of 255, decoded
    assert observation.camera.saturation == 1.0
    assert not observation.camera.known


def test_srgb_decoding_of_known_values():  # IEC 61966-2-1
    assert decode_srgb(np.array([0.0, 0.04045, 0.5, 1.0])) == pytest.approx([0, 0.0031308, 0.21404, 1], abs=1e-5)


def test_exr_arrays_and_observations(tmp_path):
    rgb = np.random.default_rng(0).uniform(0, 1, (12, 17, 3)).astype(np.float32)
    write_exr(tmp_path / "a.exr", dict(zip("RGB", np.moveaxis(rgb, -1, 0))))
    np.save(tmp_path / "a.npy", rgb)
    np.savez(tmp_path / "a.npz", rgb=rgb, mask=rgb[..., 0] > 0.5)
    for name in ("a.exr", "a.npy", "a.npz"):
        observation, _ = read_picture(tmp_path / name)
        assert np.array_equal(observation.rgb, rgb)
    assert np.array_equal(observation.mask, rgb[..., 0] > 0.5)
    ours, _, _ = relief(64)
    write_observation(tmp_path / "observation.exr", ours)
    assert read_picture(tmp_path / "observation.exr")[0].camera == ours.camera


def test_region_and_mask(tmp_path):
    written = samples(np.uint8)
    write_png(tmp_path / "a.png", written)
    mask = np.zeros((23, 31, 1), np.uint8)
    mask[5:10, 8:20] = 255
    write_png(tmp_path / "mask.png", mask)
    observation, _ = read_picture(
        tmp_path / "a.png", region=(6, 4, 30, 20), mask=tmp_path / "mask.png", encoding="linear"
    )
    assert observation.rgb.shape == (16, 24, 3)
    assert np.array_equal(np.round(observation.rgb * 255), written[4:20, 6:30])
    assert observation.mask.sum() == 60
    assert observation.mask[1:6, 2:14].all()


@pytest.mark.parametrize("region", [(0, 0, 0, 5), (5, 0, 2, 5), (0, 0, 32, 5), (-1, 0, 4, 4)])
def test_a_region_outside_the_picture_is_refused(tmp_path, region):
    write_png(tmp_path / "a.png", samples(np.uint8))
    with pytest.raises(InputError, match=r"--region.*X1 ≤ 31"):
        read_picture(tmp_path / "a.png", region=region)


def test_what_is_no_colour_picture_is_refused_in_one_line(tmp_path):
    write_png(tmp_path / "grey.png", samples(np.uint8, 1))
    (tmp_path / "broken.png").write_bytes(b"\x89PNG\r\n\x1a\nrubbish")
    (tmp_path / "a.txt").write_text("no picture")
    np.savez(tmp_path / "other.npz", depth=np.ones(3))
    write_png(tmp_path / "a.png", samples(np.uint8))
    for name, what in {
        "grey.png": "a colour picture",
        "broken.png": "not a readable picture",
        "a.txt": "kind of picture",
        "other.npz": "no array 'rgb'",
        "none.png": "no such picture",
    }.items():
        with pytest.raises(InputError, match=what) as caught:
            read_picture(tmp_path / name)
        assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match="differ in size"):
        read_mask(tmp_path / "a.png", (5, 5))


def test_a_sixteen_bit_picture_is_recovered_better_than_its_eight_bits(tmp_path):
    observation, normals, _ = relief(96)
    linear = np.clip(observation.rgb, 0, 1)
    for bits, kind in ((8, np.uint8), (16, np.uint16)):
        top = 2**bits - 1
        write_png(tmp_path / f"{bits}.png", np.round(linear * top).astype(kind))
    mask = (observation.mask * 255).astype(np.uint8)[..., None]
    write_png(tmp_path / "mask.png", mask)
    errors = []
    for bits in (8, 16):
        picture, _ = read_picture(tmp_path / f"{bits}.png", mask=tmp_path / "mask.png", encoding="linear")
        errors.append(median_error(METHODS["weak-integrability"](picture), normals))
    assert errors[1] < 0.05
    assert errors[1] < 0.2 * errors[0]


def test_a_picture_becomes_a_page_with_normals_depth_and_what_hangs_on_the_encoding(tmp_path):
    from huesphere.recover.io.estimate import read_estimate
    from huesphere.recover.one_picture import recover_picture

    observation, *_ = relief(96)
    samples = np.round(65535 * np.clip(observation.rgb, 0, 1)).astype(np.uint16)
    write_png(tmp_path / "a<b>.png", samples)
    imageio.imwrite(tmp_path / "mask.png", (255 * observation.mask).astype(np.uint8))
    said = []
    folder = recover_picture(
        tmp_path / "a<b>.png",
        ["drew-kontsevich"],
        mask=tmp_path / "mask.png",
        encoding="linear",
        out=tmp_path / "out",
        report=said.append,
    )
    page = (folder / "report.html").read_text()
    assert "a&lt;b&gt;.png" in page
    assert "a<b>" not in page
    assert "http" not in page
    assert "<script" not in page
    for name in ("normals", "depth", "relit"):
        assert (folder / f"drew-kontsevich-{name}.png").is_file()
    estimate, _ = read_estimate(folder / "estimates", "drew-kontsevich")
    assert np.isfinite(estimate.depth[observation.mask]).all()
    assert "had they been sRGB" in said[-2]
    assert "does not show that the lights" in said[-1]
    assert all(line.split(".")[0] in page for line in said[-2:])


def test_a_guess_of_the_encoding_is_tested_on_the_first_answer_and_said(tmp_path):
    from huesphere.recover.one_picture import recover_picture

    observation, *_ = relief(64)
    tifffile.imwrite(tmp_path / "a.tif", np.round(65535 * np.clip(observation.rgb, 0, 1)).astype(np.uint16))
    np.save(tmp_path / "mask.npy", observation.mask)
    said = []
    for encoding in ("auto", "linear"):
        recover_picture(
            tmp_path / "a.tif",
            ["weak-integrability"],
            mask=tmp_path / "mask.npy",
            encoding=encoding,
            out=tmp_path / encoding,
            report=said.append,
        )
    guess, _, note, *rest = said
    assert "GUESSED to be sRGB" in guess
    assert "had they been taken as linear, the normals would differ by" in note
    assert "THE GUESS IS PROBABLY WRONG: --encoding linear ends with ok." in note
    assert not any("GUESS" in line for line in rest[2:])


def test_of_a_raw_file_no_other_encoding_is_tried(tmp_path):
    from picture_files import mosaic, write_dng

    from huesphere.recover.one_picture import recover_picture

    pytest.importorskip("rawpy", reason="rawpy is in the extra 'photo'")
    observation, *_ = relief(64)
    write_dng(tmp_path / "a.dng", mosaic(np.clip(observation.rgb, 0, 1)))
    said = []
    recover_picture(tmp_path / "a.dng", ["least-squares"], out=tmp_path / "out", report=said.append)
    assert not any(line.startswith("Encoding") for line in said)


def test_options_of_pictures_are_read_from_the_command_line_and_refused_for_run_folders(tmp_path, monkeypatch, capsys):
    import sys

    from huesphere.recover.cli import main

    (tmp_path / "run").mkdir()
    np.save(tmp_path / "a.npy", np.ones((9, 9, 3)))
    for given, expected in (
        (["run", "--half-size"], "--half-size is for a picture"),
        (["run", "--white-level", "9"], "--white-level is for a picture"),
        (["run", "--dark", "a.npy"], "--dark is for a picture"),
        (["a.npy", "--half-size"], "--half-size is for cameras"),
        (["a.npy", "--flat", "none.npy"], "no such frame"),
        (["a.npy", "--white-level", "-3"], "expected a positive number"),
    ):
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", ["recover", *given])
        with pytest.raises(SystemExit) as end:
            main()
        assert end.value.code == 2
        assert expected in capsys.readouterr().err


def test_a_picture_that_fails_still_gets_its_page(tmp_path):
    from huesphere.recover.one_picture import recover_picture

    imageio.imwrite(tmp_path / "grey.png", np.full((40, 40, 3), 120, np.uint8))
    page = (
        recover_picture(tmp_path / "grey.png", ["drew-kontsevich"], out=tmp_path / "out") / "report.html"
    ).read_text()
    assert "Status flat-surface" in page or "Status rank-deficient-colours" in page
    assert "There are no normals" in page


def test_a_picture_mostly_nan_ends_with_its_status_and_says_that_there_are_no_normals(tmp_path):
    from huesphere.recover.io.estimate import read_estimate
    from huesphere.recover.one_picture import recover_picture

    image = np.full((40, 40), np.nan)
    image[:10] = 0.5
    write_exr(tmp_path / "nan.exr", dict.fromkeys("RGB", image))
    said = []
    folder = recover_picture(tmp_path / "nan.exr", ["weak-integrability"], out=tmp_path / "out", report=said.append)
    estimate, _ = read_estimate(folder / "estimates", "weak-integrability")
    assert estimate.status == "not-finite"
    assert not estimate.valid.any()
    (line,) = [line for line in said if line.startswith("nan.exr  ")]
    assert "not-finite: 1200 of 1600 pixels are NaN or infinite; mend the picture" in line
    assert said[-1].startswith("There are no normals")


def test_a_phone_held_upright_is_read_upright(tmp_path):
    from PIL import Image

    wide = np.zeros((20, 60, 3), np.uint8)
    wide[:, :20] = 250
    exif = Image.Exif()
    exif[0x0112] = 6  # turn by 90° clockwise
    Image.fromarray(wide).save(tmp_path / "phone.jpg", exif=exif, quality=95)
    observation, _ = read_picture(tmp_path / "phone.jpg")
    assert observation.rgb.shape == (60, 20, 3)
    assert observation.rgb[:15].mean() > 0.9 > 0.1 > observation.rgb[30:].mean()


@pytest.mark.parametrize("shape", [(0, 0, 3), (0, 8, 3), (8, 0, 3)])
def test_a_picture_without_pixels_is_refused(tmp_path, shape):
    np.save(tmp_path / "a.npy", np.zeros(shape, np.float32))
    with pytest.raises(InputError, match="rows of pixels"):
        read_picture(tmp_path / "a.npy")
