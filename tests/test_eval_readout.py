"""Packed pixels come back as the digits that are shown; undone here as templates/page.js does it."""

import base64
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from huesphere.eval.readout import pack_degrees, pack_fixed


def codes(text: str) -> np.ndarray:
    planes = np.frombuffer(zlib.decompress(base64.b64decode(text)), np.uint8).reshape(2, -1).astype(np.uint16)
    return np.cumsum((planes[0] << 8) + planes[1], dtype=np.uint16)


def degrees(code: int) -> float:
    if code == 0:
        return np.nan
    if code == 65535:
        return 0.0
    decade, digits = divmod(code - 1, 9000)
    return (1000 + digits) * 10.0 ** (decade - 7)


@given(hnp.arrays(np.float32, (3, 4), elements=st.floats(0.0, 180.0, width=32) | st.just(float("nan"))))
def test_an_angle_keeps_four_significant_digits(image: np.ndarray):
    back = [degrees(int(code)) for code in codes(pack_degrees(image))]
    for value, shown in zip(image.ravel().astype(np.float64), back, strict=True):
        expected = 0.0 if value < 1e-4 else float(f"{value:.4g}")
        assert shown == pytest.approx(expected, rel=1.01e-3 if value < 1e-3 else 1e-9, nan_ok=True) or abs(
            shown - value
        ) <= 0.5001 * 10.0 ** (np.floor(np.log10(value)) - 3)  # a tie: either neighbour


@pytest.mark.parametrize(
    ("value", "shown"), [(99.995, 100.0), (9.99951, 10.0), (179.96, 180.0), (1e-4, 1e-4), (5e-5, 0)]
)
def test_where_a_decade_ends(value: float, shown: float):
    assert degrees(int(codes(pack_degrees(np.array([[value]])))[0])) == pytest.approx(shown, rel=1e-12)


def test_components_come_back_channel_by_channel_to_their_decimals():
    image = np.random.default_rng(0).uniform(-1, 1, (5, 6, 3))
    image[2, 3] = np.nan
    packed = pack_fixed(image, 3)
    back = codes(packed.text).view(np.int16).reshape(3, 5, 6)
    assert packed.decimals == 3
    assert (back[:, 2, 3] == -32768).all()
    known = np.isfinite(image)
    np.testing.assert_allclose(np.moveaxis(back, 0, -1)[known] / 1000, image[known], atol=0.50001e-3)


def test_what_is_too_large_for_two_bytes_gives_up_decimals_not_range():
    packed = pack_fixed(np.array([[[12.3456, -1.0, 0.5]]]), 4)
    assert packed.decimals == 3
    assert codes(packed.text).view(np.int16).tolist() == [12346, -1000, 500]
