"""Decoding happens once, where a picture enters: no result depends on how its samples were stored."""

import sys
from dataclasses import replace
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest
from synthesis import angles_deg

from huesphere.configs.load import load_config
from huesphere.recover.io.picture import read_picture
from huesphere.recover.methods.table import METHODS
from huesphere.recover.run import recover_one
from huesphere.render.dataset import Observation, linear_light, read_observation, read_truth, write_observation
from huesphere.render.run import render_config
from huesphere.scenes.encoding import encode_srgb

sys.path.insert(0, str(Path(__file__).parent / "golden"))
from estimates import estimate_of, pictures


def display_copy(observation: Observation, kind: type = np.float64) -> Observation:
    """The same picture with its samples as a display takes them, in floating point of that kind."""
    encoded = encode_srgb(observation.rgb.astype(np.float64)).astype(kind)
    return replace(observation, rgb=encoded, camera=replace(observation.camera, encoding="srgb"))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ["noisy", "direct", "perspective", "saturated", "two-lights"])
def test_a_display_encoded_copy_gives_the_same_normals_and_status(name, method):
    picture = pictures()[name]
    linear, display = estimate_of(name, method), recover_one(display_copy(picture), method)
    assert display.status == linear.status
    assert np.array_equal(display.normals, linear.normals, equal_nan=True)


# In single precision a copy has lost the last bits. Of a noisy picture only the random sixes of least median of squares
# notice, in the methods that keep its ellipsoid as it is: half a degree is what the choice of sixes is worth there.
KEEP_LMS = ("drew-kontsevich", "alternation", "kontsevich-1994", "drew-kontsevich-ambient")


@pytest.mark.parametrize("method", [name for name in METHODS if name not in KEEP_LMS])
def test_a_copy_in_single_precision_gives_the_same_normals_and_status(method):
    picture = pictures()["noisy"]
    linear, display = estimate_of("noisy", method), recover_one(display_copy(picture, np.float32), method)
    assert display.status == linear.status
    both = linear.valid & display.valid
    assert both.sum() >= 0.998 * linear.valid.sum()
    assert np.median(angles_deg(linear.normals[both].astype(float), display.normals[both].astype(float))) <= 1e-3


def test_a_file_is_decoded_once_whichever_way_it_is_read(tmp_path):
    picture = pictures()["direct"]
    encoded = display_copy(picture, np.float32)
    write_observation(tmp_path / "a.exr", encoded)  # as a camera that writes for displays leaves it
    np.savez(tmp_path / "b.npz", rgb=encoded.rgb, mask=encoded.mask)
    from_run = read_observation(tmp_path / "a.exr")
    from_array, how = read_picture(tmp_path / "b.npz", encoding="srgb")
    for read in (from_run, read_picture(tmp_path / "a.exr")[0], from_array, linear_light(encoded)):
        assert read.rgb == pytest.approx(picture.rgb, abs=2e-6)
        assert (read.camera.encoding, read.camera.stored_as) == ("linear", "srgb")
        assert linear_light(read) is read
    assert "srgb" in how
    write_observation(tmp_path / "c.exr", from_run)
    assert np.array_equal(read_observation(tmp_path / "c.exr").rgb, from_run.rgb)


@pytest.mark.slow
def test_auto_is_ok_on_an_8_bit_png(tmp_path, mi):
    """What a user brings: the bust under gels with its interreflection, as 8 bits for a display."""
    scene = load_config("mozart_5gels", overrides=["render.transport=[full]"])
    render_config(scene, tmp_path / "run", progress=lambda *_: None, log=lambda _: None)
    folder = tmp_path / "run/mozart_5gels/full"
    rendered, truth = read_observation(folder / "observation.exr"), read_truth(folder / "truth.exr")
    imageio.imwrite(tmp_path / "a.png", np.round(255 * encode_srgb(np.clip(rendered.rgb, 0, 1))).astype(np.uint8))
    imageio.imwrite(tmp_path / "mask.png", 255 * rendered.mask.astype(np.uint8))
    picture, _ = read_picture(tmp_path / "a.png", mask=tmp_path / "mask.png")
    estimate = recover_one(picture, "auto")
    assert estimate.status == "ok", estimate.message
    assert estimate.valid[truth.mask].all()
    assert np.median(angles_deg(estimate.normals[truth.mask].astype(float), truth.normals[truth.mask])) <= 1.5
