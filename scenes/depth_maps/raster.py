"""Depth from PNG and TIFF pictures of one channel, at the full precision of their samples."""

import logging
from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.scenes.depth_maps.stored import StoredDepth

GDAL_NODATA = 42113  # the TIFF tag, a number as text


def read_png(path: Path) -> StoredDepth:
    """The samples of a PNG of one channel; 16 bits stay 16 bits. Raises InputError for several channels."""
    import imageio.v3 as imageio

    return StoredDepth(_one_channel(imageio.imread(path, plugin="pillow"), path))


def read_tiff(path: Path) -> StoredDepth:
    """The samples of a TIFF of one channel, and the value of its tag GDAL_NODATA. Raises InputError for several."""
    import tifffile

    # tifffile would log a file that it cannot read. Its exception becomes an InputError in ``read_depth_map``.
    logging.getLogger("tifffile").setLevel(logging.CRITICAL)
    with tifffile.TiffFile(path) as file:
        series = file.series[0]
        samples, tag = series.asarray(), file.pages[0].tags.get(GDAL_NODATA)  # type: ignore[union-attr]
    stated: tuple[float, ...] = ()
    if tag is not None:
        try:
            stated = (float(str(tag.value).strip("\0 ").replace(",", ".")),)
        except ValueError:
            raise InputError("the tag GDAL_NODATA", got=repr(tag.value)[:40], expected="a number", where=path) from None
    return StoredDepth(_one_channel(samples, path), no_data=stated)


def _one_channel(samples: np.ndarray, path: Path) -> np.ndarray:
    samples = np.squeeze(
        samples, axis=tuple(k for k in (0, samples.ndim - 1) if samples.ndim > 2 and samples.shape[k] == 1)
    )
    if samples.ndim == 3:
        # Channels are not averaged to one: Pillow reduces 16-bit RGB to 8 bits without a warning.
        got = f"{samples.shape[2]} channels" if samples.shape[2] <= 4 else f"{len(samples)} pages or channels"
        raise InputError("a depth picture has one channel", got=got, where=path)
    return samples
