"""The sequence of samples of a run that training loops read: lazily, cropped, mirrored and turned at random.

It needs NumPy only; ``huesphere.torch.RunDataset`` gives the same samples as tensors.
"""

from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.eval.datasets.sample import Sample, geometry_key, read_sample, require_contents
from huesphere.eval.datasets.splits import SPLITS, Shares
from huesphere.eval.datasets.symmetry import Symmetry, cropped, transformed
from huesphere.render.dataset import RunItem, open_run

AHEAD = 2  # batches that are read before they are asked for, for each worker


@dataclass(frozen=True)
class Augmentation:
    """What is drawn at random for each sample and epoch."""

    crop: tuple[int, int] | None = None  # (height, width) of a window that holds a pixel of the object; None: all
    mirror: bool = False  # left and right, in half of the cases
    turn: bool = False  # by a multiple of 90°; by 180° or not if the window is not square


class RunSamples(Sequence[dict[str, Any]]):
    """The samples of a run folder as a sequence of dictionaries of arrays, read when they are asked for.

    ``run``: the folder; ``contents``: names of ``sample.CONTENTS`` beside picture and mask; ``transport``: only items
    of this level of light transport; ``split``: only the shapes of "train", "validation" or "test" (``shares`` are
    their shares); ``augmentation``: what is drawn at random, from ``seed``; ``fill``: what stands for NaN off the
    object, so that a product with the mask is 0, or NaN.

    Sample i has rgb (H, W, 3) and mask (H, W), the arrays that ``contents`` name, principal_point (3,), focal_px (NaN
    if rays are parallel), and id. What is drawn depends on seed, epoch and i only, not on the order of reading. Raises
    InputError for a folder that is no run, unknown names, and a selection without items; and when a sample is read, for
    damaged files and for pictures smaller than the crop.

    >>> samples = RunSamples("run", augmentation=Augmentation(crop=(64, 64), mirror=True))  # doctest: +SKIP
    >>> for batch in samples.batches(16, epoch=0):                                          # doctest: +SKIP
    ...     batch["rgb"], batch["normals"]  # (16, 64, 64, 3) each
    """

    def __init__(
        self,
        run: Path | str,
        contents: Sequence[str] = ("normals",),
        *,
        transport: str | None = None,
        split: str | None = None,
        shares: Shares | None = None,
        augmentation: Augmentation | None = None,
        seed: int = 0,
        fill: float = 0.0,
    ) -> None:  # more than seven parameters: the options of one reader, all with defaults
        if split not in (None, *SPLITS):
            raise InputError("split", got=split, expected=f"one of {', '.join(SPLITS)}")
        self.contents = require_contents([contents] if isinstance(contents, str) else contents)
        self.augmentation, self.seed, self.fill = augmentation or Augmentation(), seed, fill
        self.epoch = 0  # for samples that are asked for by number
        _check_crop(self.augmentation.crop)
        chosen: tuple[RunItem, ...] = open_run(run, transport=transport)
        if split is not None:
            shared = shares or Shares()
            chosen = tuple(item for item in chosen if shared.split_of(geometry_key(item.config())) == split)
        if not chosen:
            asked = ", ".join(text for text in (transport, split) if text is not None)
            raise InputError("no finished items" + (f" of {asked}" if asked else ""), where=run)
        self.items = chosen

    def __len__(self) -> int:
        return len(self.items)

    def __getitem__(self, number: Any) -> Any:
        if isinstance(number, slice):
            return [self.sample(n, self.epoch) for n in range(len(self))[number]]
        return self.sample(range(len(self))[number], self.epoch)

    def sample(self, number: int, epoch: int = 0) -> dict[str, Any]:
        """Sample ``number`` as it is drawn in an ``epoch``."""
        rng = np.random.default_rng([self.seed, epoch, number])
        sample = augmented(read_sample(self.items[number], self.contents), self.augmentation, rng)
        images = {name: self._filled(image) for name, image in sample.images.items()}
        focal_px = np.float32(np.nan if (found := sample.facts["camera"]["focal_px"]) is None else found)
        return {"id": sample.id, **images, **sample.vectors, "focal_px": np.asarray(focal_px)}

    def _filled(self, image: np.ndarray) -> np.ndarray:
        return image if image.dtype == bool else np.nan_to_num(image, nan=self.fill, posinf=np.inf, neginf=-np.inf)

    def batches(
        self, size: int, *, epoch: int = 0, shuffle: bool = True, keep_rest: bool = False, workers: int = 0
    ) -> Iterator[dict[str, Any]]:
        """The samples of an epoch, ``size`` at a time, stacked: arrays gain a first axis, id becomes a list.

        The order is drawn from seed and epoch if ``shuffle``. ``keep_rest``: whether the last batch may be smaller.
        ``workers`` threads read ahead; the batches are the same with any number of them. Vectors of lights are a list
        if pictures have different numbers of lights. Raises InputError for pictures of different sizes.
        """
        if size < 1 or workers < 0:
            raise InputError("batches", got=f"size {size}, workers {workers}", expected="size ≥ 1, workers ≥ 0")
        order = np.arange(len(self))
        if shuffle:
            order = np.random.default_rng([self.seed, epoch]).permutation(order)
        stop = len(order) if keep_rest else len(order) - len(order) % size
        groups = [order[start : start + size] for start in range(0, stop, size)]

        def read(group: np.ndarray) -> dict[str, Any]:
            return stacked([self.sample(int(n), epoch) for n in group])

        yield from map(read, groups) if workers == 0 else _ahead(read, groups, workers)


def _check_crop(crop: Any) -> None:
    """Raise InputError for a crop that is not two positive whole numbers."""
    if crop is not None and not (isinstance(crop, tuple | list) and len(crop) == 2 and all(int(n) >= 1 for n in crop)):
        raise InputError("crop", got=crop, expected="(height, width) in pixels")


def augmented(sample: Sample, augmentation: Augmentation, rng: np.random.Generator) -> Sample:
    """A sample with a random window and symmetry. Raises InputError if the picture is smaller than the window."""
    mask = sample.images["mask"]
    size = mask.shape if augmentation.crop is None else augmentation.crop
    if augmentation.crop is not None:
        if size[0] > mask.shape[0] or size[1] > mask.shape[1]:
            raise InputError("a crop larger than the picture", got=f"{mask.shape}", expected=f"{size}", where=sample.id)
        on = np.argwhere(mask) if mask.any() else np.argwhere(~mask)
        at = on[rng.integers(len(on))] - [rng.integers(size[0]), rng.integers(size[1])]
        top, left = np.clip(at, 0, np.array(mask.shape) - size)
        sample = cropped(sample, int(top), int(left), (int(size[0]), int(size[1])))
    mirrored = augmentation.mirror and bool(rng.integers(2))
    turns = int(rng.integers(4)) if size[0] == size[1] else 2 * int(rng.integers(2))
    return transformed(sample, Symmetry(mirrored, turns if augmentation.turn else 0))


def stacked(samples: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Samples as a batch. Raises InputError if their pictures differ in size."""
    batch: dict[str, Any] = {}
    for name, first in samples[0].items():
        values = [sample[name] for sample in samples]
        if isinstance(first, np.ndarray) and len({value.shape for value in values}) == 1:
            batch[name] = np.stack(values)
        elif name in ("rgb", "mask"):
            sizes = sorted({value.shape[:2] for value in values})
            raise InputError("pictures of different sizes in a batch", got=str(sizes[:3]), expected="a crop")
        else:
            batch[name] = values
    return batch


def _ahead(read: Any, groups: Sequence[np.ndarray], workers: int) -> Iterator[dict[str, Any]]:
    """``read`` of each group in order, computed by threads that are at most AHEAD batches each ahead of the reader."""
    with ThreadPoolExecutor(workers) as pool:
        waiting: list[Future[dict[str, Any]]] = []
        try:
            for group in groups:
                waiting.append(pool.submit(read, group))
                if len(waiting) > AHEAD * workers:
                    yield waiting.pop(0).result()
            while waiting:
                yield waiting.pop(0).result()
        finally:
            for future in waiting:
                future.cancel()
