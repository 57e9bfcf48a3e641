"""Blocks of pixels: sums, means and what happens to the last rows and columns."""

import numpy as np
import pytest

from huesphere.recover.geometry.blocks import block_means, block_sums, blocks, whole_blocks


def test_each_block_holds_its_own_pixels():
    image = np.arange(24.0).reshape(4, 6)
    assert (blocks(image, 2)[1, :, 2, :] == image[2:4, 4:6]).all()


def test_sums_and_means_by_hand():
    image = np.array([[1.0, 2.0, 3.0, 4.0], [5.0, 6.0, 7.0, 8.0]])
    assert block_sums(image, 2).tolist() == [[14.0, 22.0]]
    assert block_means(image, 2).tolist() == [[3.5, 5.5]]


def test_channels_stay_apart():
    image = np.random.default_rng(0).random((6, 9, 3))
    assert block_means(image, 3)[..., 1] == pytest.approx(block_means(image[..., 1], 3))


def test_what_is_beyond_the_last_whole_block_is_left_out_or_padded_with_zeros():
    image = np.ones((5, 7))
    assert block_sums(image, 3).shape == (1, 2)
    assert block_means(image, 3, pad=True).shape == (2, 3)
    assert block_means(image, 3, pad=True)[1, 2] == pytest.approx(2 / 9)


def test_a_block_is_whole_if_all_its_pixels_are_inside():
    inside = np.ones((4, 4), bool)
    inside[3, 0] = False
    assert whole_blocks(inside, 2).tolist() == [[True, True], [False, True]]
    assert whole_blocks(np.ones((3, 4), bool), 2, pad=True).tolist() == [[True, True], [False, False]]
