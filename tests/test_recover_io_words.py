"""What a PNG, JPEG or TIFF says of itself is obeyed: which way up, how it is encoded, inks, axes, alpha."""

import io

import numpy as np
import pytest
import tifffile
from picture_files import (
    exif_turned,
    gamma_curve,
    parametric_curve,
    png_with,
    profile,
    smooth,
    table_curve,
)
from PIL import Image, ImageCms

from huesphere.configs.errors import InputError
from huesphere.recover.io.icc import profile_transfer
from huesphere.recover.io.orientation import upright
from huesphere.recover.io.picture import ReadOptions, open_picture, read_picture
from huesphere.scenes.encoding import decode_srgb, encode_srgb


def stored(image: np.ndarray, kind: type = np.uint16) -> np.ndarray:
    return np.round(np.iinfo(kind).max * image).astype(kind)


def lying(image: np.ndarray, orientation: int) -> np.ndarray:
    """``image`` as a camera stores it that writes ``orientation``, made by search, not by inverting ``upright``."""
    turns = [np.rot90(flipped, k) for flipped in (image, image[:, ::-1]) for k in range(4)]
    found = next(t for t in turns if same(upright(t, orientation), image))
    return np.ascontiguousarray(found)


def same(a: np.ndarray, b: np.ndarray) -> bool:
    return a.shape == b.shape and bool(np.array_equal(a, b))


# ---- orientation -----------------------------------------------------------------------------------------------------


def test_orientations_are_those_of_exif():
    """Exif 2.32: the number says where row 0 and column 0 of the stored samples are seen."""
    corners = {1: "tl", 2: "tr", 3: "br", 4: "bl", 5: "lt", 6: "rt", 7: "rb", 8: "lb"}  # (row 0, column 0)
    for number, (first, second) in corners.items():
        image = np.zeros((4, 6), int)
        image[0], image[:, 0] = 1, 2
        image[0, 0] = 3
        seen = upright(image, number)
        edge = {"t": seen[0], "b": seen[-1], "l": seen[:, 0], "r": seen[:, -1]}
        assert (np.sort(edge[first])[:-1] == 1).all()  # the stored first row
        assert (np.sort(edge[second])[:-1] == 2).all()  # the stored first column


@pytest.mark.parametrize("orientation", range(1, 9))
def test_every_format_is_turned_upright_as_its_tag_says(tmp_path, orientation):
    image = smooth()
    samples = lying(stored(image), orientation)
    exif = Image.Exif()
    exif[0x0112] = orientation
    tifffile.imwrite(tmp_path / "a.tif", samples, photometric="rgb", extratags=[(274, "H", 1, orientation, True)])
    png_with(tmp_path / "a.png", samples, (b"eXIf", exif_turned(orientation)))
    png_with(tmp_path / "b.png", (samples >> 8).astype(np.uint8), (b"eXIf", exif_turned(orientation)))
    Image.fromarray((samples >> 8).astype(np.uint8)).save(tmp_path / "a.jpg", exif=exif, quality=98, subsampling=0)
    for name, off in (("a.tif", 1e-4), ("a.png", 1e-4), ("b.png", 0.01), ("a.jpg", 0.05)):
        observation, how = read_picture(tmp_path / name, encoding="linear")
        assert observation.rgb == pytest.approx(image, abs=off), name
        assert ("upright" in how) == (orientation > 1)


def test_a_mask_is_turned_by_its_own_tag(tmp_path):
    inside = smooth()[..., 0] > 0.5
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(255 * lying(inside, 6).astype(np.uint8)).save(tmp_path / "mask.jpg", exif=exif, quality=98)
    tifffile.imwrite(tmp_path / "mask.tif", 255 * lying(inside, 8).astype(np.uint8), extratags=[(274, "H", 1, 8, True)])
    np.save(tmp_path / "a.npy", smooth())
    for name in ("mask.jpg", "mask.tif"):
        observation, how = read_picture(tmp_path / "a.npy", mask=tmp_path / name)
        assert np.array_equal(observation.mask, inside)
        assert f"{name}: turned upright" in how


# ---- transfer functions ----------------------------------------------------------------------------------------------

BT709 = lambda light: np.where(light < 0.018, 4.5 * light, 1.099 * light**0.45 - 0.099)  # ITU-R BT.709-6, 1.2
HLG = lambda e: np.where(e <= 1 / 12, np.sqrt(3 * e), 0.17883277 * np.log(12 * e - 0.28466892) + 0.55991073)  # BT.2100
CHRM = np.array([31270, 32900, 64000, 33000, 30000, 60000, 15000, 6000], ">u4").tobytes()


def of_gama(gamma: float) -> tuple[bytes, bytes]:
    return b"gAMA", round(100000 * gamma).to_bytes(4, "big")


@pytest.mark.parametrize(
    ("chunks", "encode", "said"),
    [
        ([of_gama(1.0)], lambda v: v, "linear, as its gAMA says"),
        ([of_gama(1 / 1.8)], lambda v: v ** (1 / 1.8), "gamma 1.8, as its gAMA"),
        ([of_gama(0.45455)], lambda v: v ** (1 / 2.2), "gamma 2.2, as its gAMA"),
        ([of_gama(0.45455), (b"cHRM", CHRM)], encode_srgb, "sRGB, as its gAMA and cHRM"),
        ([(b"sRGB", b"\0"), of_gama(1.0)], encode_srgb, "sRGB, as its sRGB chunk"),
        ([(b"cICP", bytes([1, 8, 0, 1])), (b"sRGB", b"\0")], lambda v: v, "linear, as its cICP"),
        ([(b"cICP", bytes([1, 13, 0, 1])), of_gama(1.0)], encode_srgb, "sRGB, as its cICP"),
        ([(b"cICP", bytes([9, 1, 0, 1]))], BT709, "BT.709, as its cICP"),
        ([(b"cICP", bytes([9, 18, 0, 1]))], HLG, "HLG, as its cICP"),
        ([(b"cICP", bytes([1, 8, 0, 0]))], lambda v: (16 + 219 * v) * 256 / 65535, "linear, narrow range, as its cICP"),
    ],
)
def test_png_chunks_say_how_samples_are_encoded(tmp_path, chunks, encode, said):
    image = smooth()
    png_with(tmp_path / "a.png", stored(encode(image)), *chunks)
    observation, how = read_picture(tmp_path / "a.png")
    assert observation.rgb == pytest.approx(image, abs=3e-4)
    assert said in how
    assert "GUESSED" not in how


def test_a_transfer_function_that_is_not_obeyed_is_named(tmp_path):
    png_with(tmp_path / "a.png", stored(encode_srgb(smooth())), (b"cICP", bytes([1, 200, 0, 1])))
    observation, how = read_picture(tmp_path / "a.png")
    assert "its cICP names transfer function 200, which is not obeyed" in how
    assert observation.rgb == pytest.approx(smooth(), abs=1e-4)


def test_the_users_word_is_above_the_files(tmp_path):
    png_with(tmp_path / "a.png", stored(smooth()), of_gama(0.5))
    observation, how = read_picture(tmp_path / "a.png", encoding="linear")
    assert observation.rgb == pytest.approx(smooth(), abs=1e-4)
    assert "taken as linear, as --encoding says" in how


PROFILES = {
    "linear": ([gamma_curve(1.0)] * 3, lambda v: v, "linear"),
    "gamma": ([gamma_curve(1.8)] * 3, lambda v: v ** (1 / 1.8), "gamma 1.8"),
    "no curve": ([b"curv" + bytes(8)] * 3, lambda v: v, "linear"),
    "sRGB by parameters": (
        [parametric_curve(3, 2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)] * 3,
        encode_srgb,
        "sRGB",
    ),
    "sRGB by a table": ([table_curve(decode_srgb(np.linspace(0, 1, 1024)))] * 3, encode_srgb, "sRGB"),
    "three curves": (
        [gamma_curve(1.0), gamma_curve(2.0), parametric_curve(0, 3.0)],
        lambda v: np.stack([v[..., 0], v[..., 1] ** 0.5, v[..., 2] ** (1 / 3)], axis=-1),
        "curves of its own",
    ),
}


@pytest.mark.parametrize("name", PROFILES)
def test_colour_profiles_are_obeyed_in_every_format(tmp_path, name):
    curves, encode, said = PROFILES[name]
    icc, image = profile(curves, name), smooth()
    samples = stored(encode(image))
    tifffile.imwrite(tmp_path / "a.tif", samples, photometric="rgb", iccprofile=icc)
    eight = Image.fromarray((samples >> 8).astype(np.uint8))
    eight.save(tmp_path / "a.png", icc_profile=icc)
    eight.save(tmp_path / "a.jpg", icc_profile=icc, quality=98, subsampling=0)
    for file, off in (("a.tif", 3e-4), ("a.png", 0.03), ("a.jpg", 0.06)):
        observation, how = read_picture(tmp_path / file)
        assert observation.rgb == pytest.approx(image, abs=off), file
        assert f"{said}, as its colour profile {name!r} says" in how


def test_real_profiles_of_little_cms_are_read():
    srgb = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    transfer = profile_transfer(srgb, 3)
    assert transfer.name == "sRGB"
    assert profile_transfer(srgb, 4) is None  # no profile of inks
    lab = ImageCms.ImageCmsProfile(ImageCms.createProfile("LAB")).tobytes()
    assert profile_transfer(lab, 3) is None


def test_a_damaged_profile_is_told_and_not_obeyed(tmp_path):
    damaged = bytearray(profile([gamma_curve(1.0)] * 3))
    damaged[128:132] = b"\xff\xff\xff\xff"
    for k, icc in enumerate((bytes(damaged), b"rubbish" * 40, profile([table_curve(np.linspace(1, 0, 9))] * 3))):
        tifffile.imwrite(tmp_path / f"{k}.tif", stored(smooth(), np.uint8), photometric="rgb", iccprofile=icc)
        _, how = read_picture(tmp_path / f"{k}.tif")
        assert "is not obeyed" in how
        assert "taken as sRGB" in how


def test_exif_of_adobe_rgb(tmp_path):
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA001] = 0xFFFF
    exif.get_ifd(0x8769)[0xA005] = {1: "R03"}
    encoded = Image.fromarray(stored(smooth() ** (256 / 563), np.uint8))
    encoded.save(tmp_path / "a.jpg", exif=exif, quality=98, subsampling=0)
    observation, how = read_picture(tmp_path / "a.jpg")
    assert "gamma 2.2, as its Exif, Adobe RGB says" in how
    assert observation.rgb == pytest.approx(smooth(), abs=0.05)


def test_the_transfer_function_of_a_tiff_is_its_table(tmp_path):
    light = np.linspace(0, 1, 256) ** 1.5
    entries = tuple(int(v) for v in np.round(65535 * light))
    tifffile.imwrite(
        tmp_path / "a.tif", stored(smooth() ** (1 / 1.5), np.uint8), photometric="rgb",
        extratags=[(301, "H", 256, entries, True)],
    )  # fmt: skip
    observation, how = read_picture(tmp_path / "a.tif")
    assert observation.rgb == pytest.approx(smooth(), abs=0.01)
    assert "its tag TransferFunction" in how


def test_sixteen_bits_without_a_word_are_a_guess_that_is_said_aloud(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", stored(smooth()), photometric="rgb")
    read = open_picture(tmp_path / "a.tif")
    assert read.guessed
    assert "GUESSED to be sRGB" in read.how
    assert not open_picture(tmp_path / "a.tif", encoding="linear").guessed
    tifffile.imwrite(tmp_path / "b.tif", stored(smooth(), np.uint8), photometric="rgb")
    assert not open_picture(tmp_path / "b.tif").guessed


# ---- inks ------------------------------------------------------------------------------------------------------------


def test_inks_become_light_and_the_guess_is_said(tmp_path):
    encoded = stored(encode_srgb(smooth()), np.uint8)
    Image.fromarray(encoded).convert("CMYK").save(tmp_path / "a.jpg", quality=98)
    Image.fromarray(encoded).convert("CMYK").save(tmp_path / "a.tif")
    for name in ("a.jpg", "a.tif"):
        observation, how = read_picture(tmp_path / name)
        assert observation.rgb == pytest.approx(smooth(), abs=0.05), name
        assert "CMYK" in how
        assert "a guess" in how
        with pytest.raises(InputError, match=r"--encoding is for pictures of light"):
            read_picture(tmp_path / name, encoding="linear")


def test_a_profile_of_tables_is_applied_by_little_cms():
    """A profile that maps device values to Lab by a table of 2³ entries: its corners are black and white."""
    transfer = profile_transfer(table_profile(), 3)
    assert transfer is not None
    light = transfer.decode(np.array([[[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [0.5, 0.5, 0.5]]]))
    assert light[0, 0] == pytest.approx(0, abs=0.01)
    assert light[0, 1] == pytest.approx(1, abs=0.02)
    assert light[0, 2] == pytest.approx(0.184, abs=0.02)  # L* = 50 is luminance 0.184


def table_profile() -> bytes:
    """An RGB profile whose only description is a table (lut8) to Lab with L* proportional to the mean."""
    import struct

    grid = [
        (round(255 * (r + g + b) / 3), 128, 128) for r in (0, 1) for g in (0, 1) for b in (0, 1)
    ]  # L* from 0 to 100, a* = b* = 0
    ramp = bytes(range(256))
    lut = b"mft1\0\0\0\0" + bytes([3, 3, 2, 0]) + struct.pack(">9i", *np.ravel(np.eye(3, dtype=int) * 65536).tolist())
    lut += ramp * 3 + b"".join(bytes(entry) for entry in grid) + ramp * 3
    lut += bytes(-len(lut) % 4)
    base = profile([gamma_curve(1.0)] * 3)
    tags = {b"A2B0": lut, b"wtpt": b"XYZ \0\0\0\0" + struct.pack(">3i", 63190, 65536, 54061)}
    head, body, start = struct.pack(">I", len(tags)), b"", 128 + 4 + 12 * len(tags)
    for tag, data in tags.items():
        head += struct.pack(">4sII", tag, start + len(body), len(data))
        body += data
    return struct.pack(">I", start + len(body)) + base[4:20] + b"Lab " + base[24:128] + head + body


# ---- axes and kinds of TIFF ------------------------------------------------------------------------------------------


def test_colours_are_found_on_whichever_axis_they_are(tmp_path):
    image = smooth(21, 30)
    samples = stored(image)
    first = np.moveaxis(samples, -1, 0)
    tifffile.imwrite(tmp_path / "planar.tif", first, photometric="rgb", planarconfig="separate")
    tifffile.imwrite(tmp_path / "imagej.tif", first, imagej=True, metadata={"axes": "CYX"})
    tifffile.imwrite(tmp_path / "stack.tif", first, photometric="minisblack")
    np.save(tmp_path / "first.npy", first)
    np.save(tmp_path / "middle.npy", np.moveaxis(samples, -1, 1))
    np.save(tmp_path / "batch.npy", first[None].astype(np.float32) / 65535)
    np.savez(tmp_path / "first.npz", rgb=first)
    for name in ("planar.tif", "imagej.tif", "stack.tif", "first.npy", "middle.npy", "batch.npy", "first.npz"):
        observation, _ = read_picture(tmp_path / name, encoding="linear")
        assert observation.rgb == pytest.approx(image, abs=1e-4), name


def test_several_pictures_in_a_tiff_are_chosen_by_part_or_refused(tmp_path):
    image = smooth()
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        file.write(stored(image[::-1]), photometric="rgb", metadata=None)
        file.write(stored(image[:, :, ::-1].copy() * 0.5), photometric="rgb", compression="zlib", metadata=None)
    with pytest.raises(InputError, match=r"a file of 2 pictures.*--part"):
        read_picture(tmp_path / "a.tif", encoding="linear")
    observation, _ = read_picture(tmp_path / "a.tif", encoding="linear", options=ReadOptions(part="1"))
    assert observation.rgb == pytest.approx(0.5 * image[:, :, ::-1], abs=1e-4)
    with pytest.raises(InputError, match=r"--part, got 2, expected a number from 0 to 1"):
        read_picture(tmp_path / "a.tif", encoding="linear", options=ReadOptions(part="2"))

    tifffile.imwrite(tmp_path / "b.tif", stored(np.stack([image, image[::-1], image])), photometric="rgb")
    with pytest.raises(InputError, match=r"a file of 3 pictures.*--part"):
        read_picture(tmp_path / "b.tif", encoding="linear")
    observation, _ = read_picture(tmp_path / "b.tif", encoding="linear", options=ReadOptions(part="1"))
    assert observation.rgb == pytest.approx(image[::-1], abs=1e-4)


def test_a_file_of_another_kind_than_its_name_says_is_read_as_what_it_is(tmp_path):
    encoded = Image.fromarray(stored(encode_srgb(smooth()), np.uint8))
    encoded.save(tmp_path / "a.webp", lossless=True)
    encoded.save(tmp_path / "a.bmp")
    encoded.save(tmp_path / "a.png")
    (tmp_path / "png.tif").write_bytes((tmp_path / "a.png").read_bytes())
    encoded.save(tmp_path / "a.tif")
    (tmp_path / "tif.png").write_bytes((tmp_path / "a.tif").read_bytes())
    for name in ("a.webp", "a.bmp", "png.tif", "tif.png"):
        assert read_picture(tmp_path / name)[0].rgb == pytest.approx(smooth(), abs=0.01), name


def test_a_thumbnail_is_not_the_picture(tmp_path):
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        file.write(stored(smooth(6, 8)), photometric="rgb", metadata=None, subfiletype=1)
        file.write(stored(smooth()), photometric="rgb", metadata=None)
    assert read_picture(tmp_path / "a.tif")[0].rgb.shape == (24, 32, 3)


@pytest.mark.parametrize("compression", ["lzw", "deflate", "jpeg", "zstd", "packbits"])
def test_compressed_tiffs_are_read(tmp_path, compression):
    samples = stored(encode_srgb(smooth()), np.uint8)
    tifffile.imwrite(tmp_path / "a.tif", samples, photometric="rgb", compression=compression)
    assert read_picture(tmp_path / "a.tif")[0].rgb == pytest.approx(smooth(), abs=0.06)
    if compression == "lzw":
        tifffile.imwrite(tmp_path / "b.tif", stored(smooth()), photometric="rgb", compression="lzw", predictor=True)
        assert read_picture(tmp_path / "b.tif", encoding="linear")[0].rgb == pytest.approx(smooth(), abs=1e-4)


def test_a_missing_decoder_is_named_with_the_line_that_installs_it(tmp_path, monkeypatch):
    tifffile.imwrite(tmp_path / "a.tif", stored(smooth(), np.uint8), photometric="rgb", compression="lzw")

    def missing(*_, **__):
        raise ValueError("<COMPRESSION.LZW: 5> requires the 'imagecodecs' package")

    monkeypatch.setattr(tifffile.TiffPageSeries, "asarray", missing)
    with pytest.raises(InputError, match=r"compression LZW.*pip install imagecodecs"):
        read_picture(tmp_path / "a.tif")


def test_palettes_and_inverted_samples_are_read_as_their_tags_say(tmp_path):
    picture = Image.fromarray(stored(encode_srgb(smooth()), np.uint8)).quantize(64)
    picture.save(tmp_path / "palette.tif")
    picture.save(tmp_path / "palette.png")
    seen = decode_srgb(np.asarray(picture.convert("RGB")) / 255)
    for name in ("palette.tif", "palette.png"):
        assert read_picture(tmp_path / name)[0].rgb == pytest.approx(seen, abs=1e-3), name
    inside = smooth()[..., 0] > 0.5
    tifffile.imwrite(tmp_path / "mask.tif", np.where(inside, 0, 255).astype(np.uint8), photometric="miniswhite")
    np.save(tmp_path / "a.npy", smooth())
    assert np.array_equal(read_picture(tmp_path / "a.npy", mask=tmp_path / "mask.tif")[0].mask, inside)


# ---- alpha -----------------------------------------------------------------------------------------------------------


def test_alpha_is_the_mask_and_premultiplied_colours_are_divided(tmp_path):
    image = smooth()
    alpha = np.clip(3 * image[..., :1] - 0.9, 0, 1)
    straight, multiplied = stored(np.dstack([image, alpha])), stored(np.dstack([image * alpha, alpha]))
    png_with(tmp_path / "a.png", straight)
    tifffile.imwrite(tmp_path / "a.tif", straight, photometric="rgb", extrasamples=["unassalpha"])
    tifffile.imwrite(tmp_path / "b.tif", multiplied, photometric="rgb", extrasamples=["assocalpha"])
    np.save(tmp_path / "a.npy", np.dstack([image, alpha]).astype(np.float32))
    inside = alpha[..., 0] > 0.5
    for name in ("a.png", "a.tif", "b.tif", "a.npy"):
        observation, how = read_picture(tmp_path / name, encoding="linear")
        assert np.array_equal(observation.mask, inside), name
        assert f"object where alpha is over a half, {inside.sum()} px" in how
        assert observation.rgb[inside] == pytest.approx(image[inside], abs=2e-4), name


def test_alpha_that_says_nothing_is_not_a_mask_and_a_fourth_channel_without_a_name_is_told(tmp_path):
    image = stored(smooth())
    for level in (0, 65535):
        png_with(tmp_path / "a.png", np.dstack([image, np.full(image.shape[:2], level, np.uint16)]))
        assert read_picture(tmp_path / "a.png")[0].mask.all()
    tifffile.imwrite(tmp_path / "a.tif", np.dstack([image, image[..., 0]]), photometric="rgb", extrasamples=[0])
    observation, how = read_picture(tmp_path / "a.tif")
    assert observation.mask.all()
    assert "1 further channel not used" in how


def test_transparency_of_a_palette_is_alpha(tmp_path):
    picture = Image.new("P", (32, 24))
    picture.putpalette([0, 0, 0, 200, 100, 50])
    picture.paste(1, (8, 4, 20, 18))
    picture.save(tmp_path / "a.png", transparency=0)
    assert read_picture(tmp_path / "a.png")[0].mask.sum() == 12 * 14


def test_a_grey_picture_is_refused_as_such(tmp_path):
    buffer = io.BytesIO()
    Image.new("L", (9, 9), 100).save(buffer, "PNG")
    (tmp_path / "a.png").write_bytes(buffer.getvalue())
    with pytest.raises(InputError, match="a grey picture, one channel"):
        read_picture(tmp_path / "a.png")
