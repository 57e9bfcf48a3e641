"""Two reflectances on one object, in a three-dimensional checkerboard: by whole faces, or around vertices."""

import numpy as np

from huesphere.scenes.mesh import Mesh


def paint_faces(mesh: Mesh, size: float, material: int) -> Mesh:
    """``mesh`` with ``material`` on the faces whose centres lie in the odd cells of a grid of ``size``."""
    odd = _odd(mesh.vertices[mesh.faces].mean(axis=1), size)
    return Mesh(mesh.vertices, mesh.faces, mesh.normals, np.where(odd, material, mesh.material).astype(np.int32))


def paint_vertices(mesh: Mesh, size: float, material: int) -> Mesh:
    """``mesh`` with ``material`` around the vertices in the odd cells of a grid of ``size``.

    A face whose corners are in cells of both kinds is divided along the lines from its centre to the middles of its
    edges, and each third has the material of its corner. The vertices of the original mesh keep their numbers.
    """
    odd = _odd(mesh.vertices, size)
    corners = odd[mesh.faces]
    mixed = corners.any(axis=1) & ~corners.all(axis=1)
    whole, cut = mesh.faces[~mixed], mesh.faces[mixed]
    material_whole = np.where(corners[~mixed, 0], material, mesh.material[~mixed])
    edges, edge = np.unique(np.sort(cut[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0, return_inverse=True)
    first = len(mesh.vertices)
    middle = first + edge.reshape(-1, 3)  # (m, 3): of ab, bc, ca
    centre = first + len(edges) + np.arange(len(cut))
    pieces, painted = [], []
    for corner in range(3):
        after, before = middle[:, corner], middle[:, corner - 1]
        pieces += [
            np.stack([cut[:, corner], after, centre], axis=1),
            np.stack([cut[:, corner], centre, before], axis=1),
        ]
        painted += 2 * [np.where(odd[cut[:, corner]], material, mesh.material[mixed])]

    def extended(values: np.ndarray) -> np.ndarray:
        return np.concatenate([values, values[edges].mean(axis=1), values[cut].mean(axis=1)])

    normals = extended(mesh.normals)
    return Mesh(
        vertices=extended(mesh.vertices),
        faces=np.concatenate([whole, *pieces]).astype(np.int32),
        normals=normals / np.linalg.norm(normals, axis=1, keepdims=True),
        material=np.concatenate([material_whole, *painted]).astype(np.int32),
    )


def _odd(points: np.ndarray, size: float) -> np.ndarray:
    """Whether each of the points (N, 3) is in an odd cell of the grid, (N,) bool."""
    return np.floor(points / size).astype(int).sum(axis=1) % 2 == 1
