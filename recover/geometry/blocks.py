"""Square blocks of pixels: an image cut into them, their sums and their means."""

import numpy as np


def blocks(image: np.ndarray, side: int, *, pad: bool = False) -> np.ndarray:
    """The blocks (h, side, w, side, …) of an ``image`` (H, W, …): element [i, :, j, :] is the block in row i, column j.

    Where H or W is not a multiple of ``side``, the pixels below and to the right of the last whole block are left out;
    with ``pad`` the image is extended there by zeros to whole blocks instead.
    """
    height, width, *rest = image.shape
    if pad:
        image = np.pad(image, ((0, -height % side), (0, -width % side), *((0, 0),) * len(rest)))
    h, w = image.shape[0] // side, image.shape[1] // side
    return image[: h * side, : w * side].reshape(h, side, w, side, *rest)


def block_sums(image: np.ndarray, side: int) -> np.ndarray:
    """Sums (h, w, …) over the whole blocks of an ``image`` (H, W, …)."""
    return np.asarray(blocks(image, side).sum(axis=(1, 3)))


def block_means(image: np.ndarray, side: int, *, pad: bool = False) -> np.ndarray:
    """Means (h, w, …) over the blocks of an ``image`` (H, W, …); ``pad`` as in ``blocks``."""
    return np.asarray(blocks(image, side, pad=pad).mean(axis=(1, 3)))


def whole_blocks(inside: np.ndarray, side: int, *, pad: bool = False) -> np.ndarray:
    """Blocks (h, w) of which every pixel is ``inside`` (H, W); ``pad`` as in ``blocks``."""
    return np.asarray(blocks(inside, side, pad=pad).all(axis=(1, 3)))
