"""Divides a run into splits, so that no shape is in two of them, and into shards that machines can write alone.

The split of an item depends on its shape alone, its shard on the geometry that was traced (shape and places of lights),
both by SHA-256. So neither changes when items are added, and ``render --shard I/M`` leaves machine I with whole shards
wherever M divides their number.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

from huesphere.configs.errors import InputError
from huesphere.configs.schema import RunConfig
from huesphere.eval.datasets.sample import geometry_key
from huesphere.render.dataset import RunItem
from huesphere.render.plan import number_of_part
from huesphere.render.relighting import geometry_of

SPLITS = ("train", "validation", "test")
MOST_SHARDS = 100_000


@dataclass(frozen=True)
class Shares:
    """How shapes are shared among SPLITS; the three numbers add up to 1."""

    train: float = 0.8
    validation: float = 0.1
    test: float = 0.1

    def split_of(self, geometry: str) -> str:
        """The split of the shape that ``sample.geometry_key`` names so."""
        place = int.from_bytes(hashlib.sha256(f"split {geometry}".encode()).digest()[:8], "big") / 2**64
        if place < self.train:
            return "train"
        return "validation" if place < self.train + self.validation else "test"


def parse_shares(text: str) -> Shares:
    """Shares from a text such as "80,10,10", in the order of SPLITS. Raises InputError."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != len(SPLITS) or not all(0 <= n < 1e6 for n in numbers) or not sum(numbers) > 0:
        raise InputError("--splits", got=text, expected="shares of train, validation and test, such as 80,10,10")
    return Shares(*(n / sum(numbers) for n in numbers))


@dataclass(frozen=True)
class ShardName:
    """One file of a data set: part ``number``, from 0, of ``count`` of a split."""

    split: str
    number: int
    count: int

    def file(self, ending: str) -> str:
        return f"{self.split}-{self.number:05}-of-{self.count:05}{ending}"


def shard_of(config: RunConfig, shares: Shares, count: int) -> ShardName:
    """The shard of the items of a config, if each split has ``count``."""
    return ShardName(shares.split_of(geometry_key(config)), number_of_part(geometry_of(config), count), count)


def in_shards(items: Sequence[RunItem], shares: Shares, count: int) -> dict[ShardName, list[RunItem]]:
    """The items of each shard that has any, in the order of splits, numbers and ids. Raises InputError."""
    if not 1 <= count <= MOST_SHARDS:
        raise InputError("--shards", got=count, expected=f"1 to {MOST_SHARDS}")
    found: dict[ShardName, list[RunItem]] = {}
    for item in items:
        found.setdefault(shard_of(item.config(), shares, count), []).append(item)
    order = sorted(found, key=lambda shard: (SPLITS.index(shard.split), shard.number))
    return {shard: sorted(found[shard], key=lambda item: item.id) for shard in order}
