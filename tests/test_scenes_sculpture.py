"""Random solids: closed, oriented, on their own distance function, with holes and overhangs, equal for equal seeds."""

import hashlib

import numpy as np
import pytest
import trimesh

from huesphere.scenes.sculpture import sculpture


def made(seed=1, **keys):
    return sculpture(seed, **({"detail": 32, "size": 1.0, "holes": 1, "relief": 0.3} | keys))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_sculpture_is_one_closed_solid_whose_faces_look_outward_as_its_normals_do(seed):
    mesh = made(seed)
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=True)
    assert solid.is_watertight
    assert solid.body_count == 1
    assert solid.volume > 0
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    facet = np.cross(b - a, c - a)
    assert (np.einsum("fc,fkc->fk", facet, mesh.normals[mesh.faces]) > 0).mean() > 0.999
    assert np.linalg.norm(mesh.normals, axis=1) == pytest.approx(1, abs=1e-9)
    assert np.abs(mesh.vertices[:, :2]).max() == pytest.approx(1)


def crossings(mesh, x, y):
    """How often the line through (x, y) along the view axis meets the mesh."""
    a, b, c = (mesh.vertices[mesh.faces[:, k], :2] - [x, y] for k in range(3))
    sides = [u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0] for u, v in ((a, b), (b, c), (c, a))]
    return int((np.abs(np.sign(sides).sum(axis=0)) == 3).sum())


def test_it_overhangs_itself_and_has_concave_parts():
    mesh = made(2)
    lines = [crossings(mesh, x, y) for x in np.linspace(-0.9, 0.9, 24) for y in np.linspace(-0.9, 0.9, 24)]
    assert all(count % 2 == 0 for count in lines)
    assert np.mean(np.array(lines) >= 4) > 0.05 * np.mean(np.array(lines) > 0)
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=True)
    assert solid.volume < 0.8 * solid.convex_hull.volume


def test_each_hole_goes_through_and_adds_a_handle():
    # Euler's characteristic of a closed surface with g handles is 2 − 2g.
    meshes = [made(3, holes=count) for count in (0, 3)]
    handles = [1 - trimesh.Trimesh(m.vertices, m.faces, process=True).euler_number / 2 for m in meshes]
    assert handles[1] > handles[0]


def test_the_surface_does_not_depend_on_the_grid():
    coarse, fine = (
        trimesh.Trimesh(m.vertices, m.faces, process=True) for m in (made(1, detail=40), made(1, detail=64))
    )
    assert coarse.volume == pytest.approx(fine.volume, rel=0.01)
    assert coarse.area == pytest.approx(fine.area, rel=0.01)


def test_relief_roughens_and_size_thickens():
    turn = []
    for relief in (0.0, 1.0):
        solid = trimesh.Trimesh(*(lambda m: (m.vertices, m.faces))(made(1, relief=relief)), process=True)
        turn.append(np.abs(solid.face_adjacency_angles).mean())
    assert turn[1] > 1.15 * turn[0]
    compact = [
        (lambda s: s.volume / s.bounding_box.volume)(trimesh.Trimesh(m.vertices, m.faces, process=True))
        for m in (made(1, size=0.6), made(1, size=1.5))
    ]
    assert compact[1] > compact[0]


def test_equal_seeds_give_equal_bytes_and_other_seeds_other_solids():
    first, again, other = made(5), made(5), made(6)
    assert first.vertices.tobytes() == again.vertices.tobytes()
    assert first.faces.tobytes() == again.faces.tobytes()
    assert len(first.vertices) != len(other.vertices)


def test_the_triangles_are_those_of_every_machine():
    # The connection of the triangles, which is made from rounded distances, as this version makes it everywhere.
    digest = hashlib.sha256(made(7).faces.astype("<i4").tobytes()).hexdigest()
    assert digest[:16] == "0a86bcc1596b4358"
