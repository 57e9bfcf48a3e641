"""Opens photographs of any layout that is known, by the names of the files in the folder."""

from pathlib import Path

from huesphere.configs.errors import InputError
from huesphere.configs.photographed import Photographs
from huesphere.render.photographs.diligent import NAMES, read_diligent
from huesphere.render.photographs.luces import PARAMETERS, read_luces
from huesphere.render.photographs.photograph_set import PhotographSet, StoredSet, prepared
from huesphere.render.photographs.psm_images import objects_in, read_psm_images
from huesphere.render.photographs.stack import read_stack


def open_photographs(spec: Photographs) -> PhotographSet:
    """The set that ``spec`` names; photographs themselves are read one by one, when they are asked for.

    Raises InputError for a path that is missing or of no known layout, and for files that cannot be read.
    """
    if spec.path is None:
        raise InputError("shape.path: no photographs are named", expected="render --shape FOLDER_OR_NPZ")
    path = Path(spec.path)
    layout = _layout(path) if spec.layout == "auto" else spec.layout
    if spec.object is not None and layout != "psm":
        raise InputError("shape.object is for psmImages", got=f"layout {layout}", where=path)
    if layout == "npz" and spec.encoding != "linear":
        raise InputError("shape.encoding: an npz is linear", got=spec.encoding, where=path)
    if (layout == "npz") == path.is_dir():
        got = "a folder" if path.is_dir() else "a file"
        raise InputError(f"shape.layout={layout}", got=got, expected="the other", where=path)
    stored = _read(layout, path, spec)
    return prepared(stored, reduce=spec.reduce, sphere=spec.normals == "sphere", where=path)


def _read(layout: str, path: Path, spec: Photographs) -> StoredSet:
    if layout == "npz":
        return read_stack(path)
    if layout == "diligent":
        return read_diligent(path, spec.encoding)
    if layout == "luces":
        return read_luces(path, spec.encoding)
    return read_psm_images(path, spec.object, spec.encoding)


def _layout(path: Path) -> str:
    """The layout of what lies at ``path``. Raises InputError."""
    if path.is_file():
        if path.suffix.lower() == ".npz":
            return "npz"
        raise InputError("photographs", got=f"suffix {path.suffix!r}", expected="a folder or an npz", where=path)
    if not path.is_dir():
        raise InputError("no such folder or npz of photographs", where=path)
    if (path / NAMES).is_file():
        return "diligent"
    if (path / PARAMETERS).is_file():
        return "luces"
    if objects_in(path):
        return "psm"
    raise InputError(
        "no photographs of a known layout",
        expected=f"{NAMES} (DiLiGenT), {PARAMETERS} (LUCES), or NAME.0.tga with NAME.mask.tga (psmImages)",
        where=path,
    )
