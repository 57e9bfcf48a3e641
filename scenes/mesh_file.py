"""Loads mesh files by trimesh: regular files of bounded size, and what they refer to only from beside them."""

import contextlib
import io
import zipfile
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from huesphere.configs.errors import InputError
from huesphere.configs.picture_size import require_unpacked_size
from huesphere.configs.regular_file import check_regular, read_bytes

MESH_BYTES = 512 * 2**20
MOST_FACES = 10_000_000
ARCHIVES = (".zip", ".gz", ".bz2", ".xz", ".tar", ".tgz", ".7z", ".zae")  # trimesh would unpack these without a limit


def load_mesh(path: Path) -> Any:
    """What `trimesh.load` makes of the file at ``path``: one Trimesh, if it holds triangles.

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
    try:
        str(path).encode("utf-8")
    except UnicodeEncodeError:  # trimesh makes the name a part of its scene and encodes it in UTF-8
        beside.file_name = f"mesh{path.suffix}"
        contents = io.BytesIO(read_bytes(path, most=MESH_BYTES))
        kind = path.suffix[1:].lower()
        return trimesh.load(contents, file_type=kind, force="mesh", process=False, resolver=beside)
    return trimesh.load(path, force="mesh", process=False, resolver=beside)


def require_mesh_size(path: Path) -> None:
    """Raise InputError for anything but a regular file of at most MESH_BYTES that is no archive of unknown size."""
    check_regular(path, most=MESH_BYTES)
    if path.suffix.lower() in ARCHIVES:
        raise InputError("a mesh in an archive is not read", expected="the unpacked file", where=path)
    if path.suffix.lower() == ".3mf":
        with contextlib.suppress(zipfile.BadZipFile):  # whoever decodes it tells that it is damaged
            require_unpacked_size(path)
