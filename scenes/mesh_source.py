"""What trimesh is given to read of a mesh file, so that its name may hold bytes that are no text."""

import io
from pathlib import Path
from typing import Any


def mesh_source(path: Path) -> dict[str, Any]:
    """The arguments of ``trimesh.load`` for the file: its path, or its contents where the path is not Unicode.

    trimesh makes the name a part of its scene and encodes it in UTF-8. Files that the mesh refers to are found beside
    it in either case.
    """
    try:
        str(path).encode("utf-8")
    except UnicodeEncodeError:
        from trimesh.resolvers import FilePathResolver

        beside = FilePathResolver(str(path))
        beside.file_name = f"mesh{path.suffix}"  # a name for the scene; files are looked for in ``beside.parent``
        contents = io.BytesIO(path.read_bytes())
        return {"file_obj": contents, "file_type": path.suffix[1:].lower(), "resolver": beside}
    return {"file_obj": path}
