"""WebDataset shards: plain tar files, written by Python's own library, in which a sample is a run of members.

The members of a sample share its key, the item's id: <id>.<name>.npy for each array, and <id>.json for the rest.
Owners, times and modes are constant, so equal samples give equal bytes.
"""

import io
import json
import tarfile
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from huesphere.eval.datasets.sample import Sample


def write_tar(path: Path, samples: Iterable[Sample]) -> None:
    """Write ``samples`` as a tar file, in their order."""
    with tarfile.open(path, "w", format=tarfile.GNU_FORMAT) as archive:
        for sample in samples:
            for name, array in (sample.images | sample.vectors).items():
                data = io.BytesIO()
                np.save(data, array, allow_pickle=False)
                _add(archive, f"{sample.id}.{name}.npy", data.getvalue())
            facts = json.dumps({"id": sample.id} | sample.facts, sort_keys=True)
            _add(archive, f"{sample.id}.json", facts.encode())


def _add(archive: tarfile.TarFile, name: str, data: bytes) -> None:
    member = tarfile.TarInfo(name)
    member.size, member.mode = len(data), 0o644
    archive.addfile(member, io.BytesIO(data))
