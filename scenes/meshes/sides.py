"""Gives the open parts of a mesh a second side, and turns closed parts that show their back."""

from dataclasses import replace

import numpy as np

from huesphere.scenes.mesh import Mesh
from huesphere.scenes.meshes.orientation import Parts, parts_of


def parts_in_space(mesh: Mesh) -> tuple[Parts, np.ndarray]:
    """(the parts of a mesh, number of the place (V,) of each vertex); vertices of a crease are at one place."""
    _, place = np.unique(mesh.vertices, axis=0, return_inverse=True)
    place = place.reshape(-1)
    return parts_of(place[mesh.faces]), place


def turned_over(mesh: Mesh, faces: np.ndarray) -> Mesh:
    """``mesh`` with these ``faces`` (F,) bool turned, and the normals of their vertices with them.

    A vertex must not belong both to faces that are turned and to others.
    """
    vertices = np.unique(mesh.faces[faces])
    normals = mesh.normals.copy()
    normals[vertices] *= -1
    return replace(mesh, faces=np.where(faces[:, None], mesh.faces[:, ::-1], mesh.faces), normals=normals)


def with_second_side(mesh: Mesh, faces: np.ndarray, place: np.ndarray, thickness: float) -> Mesh:
    """``mesh`` with a copy of these ``faces`` (F,) bool, turned, at the distance ``thickness`` behind them.

    ``place`` (V,) are the numbers of the vertices' places. All vertices at one place are moved by the same vector,
    along the mean normal there, so that the copy has no gaps along creases.
    """
    used, corners = np.unique(mesh.faces[faces], return_inverse=True)
    mean = np.zeros((int(place.max()) + 1, 3))
    np.add.at(mean, place[used], mesh.normals[used])
    mean = mean[place[used]]
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-12)
    copied = corners.reshape(-1, 3)[:, ::-1] + len(mesh.vertices)
    return Mesh(
        np.concatenate([mesh.vertices, mesh.vertices[used] - thickness * mean]),
        np.concatenate([mesh.faces, copied]).astype(np.int32),
        np.concatenate([mesh.normals, -mesh.normals[used]]),
        np.concatenate([mesh.material, mesh.material[faces]]),
        *(None if a is None else np.concatenate([a, a[used]]) for a in (mesh.uv, mesh.colour)),
    )
