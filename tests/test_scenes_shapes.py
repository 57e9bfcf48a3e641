"""Shapes: normals are the surface's own, faces are outward, files are read right and refused clearly."""

import numpy as np
import pytest

from huesphere.configs.errors import InputError
from huesphere.configs.load import load_config
from huesphere.scenes.build import build_scene
from huesphere.scenes.depth_maps.read import read_depth_map
from huesphere.scenes.meshes.read import read_mesh
from huesphere.scenes.primitives import ball, bowl, ellipsoid, v_groove
from huesphere.scenes.surfaces import DepthGrid, depth_mesh, resample
from huesphere.scenes.texture import paint_faces, paint_vertices


def facet_normals(mesh):
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


SHAPES = {
    "sphere": ball(24),
    "hemisphere": ball(24, part="hemisphere"),
    "octant": ball(24, part="octant"),
    "ellipsoid": ellipsoid((1.0, 0.6, 0.8), (20, 30, 40), 24),
    "v_groove": v_groove(70, 20, 8),
    "bowl": bowl(60, 24),
}


@pytest.mark.parametrize("name", SHAPES)
def test_faces_turn_the_way_their_normals_point(name):
    mesh = SHAPES[name]
    facets = facet_normals(mesh)
    mean = mesh.normals[mesh.faces].sum(axis=1)
    assert (np.einsum("fc,fc->f", facets, mean) > 0).all()
    assert np.abs(np.linalg.norm(mesh.normals, axis=1) - 1).max() < 1e-12


@pytest.mark.parametrize("name", SHAPES)
def test_shape_fits_the_square(name):
    assert np.abs(SHAPES[name].vertices[:, :2]).max() == pytest.approx(1.0)


def test_whole_sphere_is_closed_and_has_its_area():
    import trimesh

    mesh = ball(32)
    closed = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert closed.is_watertight
    assert closed.area == pytest.approx(4 * np.pi, rel=2e-3)
    assert closed.volume == pytest.approx(4 / 3 * np.pi, rel=4e-3)


def test_ellipsoid_normals_are_the_gradient_of_its_equation():
    axes = np.array([1.0, 0.6, 0.8])
    mesh = ellipsoid(tuple(axes), (0, 0, 0), 16)
    gradient = mesh.vertices / axes**2
    gradient /= np.linalg.norm(gradient, axis=1, keepdims=True)
    assert np.abs(gradient - mesh.normals).max() < 1e-12


def test_groove_opens_toward_the_camera_at_its_angle():
    mesh = v_groove(70, 0, 4)
    assert (mesh.normals[:, 2] > 0).all()
    left, right = mesh.normals[0], mesh.normals[-1]
    assert np.degrees(np.arccos(left @ right)) == pytest.approx(180 - 70)


# ---- depth maps ----


def plane_grid(slope_x, slope_y, size=12):
    rows, cols = np.indices((size, size))
    return DepthGrid(slope_x * cols - slope_y * rows + 50.0, np.ones((size, size), bool))


def test_normals_of_a_depth_map_follow_the_declared_frame():
    # z grows to the right and upward: the normal leans left and down.
    mesh, vertex = depth_mesh(plane_grid(0.5, 0.25), 1.0)
    expected = np.array([-0.5, -0.25, 1.0]) / np.linalg.norm([0.5, 0.25, 1.0])
    assert np.abs(mesh.normals - expected).max() < 1e-12
    assert (facet_normals(mesh) @ expected > 0).all()
    assert mesh.vertices[vertex[0, 0], 1] > mesh.vertices[vertex[-1, 0], 1]


def test_resampling_keeps_slopes():
    grid = resample(plane_grid(0.5, 0.25, 32), (64, 64), 2.0)
    mesh, vertex = depth_mesh(grid, 0.5)
    inner = vertex[8:-8, 8:-8].ravel()
    assert np.abs(mesh.normals[inner, 0] / mesh.normals[inner, 2] + 0.5).max() < 1e-3


def test_cells_with_one_missing_corner_keep_one_triangle():
    mask = np.ones((2, 2), bool)
    for corner in range(4):
        broken = mask.copy()
        broken.flat[corner] = False
        mesh, _ = depth_mesh(DepthGrid(np.zeros((2, 2)), broken), 1.0)
        assert len(mesh.faces) == 1
        assert facet_normals(mesh)[0, 2] > 0


def make_depth():
    rows, cols = np.indices((20, 24))
    return 100.0 + 10 * np.sin(rows / 5) + 5 * np.cos(cols / 4)


@pytest.mark.parametrize("suffix", [".npz", ".npy", ".exr", ".txt"])
def test_depth_map_formats_agree(tmp_path, suffix):
    depth = make_depth()
    path = tmp_path / f"z{suffix}"
    if suffix == ".npz":
        np.savez(path, depth=depth)
    elif suffix == ".npy":
        np.save(path, depth)
    elif suffix == ".exr":
        from huesphere.render.exr import write_exr

        write_exr(path, {"depth.Z": depth})
    else:
        np.savetxt(path, depth)
    assert np.abs(read_depth_map(path).depth - depth).max() < 1e-4


def test_sixteen_bit_png_is_read_as_sixteen_bits(tmp_path):
    import imageio.v3 as imageio

    depth = (make_depth() * 300).astype(np.uint16)
    imageio.imwrite(tmp_path / "z.png", depth)
    assert (read_depth_map(tmp_path / "z.png").depth == depth).all()


@pytest.mark.parametrize("content", [b"", b"garbage", b"PK\x03\x04broken", b"\x93NUMPY\x01\x00"])
@pytest.mark.parametrize("suffix", [".npz", ".npy", ".exr", ".png", ".txt"])
def test_damaged_depth_maps_are_one_line(tmp_path, suffix, content):
    path = tmp_path / f"bad{suffix}"
    path.write_bytes(content)
    with pytest.raises(InputError, match=path.name) as caught:
        read_depth_map(path)
    assert "\n" not in str(caught.value)


def test_pickled_arrays_are_refused(tmp_path):
    np.save(tmp_path / "z.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(InputError):
        read_depth_map(tmp_path / "z.npy")


# ---- meshes ----


def test_a_cube_keeps_its_creases(tmp_path):
    import trimesh

    trimesh.creation.box((1, 1, 1)).export(tmp_path / "cube.ply")
    mesh = read_mesh(tmp_path / "cube.ply", rotation_deg=(0, 0, 0), smooth_deg=40)
    assert len(mesh.vertices) == 24  # three normals at each of eight corners
    assert np.abs(np.abs(mesh.normals).max(axis=1) - 1).max() < 1e-9


def test_a_fine_sphere_is_smooth(tmp_path):
    import trimesh

    trimesh.creation.icosphere(3).export(tmp_path / "ball.stl")
    mesh = read_mesh(tmp_path / "ball.stl", rotation_deg=(0, 0, 0), smooth_deg=40)
    direction = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    assert np.degrees(np.arccos(np.clip(np.einsum("vc,vc->v", direction, mesh.normals), -1, 1))).max() < 2


@pytest.mark.parametrize("content", ["", "solid x\nendsolid x\n", "ply\nformat ascii 1.0\nelement vertex 9\n"])
@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl", ".glb"])
def test_damaged_meshes_are_one_line(tmp_path, suffix, content):
    path = tmp_path / f"bad{suffix}"
    path.write_text(content)
    with pytest.raises(InputError):
        read_mesh(path, rotation_deg=(0, 0, 0), smooth_deg=40)


def test_background_is_black_and_no_part_of_the_object():
    config = load_config("sphere_quick", overrides=["shape={kind: octant, background: true, detail: 16}"])
    scene = build_scene(config)
    assert scene.reflectances[1].max() == 0
    assert list(scene.is_object) == [True, False]


# ---- two reflectances ----------------------------------------------------------------------------------------------


def areas(mesh):
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def test_paint_around_vertices_cuts_faces_in_their_planes_and_gives_each_corner_its_third():
    whole = ball(10)
    painted = paint_vertices(whole, 0.4, material=1)
    assert np.array_equal(painted.vertices[: len(whole.vertices)], whole.vertices)
    assert areas(painted).sum() == pytest.approx(areas(whole).sum(), rel=1e-12)
    cells = np.floor(whole.vertices / 0.4).astype(int).sum(axis=1) % 2 == 1
    share = np.zeros(len(whole.vertices))
    np.add.at(share, whole.faces.ravel(), np.repeat(areas(whole) / 3, 3))
    assert areas(painted)[painted.material == 1].sum() == pytest.approx(share[cells].sum(), rel=1e-12)
    corner = painted.faces[(painted.faces < len(whole.vertices)).sum(axis=1) == 1]  # pieces of cut faces
    assert len(corner) > 100
    normals = np.cross(*(painted.vertices[painted.faces[:, k]] - painted.vertices[painted.faces[:, 0]] for k in (1, 2)))
    outward = np.einsum("fc,fc->f", normals, painted.vertices[painted.faces].mean(axis=1))
    assert outward.min() > 0


def test_paint_by_face_keeps_the_mesh():
    whole = ball(10)
    painted = paint_faces(whole, 0.4, material=1)
    assert painted.faces is whole.faces
    assert 0.3 < areas(painted)[painted.material == 1].sum() / areas(whole).sum() < 0.7


def test_a_pixel_of_a_depth_map_has_the_reflectance_of_its_own_vertex(tmp_path):
    y, x = np.mgrid[-8:8, -8:8]
    np.save(tmp_path / "z.npy", -0.05 * (x**2 + y**2))
    change = "surface={reflectance: 0.8, checker: {reflectance: 0.2, size: 0.3, by: vertex}}"
    changes = ["camera.resolution=[16,16]", change]
    scene = build_scene(load_config("sphere_quick", shape=str(tmp_path / "z.npy"), overrides=changes))
    material = np.full(len(scene.mesh.vertices), -1)
    for k in range(3):
        material[scene.mesh.faces[:, k]] = scene.mesh.material
    at = scene.pixel_vertex[scene.pixel_vertex >= 0]
    odd = np.floor(scene.mesh.vertices[at] / 0.3).astype(int).sum(axis=1) % 2
    assert np.array_equal(material[at], odd)
    assert 0 < odd.mean() < 1


@pytest.mark.parametrize("scale", [1e-30, 1e-9, 1e9, 1e30])
def test_a_mesh_has_the_same_shape_at_any_size(tmp_path, scale):
    import trimesh

    ball_file = trimesh.creation.icosphere(subdivisions=2)
    meshes = []
    for size in (1.0, scale):
        # Every corner on its own, as STL files have it: what is to be merged must be merged at any size.
        rows = (size * ball_file.vertices[ball_file.faces]).reshape(-1, 3)
        corners = [f"v {x:.17g} {y:.17g} {z:.17g}" for x, y, z in rows]
        faces = [f"f {n} {n + 1} {n + 2}" for n in range(1, len(corners), 3)]
        (tmp_path / "ball.obj").write_text("\n".join(corners + faces))
        meshes.append(read_mesh(tmp_path / "ball.obj", rotation_deg=(0, 0, 0), smooth_deg=180))
    one, other = meshes
    assert len(one.vertices) == len(other.vertices) == len(ball_file.vertices)
    # The same vertices, in whatever order: on the unit sphere, with their own position as the normal.
    for mesh in meshes:
        radius = np.linalg.norm(mesh.vertices, axis=1)
        assert np.ptp(radius) < 1e-6 * radius.mean()
        assert np.einsum("ij,ij->i", mesh.vertices / radius[:, None], mesh.normals).min() > 0.99
