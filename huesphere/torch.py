"""A run folder for PyTorch: ``huesphere.eval.datasets.samples`` with tensors in place of arrays.

>>> from torch.utils.data import DataLoader                             # doctest: +SKIP
>>> from huesphere.torch import RunDataset                              # doctest: +SKIP
>>> data = RunDataset("run", contents=("normals",), split="train")      # doctest: +SKIP
>>> for batch in DataLoader(data, batch_size=16, num_workers=2):        # doctest: +SKIP
...     batch["rgb"], batch["normals"]  # (16, 3, H, W) each
"""

import importlib
from pathlib import Path
from typing import Any

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.eval.datasets.samples import Augmentation, RunSamples

__all__ = ["Augmentation", "RunDataset"]


class RunDataset:
    """A map-style data set: options, samples and errors are those of ``RunSamples``, which it holds as ``samples``.

    Images are tensors with channels first: (3, H, W), (L, H, W), (L, 3, H, W), and (H, W) where there is one channel.
    ``set_epoch`` before each epoch draws crops and symmetries anew, as torch's DistributedSampler has it; before the
    DataLoader's workers start, that is before its iterator is made. Raises InputError if PyTorch is missing.
    """

    def __init__(self, run: Path | str, *arguments: Any, **options: Any) -> None:
        _torch()
        self.samples = RunSamples(run, *arguments, **options)

    def set_epoch(self, epoch: int) -> None:
        """Draw crops and symmetries as of this epoch from now on."""
        self.samples.epoch = epoch

    def __len__(self) -> int:
        return len(self.samples)

    def __getitem__(self, number: int) -> dict[str, Any]:
        torch = _torch()
        arrays = self.samples[number]
        shape = arrays["mask"].shape
        return {
            name: torch.from_numpy(channels_first(value, shape)) if isinstance(value, np.ndarray) else value
            for name, value in arrays.items()
        }


def channels_first(array: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """An image (H, W, …) of this ``shape`` (H, W) as (…, H, W); other arrays, such as vectors, as they are."""
    if array.ndim > 2 and array.shape[:2] == shape:
        array = np.moveaxis(array, (0, 1), (-2, -1))
    return np.ascontiguousarray(array)


def _torch() -> Any:
    try:
        return importlib.import_module("torch")
    except (ImportError, OSError, ValueError) as error:
        missing = isinstance(error, ImportError)
        what = "needs PyTorch: pip install 'huesphere[torch]'" if missing else "PyTorch cannot be loaded"
        raise InputError(f"huesphere.torch {what}", got=None if missing else str(error)[:100]) from None
