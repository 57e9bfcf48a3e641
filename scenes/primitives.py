"""Meshes of shapes with a formula: ball and parts of it, ellipsoid, V-groove, bowl, rectangle.

Camera frame (x right, y up, z toward the camera). Each shape fits in [-1, 1]² in x and y. Normals are those of the
exact surface, not of the facets. ``detail`` is a number of facets.
"""

from dataclasses import replace

import numpy as np

from huesphere.scenes.mesh import Mesh

# The eight faces of an octahedron, counter-clockwise from outside: signs of (x, y, z).
OCTANTS = [(sx, sy, sz) for sz in (1, -1) for sy in (1, -1) for sx in (1, -1)]


def ball(detail: int, *, part: str = "sphere") -> Mesh:
    """The unit sphere (``part`` "sphere"), its half toward the camera ("hemisphere"), or x, y, z > 0 ("octant").

    ``detail`` facets lie along a quarter of a great circle; 8·detail² facets make the whole.
    """
    chosen = {"sphere": OCTANTS, "hemisphere": OCTANTS[:4], "octant": OCTANTS[:1]}[part]
    points, faces = _octant_grid(detail)
    vertices = np.concatenate([points * signs for signs in chosen])
    # A reflection reverses the orientation of the faces, so the order of their corners is reversed too.
    flip = [int(np.prod(signs)) < 0 for signs in chosen]
    all_faces = np.concatenate([(faces[:, ::-1] if f else faces) + i * len(points) for i, f in enumerate(flip)])
    vertices, all_faces = _merge(vertices, all_faces)
    return _one_material(vertices, all_faces, vertices.copy())


def ellipsoid(semi_axes: tuple[float, float, float], rotation_deg: tuple[float, float, float], detail: int) -> Mesh:
    """An ellipsoid with these semi-axes, rotated about x, then y, then z (degrees), and scaled into [-1, 1]²."""
    unit = ball(detail)
    axes = np.asarray(semi_axes, dtype=float)
    turn = rotation_matrix(rotation_deg)
    vertices = (unit.vertices * axes) @ turn.T
    normals = (unit.vertices / axes) @ turn.T
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    vertices /= np.abs(vertices[:, :2]).max()
    return _one_material(vertices, unit.faces, normals)


def v_groove(angle_deg: float, turn_deg: float, detail: int) -> Mesh:
    """A V-groove: two walls that meet in a line at z = 0 at the angle ``angle_deg`` and open toward the camera.

    The groove is 2 wide and 2 long; it is then rotated about the view axis by ``turn_deg`` and scaled into [-1, 1]².
    """
    half = np.radians(angle_deg) / 2
    wall_width = 1.0 / np.sin(half)
    turn = rotation_matrix((0.0, 0.0, turn_deg))
    walls = []
    for side in (1.0, -1.0):
        into = np.array([side * np.sin(half), 0.0, np.cos(half)]) * wall_width
        along = np.array([0.0, 2.0 * side, 0.0])
        corner = np.array([0.0, -side, 0.0])
        # The front of a wall faces the inside of the groove.
        walls.append(rectangle(corner, into, along, (detail, 2 * detail)))
    joined = join(walls)
    vertices, normals = joined.vertices @ turn.T, joined.normals @ turn.T
    scale = np.abs(vertices[:, :2]).max()
    return Mesh(vertices / scale, joined.faces, normals, joined.material)


def bowl(opening_deg: float, detail: int) -> Mesh:
    """The inside of a spherical cap of half-angle ``opening_deg``, its rim toward the camera, in [-1, 1]²."""
    half = ball(detail, part="hemisphere")
    polar = np.arccos(np.clip(half.vertices[:, 2], -1, 1)) * opening_deg / 90.0
    azimuth = np.arctan2(half.vertices[:, 1], half.vertices[:, 0])
    outward = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), -np.cos(polar)], axis=1)
    vertices = outward / np.sin(np.radians(opening_deg))
    vertices[:, 2] -= vertices[:, 2].max()
    return _one_material(vertices, half.faces, -outward)


def rectangle(corner: np.ndarray, edge_u: np.ndarray, edge_v: np.ndarray, cells: tuple[int, int]) -> Mesh:
    """A flat rectangle corner + s·edge_u + t·edge_v in ``cells`` (along u, along v); its normal is edge_u × edge_v."""
    nu, nv = cells
    s, t = np.meshgrid(np.linspace(0, 1, nu + 1), np.linspace(0, 1, nv + 1), indexing="ij")
    vertices = corner + s.reshape(-1, 1) * edge_u + t.reshape(-1, 1) * edge_v
    normal = np.cross(edge_u, edge_v)
    normals = np.tile(normal / np.linalg.norm(normal), (len(vertices), 1))
    index = np.arange(len(vertices), dtype=np.int32).reshape(nu + 1, nv + 1)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return _one_material(vertices, faces, normals)


def join(meshes: list[Mesh]) -> Mesh:
    """Several meshes as one; materials keep their numbers. Attributes that a mesh lacks and another has are 0."""
    starts = np.cumsum([0, *(len(m.vertices) for m in meshes)])

    def joined(name: str, width: int) -> np.ndarray | None:
        found = [getattr(m, name) for m in meshes]
        if all(values is None for values in found):
            return None
        sizes = [(len(m.vertices), width) for m in meshes]
        return np.concatenate([np.zeros(n) if v is None else v for v, n in zip(found, sizes, strict=True)])

    return Mesh(
        vertices=np.concatenate([m.vertices for m in meshes]),
        faces=np.concatenate([m.faces + s for m, s in zip(meshes, starts, strict=False)]).astype(np.int32),
        normals=np.concatenate([m.normals for m in meshes]),
        material=np.concatenate([m.material for m in meshes]),
        uv=joined("uv", 2),
        colour=joined("colour", 3),
    )


def with_material(mesh: Mesh, material: int) -> Mesh:
    """``mesh`` with all faces of this material."""
    return replace(mesh, material=np.full(len(mesh.faces), material, dtype=np.int32))


def rotation_matrix(angles_deg: tuple[float, float, float]) -> np.ndarray:
    """Rotation about x, then y, then z, in degrees, as a (3, 3) matrix that acts on columns."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_euler("xyz", angles_deg, degrees=True).as_matrix()


def _octant_grid(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Points (P, 3) on the unit sphere's octant x, y, z >= 0 and faces (n², 3), counter-clockwise from outside."""
    ij = [(i, j) for i in range(n + 1) for j in range(n + 1 - i)]
    i, j = np.array(ij).T
    # Angles are evenly spaced along the edges of the octant, which makes facets of similar size.
    weights = np.sin(np.stack([i, j, n - i - j], axis=1) / n * np.pi / 2)
    points = weights / np.linalg.norm(weights, axis=1, keepdims=True)
    start = np.cumsum([0, *(n + 1 - k for k in range(n + 1))])  # first point of column i
    faces = []
    for a in range(n):
        b = np.arange(n - a)
        faces.append(np.stack([start[a] + b, start[a + 1] + b, start[a] + b + 1], axis=1))
        b = b[:-1]
        faces.append(np.stack([start[a + 1] + b, start[a + 1] + b + 1, start[a] + b + 1], axis=1))
    return points, np.concatenate(faces).astype(np.int32)


def _merge(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Join vertices that coincide (edges shared by two octants)."""
    keys = np.round(vertices * 2**40).astype(np.int64)
    _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return vertices[first], inverse.reshape(-1)[faces].astype(np.int32)


def _one_material(vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray) -> Mesh:
    """A mesh with material 0."""
    return Mesh(vertices, faces.astype(np.int32), normals, np.zeros(len(faces), dtype=np.int32))
