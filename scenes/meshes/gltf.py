"""What of glTF the reader cannot turn into triangles, so that it is refused and not left out."""

import json
import struct
from pathlib import Path

from huesphere.configs.errors import InputError

TRIANGLES, FAN = 4, 6  # primitive modes; 5 is a strip of triangles, others are points and lines
COMPRESSED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression")


def require_readable(path: Path) -> None:
    """Raise InputError for a .gltf or .glb file with triangle fans or compressed meshes, or that is damaged."""
    data = path.read_bytes()
    try:
        if data[:4] == b"glTF":
            (length,) = struct.unpack_from("<I", data, 12)
            data = data[20 : 20 + length]
        document = json.loads(data)
        modes = [p.get("mode", TRIANGLES) for mesh in document.get("meshes", ()) for p in mesh["primitives"]]
        compressed = [name for name in COMPRESSED if name in document.get("extensionsRequired", ())]
    except (ValueError, KeyError, TypeError, AttributeError, struct.error, RecursionError) as error:
        raise InputError("not a readable mesh", got=f"{type(error).__name__}: {str(error)[:60]}", where=path) from None
    if FAN in modes:
        raise InputError("triangle fans are not read", expected="triangles or triangle strips", where=path)
    if compressed:
        raise InputError(f"a mesh compressed by {compressed[0]} is not read", expected="plain buffers", where=path)
