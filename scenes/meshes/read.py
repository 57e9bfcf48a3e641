"""Reads a mesh file of any format into triangles with smooth normals, framed for the camera.

OBJ, PLY and OFF, whose polygons may have any number of corners, are read here; the other formats by trimesh. What had
to be mended (doubled faces, faces wound the other way …) is counted and said.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.quiet import silence
from huesphere.scenes.mesh import Mesh
from huesphere.scenes.mesh_file import MOST_FACES, load_mesh, require_mesh_size
from huesphere.scenes.meshes.gltf import require_readable
from huesphere.scenes.meshes.obj import read_obj
from huesphere.scenes.meshes.off import read_off
from huesphere.scenes.meshes.orientation import oriented
from huesphere.scenes.meshes.ply import read_ply
from huesphere.scenes.meshes.polygons import Polygons, require_indices, triangulated
from huesphere.scenes.primitives import rotation_matrix
from huesphere.scenes.surfaces import split_creases

OWN_READERS: dict[str, Callable[[Path], Polygons]] = {".obj": read_obj, ".ply": read_ply, ".off": read_off}
LARGEST_UV = 1000.0  # texture coordinates beyond 1 repeat the picture; so many times no picture is meant to be
NEEDS = {".3mf": ("lxml", "networkx"), ".dae": ("collada", "lxml")}  # modules beyond the plain installation


def read_mesh(
    path: Path,
    *,
    rotation_deg: tuple[float, float, float],
    smooth_deg: float,
    attributes: bool = False,
    log: Callable[[str], None] = lambda line: None,
) -> Mesh:
    """Read a mesh file, rotate it, and move and scale it to fit in [-1, 1]² in x and y.

    ``rotation_deg``: about x, then y, then z. Faces that meet at an angle below ``smooth_deg`` have a smooth normal at
    their common edge; sharper edges stay creases. Camera frame. ``attributes``: whether the mesh gets the texture
    coordinates and colours of vertices that the file has; it is divided where these jump. ``log`` is called with a
    line on what was mended. Raises InputError for a file that is not a mesh.
    """
    import trimesh

    if not path.is_file():
        raise InputError("no such mesh", where=path)
    require_mesh_size(path)
    read = _triangles(path, attributes=attributes)
    vertices, faces, uv, colour = read.vertices, read.faces, read.uv, read.colour
    if len(faces) == 0:
        raise InputError("a mesh without triangles", where=path)
    if len(faces) > MOST_FACES:
        raise InputError("too large a mesh", got=f"{len(faces):,} faces", expected=f"{MOST_FACES:,}", where=path)
    if not np.isfinite(vertices[np.unique(faces)]).all():
        raise InputError("a mesh with vertices that are not finite numbers", where=path)
    vertices, faces = _framed(vertices, faces, rotation_deg, path)
    try:
        merged = trimesh.Trimesh(vertices, faces, process=False)
        merged.merge_vertices()  # by an absolute tolerance, so only once the size is known
        whole = np.asarray(merged.nondegenerate_faces())
        merged.update_faces(whole)
    except (ArithmeticError, ValueError, IndexError) as error:
        raise InputError("a mesh that is much deeper than wide", got=type(error).__name__, where=path) from None
    if len(merged.faces) == 0:
        raise InputError("a mesh with degenerate triangles only", where=path)
    kept = _first_of_doubles(np.asarray(merged.faces))
    once = np.asarray(merged.faces)[kept]
    final, turned = oriented(np.asarray(merged.vertices), once)
    over = (final[:, 0] != once[:, 0])[:, None, None]
    uv, colour = (None if a is None else np.where(over, a[whole][kept][:, ::-1], a[whole][kept]) for a in (uv, colour))
    mended = {
        "{} polygons with reentrant corners were cut into triangles within them": read.reentrant,
        "{} faces of no area were left out": len(faces) - len(merged.faces),
        "{} faces that lie on another face were left out": len(merged.faces) - len(once),
        f"{{}} of {len(once):,} faces were turned, which were wound the other way than their neighbours or the "
        "outside": turned,
    }
    if any(mended.values()):
        log("mesh: " + "; ".join(text.format(f"{count:,}") for text, count in mended.items() if count))
    return split_creases(np.asarray(merged.vertices), final, smooth_deg, uv, colour)


@dataclass(frozen=True)
class _Triangles:
    """A file as triangles."""

    vertices: np.ndarray  # (V, 3)
    faces: np.ndarray  # (F, 3)
    uv: np.ndarray | None = None  # (F, 3, 2) texture coordinates of the corners
    colour: np.ndarray | None = None  # (F, 3, 3) linear R, G, B of the corners
    reentrant: int = 0  # number of polygons with reentrant corners


def _triangles(path: Path, *, attributes: bool) -> _Triangles:
    """The triangles of a file, with ``attributes`` those of their corners that are finite. Raises InputError."""
    of_trimesh = path.suffix.lower() not in OWN_READERS
    read = (_by_trimesh if of_trimesh else _polygons)(path, attributes=attributes)
    uv, colour = (a if a is not None and np.isfinite(a).all() else None for a in (read.uv, read.colour))
    if uv is not None and np.abs(uv).max(initial=0.0) > LARGEST_UV:
        raise InputError("texture coordinates", got=f"up to {np.abs(uv).max():.3g}", expected="0 to 1", where=path)
    return replace(read, uv=uv, colour=None if colour is None else np.clip(colour, 0.0, 1.0))


def _polygons(path: Path, *, attributes: bool) -> _Triangles:
    """The triangles of a file that is read here. Raises InputError."""
    polygons = OWN_READERS[path.suffix.lower()](path)
    require_indices(polygons, path)
    with np.errstate(all="ignore"):
        if not attributes or (polygons.uv is None and polygons.colour is None):
            faces, reentrant = triangulated(polygons, path)
            return _Triangles(polygons.vertices, faces, reentrant=reentrant)
        # With a vertex of its own for each corner, so that triangles are of corners.
        number = np.arange(len(polygons.corners))
        apart = replace(polygons, vertices=polygons.vertices[polygons.corners], corners=number)
        of_corners, reentrant = triangulated(apart, path)
    faces = polygons.corners[of_corners]
    uv = None if polygons.uv is None else polygons.uv[of_corners]
    colour = None if polygons.colour is None else polygons.colour[faces]
    return _Triangles(polygons.vertices, faces, uv, colour, reentrant)


# Errors that trimesh's readers meet by accident, where a file lacks what they take for granted.
ACCIDENTS = (AttributeError, TypeError, LookupError)


def _told(error: Exception, suffix: str) -> str:
    """What a reader of trimesh says of a file that it cannot read; its accidents in words."""
    name = type(error).__name__
    text = str(error).removeprefix(f"{name}: ")[:80]
    if isinstance(error, ACCIDENTS) or not text:
        return f"a {suffix} file without a mesh that can be found in it"
    return f"{name}: {text}"


def _by_trimesh(path: Path, *, attributes: bool) -> _Triangles:
    """The triangles of a file of a format of trimesh; a scene of several meshes is joined. Raises InputError."""
    suffix = path.suffix.lower()
    if missing := [module for module in NEEDS.get(suffix, ()) if find_spec(module) is None]:
        what = f"reading {suffix} needs a package that is not installed ({missing[0]}): pip install 'huesphere[meshes]'"
        raise InputError(what, where=path)
    if suffix in (".gltf", ".glb"):
        require_readable(path)
    import trimesh

    try:
        with silence():
            loaded, uv, colour = load_mesh(path, attributes=attributes)
    except InputError:
        raise
    except Exception as error:  # trimesh's readers raise whatever their formats provoke
        raise InputError("not a readable mesh, empty or damaged", got=_told(error, suffix), where=path) from None
    if not isinstance(loaded, trimesh.Trimesh) or len(loaded.faces) == 0:
        raise InputError("a mesh without triangles", where=path)
    if np.shape(loaded.vertices)[1:] != (3,) or np.shape(loaded.faces)[1:] != (3,):
        raise InputError("a mesh that is not of triangles in space", where=path)
    vertices, faces = np.asarray(loaded.vertices, float), np.asarray(loaded.faces)
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError("a mesh with triangles of vertices that it does not have", where=path)
    corner_uv, corner_colour = (None if a is None else a[faces] for a in (uv, colour))
    return _Triangles(vertices, faces, corner_uv, corner_colour)


def _first_of_doubles(faces: np.ndarray) -> np.ndarray:
    """Numbers of the ``faces`` (F, 3) without those that have the three vertices of an earlier one, in any order."""
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return np.sort(first)


def _framed(
    vertices: np.ndarray, faces: np.ndarray, rotation_deg: tuple[float, float, float], path: Path
) -> tuple[np.ndarray, np.ndarray]:
    """(vertices, faces): the vertices that faces use, rotated, and moved and scaled into [-1, 1]² in x and y."""
    used, faces = np.unique(faces, return_inverse=True)
    with np.errstate(over="ignore", invalid="ignore"):
        turned = vertices[used] @ rotation_matrix(rotation_deg).T
        moved = turned - (turned.max(axis=0) / 2 + turned.min(axis=0) / 2)
        extent = np.abs(moved[:, :2]).max()
        if not extent > 0:
            raise InputError("a mesh seen edge on, of no width", where=path)
        framed = moved / extent
    if not np.isfinite(framed).all():
        raise InputError("a mesh whose size is not a finite number", where=path)
    return framed, faces.reshape(-1, 3)
