"""Finds normal maps that other programs made, in a folder DIR, so that they are scored together with this project's.

A map of the picture <config>/<transport> of a run is one of these files, with any ending of map_samples.SUFFIXES:

DIR/<method>/<config>/<transport>.npy        for several methods
DIR/<config>/<transport>.npy                 for one method, whose name is that of DIR

A file frame.txt in DIR/<method>, or in DIR for all methods, holds the name of their frame (eval.frames), which the
option --frame overrules.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from huesphere.configs.errors import InputError
from huesphere.eval.frames import Frame
from huesphere.eval.map_samples import SUFFIXES
from huesphere.eval.score import Item, methods_on_disk

Maps = Mapping[str, Mapping[str, Path]]  # paths of normal maps, by item id and name of method


@dataclass(frozen=True)
class ExternalMaps:
    """The normal maps that are to be scored."""

    paths: Maps
    frames: Mapping[str, Frame] = field(default_factory=dict)  # of each method
    hints: tuple[str, ...] = ()  # lines for the user: frames that agree better with the truth than those given


FRAME_FILE = "frame.txt"
MOST_FRAME_BYTES = 1000


def find_external_maps(folder: Path, items: Sequence[Item]) -> dict[str, dict[str, Path]]:
    """Return the paths of the normal maps under ``folder`` (DIR), by item id and then by name of method.

    Raises InputError if the folder does not exist or has no map for any of the ``items``; if there are two files for
    the same picture and method; and if the run has an estimate of its own under the same name of method.
    """
    if not folder.is_dir():
        raise InputError("no such folder of normal maps", where=folder)
    found: dict[str, dict[str, Path]] = {}
    for item in items:
        of_item: dict[str, Path] = {}
        for method, place in _places(folder, item):
            files = _maps_in(place)
            if len(files) > 1:
                raise InputError("two normal maps for one result", got=files[1].name, expected="one", where=files[0])
            if files:
                of_item[method] = files[0]
        for method in set(of_item) & set(methods_on_disk(item)):
            raise InputError(
                "the run has an estimate of this name", got=method, expected="another name", where=of_item[method]
            )
        if of_item:
            found[item.id] = of_item
    if not found:
        expected = f"<method>/{items[0].id}{{{','.join(SUFFIXES)}}}"
        raise InputError("no normal map for any picture of the run", expected=expected, where=folder)
    return found


def written_frame(folder: Path, method: str) -> tuple[str, Path] | None:
    """(text, path) of the file frame.txt for the maps of a ``method`` under ``folder``; None if there is none.

    Raises InputError if it cannot be read.
    """
    for path in (folder / method / FRAME_FILE, folder / FRAME_FILE):
        if path.is_file():
            try:
                with path.open("rb") as file:
                    return file.read(MOST_FRAME_BYTES).decode("utf-8-sig").strip(), path
            except (OSError, UnicodeDecodeError) as error:
                raise InputError("cannot be read", got=type(error).__name__, where=path) from None
    return None


def _places(folder: Path, item: Item) -> list[tuple[str, Path]]:
    """Return (name of method, path without ending) of every place under ``folder`` where a map of ``item`` may be."""
    methods = sorted(entry for entry in folder.iterdir() if entry.is_dir() and (entry / item.config).is_dir())
    places = [(entry.name, entry / item.config / item.transport) for entry in methods]
    return [(folder.resolve().name, folder / item.config / item.transport), *places]


def _maps_in(place: Path) -> list[Path]:
    """The files of that name with an ending of SUFFIXES, in small or capital letters."""
    if not place.parent.is_dir():
        return []
    entries = sorted(entry for entry in place.parent.iterdir() if entry.stem == place.name and entry.is_file())
    return [entry for entry in entries if entry.suffix.lower() in SUFFIXES]
