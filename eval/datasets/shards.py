"""Writes a run as a data set: shards by split, a record beside each, and a card.

DIR/README.md                                    the card
DIR/[data/]<split>-<number>-of-<count>.<ending>  a shard; data/ for Hugging Face
DIR/[data/]<split>-<number>-of-<count>.json      its record: items, sha256, bytes
DIR/croissant.json                               Hugging Face only

With the same options (contents, splits, number of shards) the bytes of a shard depend on its items alone: on several
machines, each with a part of the run (``render --shard``), the same shards come out as on one.
"""

import importlib.util
import json
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from huesphere.configs.errors import InputError
from huesphere.configs.own_folder import inside, made_folder, replacing, write_text
from huesphere.eval.datasets.card import ABOUT, About, card_text
from huesphere.eval.datasets.croissant import write_croissant
from huesphere.eval.datasets.hdf5_shards import write_hdf5
from huesphere.eval.datasets.parquet_shards import write_parquet
from huesphere.eval.datasets.sample import Sample, read_sample
from huesphere.eval.datasets.splits import SPLITS, ShardName, in_shards
from huesphere.eval.datasets.tar_shards import write_tar
from huesphere.render.dataset import RunItem, open_run
from huesphere.render.manifest import read_manifest, sha256_of


@dataclass(frozen=True)
class Format:
    """A format of shards: where they lie, what their names end with, who writes them, and the package that it needs."""

    folder: str
    ending: str
    write: Callable[[Path, Iterable[Sample]], None]
    package: str | None


FORMATS = {
    "webdataset": Format("", ".tar", write_tar, None),
    "huggingface": Format("data", ".parquet", write_parquet, "pyarrow"),
    "hdf5": Format("", ".h5", write_hdf5, "h5py"),
}


def export_dataset(run: Path, folder: Path, kind: str, about: About) -> list[Path]:
    """Write the finished items of ``run`` as a data set into ``folder``; returns the paths of the shards.

    ``kind``: a key of FORMATS. Shards that would hold no item are not written. Raises InputError if the package that
    writes the format is missing, if the run has no finished items, if a shard or record of that name exists, or a
    README.md with other text, and for unreadable items; shards that were finished are then kept.
    """
    shards_format = FORMATS[kind]
    if shards_format.package is not None and importlib.util.find_spec(shards_format.package) is None:
        raise InputError(f"--export {kind} needs {shards_format.package}: pip install 'huesphere[data]'")
    items = open_run(run)
    if not items:
        raise InputError("the run has no finished items", where=run)
    shards = in_shards(items, about.shares, about.shards)
    place = inside(folder, *filter(None, [shards_format.folder]))
    card, path = card_text(about, kind, read_manifest(run).get("versions", {})), inside(folder, "README.md")
    for shard in shards:
        for ending in (shards_format.ending, ".json"):
            if os.path.lexists(inside(place, shard.file(ending))):
                raise InputError("is there already", expected="a new folder", where=place / shard.file(ending))
    if os.path.lexists(path) and (not path.is_file() or path.read_text(encoding="utf-8", errors="replace") != card):
        raise InputError("another data set's card is there already", expected="a new folder", where=path)
    made_folder(folder, *filter(None, [shards_format.folder]))
    write_text(path, card)
    written = [_write_shard(place, shards_format, shard, members, about) for shard, members in shards.items()]
    if kind == "huggingface":
        write_croissant(folder)
    return written


def _write_shard(place: Path, shards_format: Format, shard: ShardName, items: list[RunItem], about: About) -> Path:
    """Write one shard and its record; returns the shard's path."""
    path = inside(place, shard.file(shards_format.ending))
    with replacing(path) as partial:
        shards_format.write(partial, (read_sample(item, about.contents) for item in items))
    record = {
        "file": path.name,
        "split": shard.split,
        "samples": len(items),
        "bytes": path.stat().st_size,
        "sha256": sha256_of(path),
        "contents": list(about.contents),
        "title": about.title,
        "description": ABOUT,
        "license": about.license_url,
        "items": [item.id for item in items],
    }
    write_text(inside(place, shard.file(".json")), json.dumps(record, indent=1) + "\n")
    return path


def empty_splits(written: list[Path]) -> list[str]:
    """The splits that none of the written shards belongs to."""
    return [split for split in SPLITS if not any(path.name.startswith(f"{split}-") for path in written)]
