"""Parquet shards: a row for each sample, a column for each array (nested lists of numbers) and fact."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from huesphere.eval.datasets.sample import Sample

ROW_GROUP_BYTES = 32 * 2**20  # of arrays, uncompressed; readers hold one row group at a time


def write_parquet(path: Path, samples: Iterable[Sample]) -> None:
    """Write ``samples`` as a Parquet file, in their order; there is at least one."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    writer, waiting, size = None, [], 0
    try:
        for sample in samples:
            waiting.append(_row(pa, sample))
            size += waiting[-1].nbytes
            if writer is None:
                writer = pq.ParquetWriter(path, waiting[0].schema, compression="zstd")
            if size > ROW_GROUP_BYTES:
                writer.write_table(pa.concat_tables(waiting))
                waiting, size = [], 0
        if writer is not None and waiting:
            writer.write_table(pa.concat_tables(waiting))
    finally:
        if writer is not None:
            writer.close()


def _row(pa: Any, sample: Sample) -> Any:
    """A sample as a table of one row."""
    arrays = {name: nested(pa, array) for name, array in (sample.images | sample.vectors).items()}
    texts = {"id": sample.id, "transport": sample.facts["transport"], "geometry": sample.facts["geometry"]}
    return pa.table(
        {name: [text] for name, text in texts.items()} | arrays | {"facts": [json.dumps(sample.facts, sort_keys=True)]}
    )


def nested(pa: Any, array: np.ndarray) -> Any:
    """An array (a, b, …) as a column of one row that holds lists of lists; no length may be 0."""
    column = pa.array(np.ascontiguousarray(array).reshape(-1))
    for length in reversed(array.shape):
        column = pa.ListArray.from_arrays(pa.array(np.arange(0, len(column) + 1, length, dtype=np.int32)), column)
    return column
