"""Loads mesh files by trimesh: regular files of bounded size, and what they refer to only from beside them."""

import contextlib
import io
import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.picture_size import require_unpacked_size
from huesphere.configs.regular_file import check_regular, read_bytes
from huesphere.scenes.encoding import decode_srgb

MESH_BYTES = 512 * 2**20
MOST_FACES = 10_000_000
GLTF = (".glb", ".gltf")
ARCHIVES = (".zip", ".gz", ".bz2", ".xz", ".tar", ".tgz", ".7z", ".zae")  # trimesh would unpack these without a limit


def load_mesh(path: Path, *, attributes: bool) -> tuple[Any, np.ndarray | None, np.ndarray | None]:
    """(what `trimesh.load` makes of the file at ``path``: one Trimesh, if it holds triangles; uv (V, 2); colours).

    With ``attributes`` the texture coordinates and linear colours (V, 3) of its vertices; None where parts lack them.

    Raises InputError for anything but a regular file of at most MESH_BYTES, for archives, and for a file beside the
    mesh (a buffer of glTF) that is none; whatever trimesh raises for a damaged file.
    """
    import trimesh
    from trimesh.resolvers import FilePathResolver

    class Beside(FilePathResolver):  # type: ignore[misc]
        """Reads the files that a mesh refers to, if they are regular files below the folder of the mesh."""

        def get(self, name: str) -> bytes:
            folder = path.parent.resolve()
            asked = (folder / unquote(str(name).strip())).resolve()
            if not asked.is_relative_to(folder):
                raise InputError("a mesh that refers to a file outside its folder", got=repr(name)[:60], where=path)
            return read_bytes(asked, most=MESH_BYTES)

    require_mesh_size(path)
    beside = Beside(str(path))
    options: dict[str, Any] = {"process": False, "resolver": beside} | ({} if attributes else {"force": "mesh"})
    try:
        str(path).encode("utf-8")
        loaded = trimesh.load(path, **options)
    except UnicodeEncodeError:  # trimesh makes the name a part of its scene and encodes it in UTF-8
        beside.file_name = f"mesh{path.suffix}"
        contents = io.BytesIO(read_bytes(path, most=MESH_BYTES))
        loaded = trimesh.load(contents, file_type=path.suffix[1:].lower(), **options)
    return _joined(loaded, linear=path.suffix.lower() in GLTF) if attributes else (loaded, None, None)


def _joined(loaded: Any, *, linear: bool) -> tuple[Any, np.ndarray | None, np.ndarray | None]:
    """The parts of what trimesh loaded as one mesh, with their texture coordinates and colours.

    trimesh itself would pack the pictures of several parts into one, and change the coordinates. ``linear``: whether
    colours are linear, as those of glTF are; otherwise they are encoded as sRGB.
    """
    import trimesh

    found: list[Any] = list(loaded.dump()) if isinstance(loaded, trimesh.Scene) else [loaded]
    parts = [part for part in found if isinstance(part, trimesh.Trimesh)]
    if not parts:
        return loaded, None, None
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    vertices = np.concatenate([np.asarray(part.vertices) for part in parts])
    faces = np.concatenate([np.asarray(part.faces) + n for part, n in zip(parts, starts, strict=False)])
    uv = _of_all(getattr(part.visual, "uv", None) for part in parts)
    colour = _of_all(_colours(part) for part in parts)
    if colour is not None and not linear:
        colour = decode_srgb(colour)
    return trimesh.Trimesh(vertices, faces, process=False), uv, colour


def _of_all(values: Iterable[Any]) -> np.ndarray | None:
    """One array of the values of all parts; None if a part has none."""
    known = list(values)
    return None if any(one is None for one in known) else np.concatenate([np.asarray(one, float) for one in known])


def _colours(part: Any) -> np.ndarray | None:
    """Colours (V, 3) of a Trimesh's vertices as stored, full scale 1; None if it has none."""
    if part.visual.kind == "vertex":
        return np.asarray(part.visual.vertex_colors)[:, :3] / 255.0
    stored = getattr(part.visual, "vertex_attributes", {}).get("color")
    if stored is None:
        return None
    stored = np.asarray(stored)
    return stored[:, :3] / (np.iinfo(stored.dtype).max if stored.dtype.kind in "iu" else 1.0)


def require_mesh_size(path: Path) -> None:
    """Raise InputError for anything but a regular file of at most MESH_BYTES that is no archive of unknown size."""
    check_regular(path, most=MESH_BYTES)
    if path.suffix.lower() in ARCHIVES:
        raise InputError("a mesh in an archive is not read", expected="the unpacked file", where=path)
    if path.suffix.lower() == ".3mf":
        with contextlib.suppress(zipfile.BadZipFile):  # whoever decodes it tells that it is damaged
            require_unpacked_size(path)
