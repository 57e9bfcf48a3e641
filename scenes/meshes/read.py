"""Reads a mesh file of any format into triangles with smooth normals, framed for the camera.

OBJ, PLY and OFF, whose polygons may have any number of corners, are read here; the other formats by trimesh. What had
to be mended (doubled faces, faces wound the other way …) is counted and said.
"""

from collections.abc import Callable
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
NEEDS = {".3mf": ("lxml", "networkx"), ".dae": ("collada", "lxml")}  # modules beyond the plain installation


def read_mesh(
    path: Path,
    *,
    rotation_deg: tuple[float, float, float],
    smooth_deg: float,
    log: Callable[[str], None] = lambda line: None,
) -> Mesh:
    """Read a mesh file, rotate it, and move and scale it to fit in [-1, 1]² in x and y.

    ``rotation_deg``: about x, then y, then z. Faces that meet at an angle below ``smooth_deg`` have a smooth normal at
    their common edge; sharper edges stay creases. Camera frame. ``log`` is called with a line on what was mended.
    Raises InputError for a file that is not a mesh.
    """
    import trimesh

    if not path.is_file():
        raise InputError("no such mesh", where=path)
    require_mesh_size(path)
    vertices, faces, reentrant = _triangles(path)
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
        merged.update_faces(merged.nondegenerate_faces())
    except (ArithmeticError, ValueError, IndexError) as error:
        raise InputError("a mesh that is much deeper than wide", got=type(error).__name__, where=path) from None
    if len(merged.faces) == 0:
        raise InputError("a mesh with degenerate triangles only", where=path)
    once = _without_doubles(np.asarray(merged.faces))
    final, turned = oriented(np.asarray(merged.vertices), once)
    mended = {
        "{} polygons with reentrant corners were cut into triangles within them": reentrant,
        "{} faces of no area were left out": len(faces) - len(merged.faces),
        "{} faces that lie on another face were left out": len(merged.faces) - len(once),
        f"{{}} of {len(once):,} faces were turned, which were wound the other way than their neighbours or the "
        "outside": turned,
    }
    if any(mended.values()):
        log("mesh: " + "; ".join(text.format(f"{count:,}") for text, count in mended.items() if count))
    return split_creases(np.asarray(merged.vertices), final, smooth_deg)


def _triangles(path: Path) -> tuple[np.ndarray, np.ndarray, int]:
    """(vertices (V, 3), triangles (F, 3), number of reentrant polygons) of a file. Raises InputError."""
    suffix = path.suffix.lower()
    if suffix in OWN_READERS:
        polygons = OWN_READERS[suffix](path)
        require_indices(polygons, path)
        with np.errstate(all="ignore"):
            triangles, reentrant = triangulated(polygons, path)
        return polygons.vertices, triangles, reentrant
    if missing := [module for module in NEEDS.get(suffix, ()) if find_spec(module) is None]:
        what = f"reading {suffix} needs a package that is not installed ({missing[0]}): pip install 'huesphere[meshes]'"
        raise InputError(what, where=path)
    if suffix in (".gltf", ".glb"):
        require_readable(path)
    vertices, faces = _by_trimesh(path)
    return vertices, faces, 0


def _by_trimesh(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """(vertices (V, 3), triangles (F, 3)) of a file of a format of trimesh; a scene of several meshes is joined."""
    import trimesh

    try:
        with silence():
            loaded = load_mesh(path)
    except InputError:
        raise
    except Exception as error:  # trimesh's readers raise whatever their formats provoke
        got = f"{type(error).__name__}: {str(error)[:80]}"
        raise InputError("not a readable mesh, empty or damaged", got=got, where=path) from None
    if not isinstance(loaded, trimesh.Trimesh) or len(loaded.faces) == 0:
        raise InputError("a mesh without triangles", where=path)
    if np.shape(loaded.vertices)[1:] != (3,) or np.shape(loaded.faces)[1:] != (3,):
        raise InputError("a mesh that is not of triangles in space", where=path)
    vertices, faces = np.asarray(loaded.vertices, float), np.asarray(loaded.faces)
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError("a mesh with triangles of vertices that it does not have", where=path)
    return vertices, faces


def _without_doubles(faces: np.ndarray) -> np.ndarray:
    """``faces`` (F, 3) without those that have the same three vertices as an earlier one, in whatever order."""
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return faces[np.sort(first)]


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
