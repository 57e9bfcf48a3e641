"""A picture cut into square blocks of pixels about its middle; images of one value a block taken back to all pixels."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

LEAST_ON_OBJECT = 0.5  # share of a block's pixels that are on the object, for the block to be


@dataclass(frozen=True)
class Reduction:
    """Blocks of ``factor`` × ``factor`` pixels, laid over a picture so that the middle of both is the same."""

    factor: int
    shape: tuple[int, int]  # of the picture, pixels
    blocks: tuple[int, int]  # of the reduced picture
    before: tuple[int, int]  # rows and columns of the first blocks that lie outside the picture

    def blockwise(self, image: np.ndarray) -> np.ndarray:
        """Sums (h, w, …) over the blocks of an ``image`` (H, W, …); outside the picture it is 0."""
        after = [self.blocks[k] * self.factor - self.shape[k] - self.before[k] for k in (0, 1)]
        room = [(self.before[k], after[k]) for k in (0, 1)] + [(0, 0)] * (image.ndim - 2)
        padded = np.pad(image, room)
        h, w = self.blocks
        return padded.reshape(h, self.factor, w, self.factor, *image.shape[2:]).sum(axis=(1, 3), dtype=np.float64)

    def on_object(self, mask: np.ndarray) -> np.ndarray:
        """Blocks (h, w) of which enough of the pixels are on the object ``mask`` (H, W)."""
        return self.blockwise(mask) >= LEAST_ON_OBJECT * self.factor**2  # type: ignore[no-any-return]

    def nearest(self, image: np.ndarray, rows: slice) -> np.ndarray:
        """Rows (R, W, …) of the picture, each pixel with the value of the nearest block in ``image`` (h, w, …)."""
        i = (np.arange(self.shape[0])[rows] + self.before[0]) // self.factor
        j = (np.arange(self.shape[1]) + self.before[1]) // self.factor
        return image[np.ix_(np.minimum(i, self.blocks[0] - 1), np.minimum(j, self.blocks[1] - 1))]

    def linear(self, image: np.ndarray, rows: slice) -> np.ndarray:
        """Rows (R, W, C) of the picture, interpolated linearly between the middles of blocks of ``image`` (h, w, C)."""
        (i, down), (j, right) = (self._between(np.arange(self.shape[k]), k) for k in (0, 1))
        i, down = i[rows], down[rows, None, None].astype(image.dtype)
        right = right[None, :, None].astype(image.dtype)
        along = image[i] * (1 - down) + image[np.minimum(i + 1, self.blocks[0] - 1)] * down
        return along[:, j] * (1 - right) + along[:, np.minimum(j + 1, self.blocks[1] - 1)] * right  # type: ignore[no-any-return]

    def _between(self, position: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
        """(block whose middle is next before each pixel, share of the way to the next middle)."""
        at = np.clip((position + self.before[axis] + 0.5) / self.factor - 0.5, 0, self.blocks[axis] - 1)
        first = np.floor(at).astype(int)
        return first, at - first


def reduction_of(mask: np.ndarray, most_pixels: int) -> Reduction | None:
    """The least reduction after which the object ``mask`` (H, W) has ``most_pixels`` or fewer; None: it has already."""
    factor = int(np.ceil(np.sqrt(mask.sum() / most_pixels)))
    if factor <= 1:
        return None
    height, width = mask.shape
    blocks = (-(-height // factor), -(-width // factor))
    before = ((blocks[0] * factor - height) // 2, (blocks[1] * factor - width) // 2)
    return Reduction(factor, (height, width), blocks, before)


def filled(image: np.ndarray, known: np.ndarray) -> np.ndarray:
    """``image`` (h, w, …) with the nearest value that is ``known`` (h, w) where it is not; as it is if none is."""
    if known.all() or not known.any():
        return image
    i, j = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    return image[i, j]  # type: ignore[no-any-return]
