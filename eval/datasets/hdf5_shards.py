"""HDF5 shards: a group for each sample, named by its id, with a compressed data set for each array."""

import json
from collections.abc import Iterable
from pathlib import Path

from huesphere.eval.datasets.sample import Sample


def write_hdf5(path: Path, samples: Iterable[Sample]) -> None:
    """Write ``samples`` as an HDF5 file. Facts are the group's attribute "facts", as JSON. No time stamps are kept."""
    import h5py

    with h5py.File(path, "w", libver="latest") as file:
        for sample in samples:
            group = file.create_group(sample.id)
            group.attrs["facts"] = json.dumps(sample.facts, sort_keys=True)
            for name, image in sample.images.items():
                group.create_dataset(name, data=image, chunks=True, compression="gzip", shuffle=True)
            for name, vectors in sample.vectors.items():
                group.create_dataset(name, data=vectors)
