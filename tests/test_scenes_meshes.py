"""Meshes from files keep their shape: polygons, winding, doubled faces; formats that are offered are read."""

import importlib.util
import json
import struct

import numpy as np
import pytest
import trimesh

from huesphere.configs.errors import InputError
from huesphere.configs.load import MESH_SUFFIXES
from huesphere.scenes.meshes import read as reading
from huesphere.scenes.meshes.orientation import oriented, parts_of
from huesphere.scenes.meshes.ply import read_ply, strip_triangles
from huesphere.scenes.meshes.polygons import Polygons, triangulated
from huesphere.scenes.meshes.read import read_mesh
from huesphere.scenes.meshes.sides import parts_in_space, with_second_side
from huesphere.scenes.surfaces import split_creases

BOX = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], float)
BOX_QUADS = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]  # outward
BALL = trimesh.creation.icosphere(subdivisions=2)


def read(path, smooth=1.0):
    lines: list[str] = []
    mesh = read_mesh(path, rotation_deg=(0, 0, 0), smooth_deg=smooth, log=lines.append)
    return mesh, " ".join(lines)


def solid(mesh):
    """``mesh`` as a trimesh with one vertex at each place."""
    joined = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    joined.merge_vertices()
    return joined


def write_obj(path, vertices, faces):
    rows = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices]
    path.write_text("\n".join([*rows, *("f " + " ".join(str(i + 1) for i in face) for face in faces)]) + "\n")
    return path


def prism(outline):
    """(vertices, faces) of a prism of height 1 over an ``outline`` (n, 2), with two polygons of n corners."""
    n = len(outline)
    vertices = np.concatenate([np.c_[outline, np.full(n, z)] for z in (0.0, 1.0)])
    sides = [[i, (i + 1) % n, n + (i + 1) % n, n + i] for i in range(n)]
    return vertices, [list(range(n))[::-1], list(range(n, 2 * n)), *sides]


def area(outline):
    following = np.roll(outline, -1, axis=0)
    return (outline[:, 0] * following[:, 1] - outline[:, 1] * following[:, 0]).sum() / 2


def star(n):
    angle = np.linspace(0, 2 * np.pi, 2 * n, endpoint=False)
    return np.where(np.arange(2 * n) % 2, 0.35, 1.0)[:, None] * np.c_[np.cos(angle), np.sin(angle)]


COMB = np.array([[0, 0], [7, 0], [7, 3], [6, 3], [6, 1], [5, 1], [5, 3], [4, 3], [4, 1], [1, 1], [1, 3], [0, 3]], float)
OUTLINES = {"L": np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]], float), "star": star(7), "comb": COMB}


# ---- polygons ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".obj", ".off", ".ply"])
@pytest.mark.parametrize("name", OUTLINES)
@pytest.mark.parametrize("first", [0, 1, 3])
def test_polygons_with_reentrant_corners_keep_their_area(tmp_path, name, first, suffix):
    outline = np.roll(OUTLINES[name], first, axis=0)
    vertices, faces = prism(outline)
    path = tmp_path / f"p{suffix}"
    if suffix == ".obj":
        write_obj(path, vertices, faces)
    else:
        points = "\n".join(f"{x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices)
        rings = "\n".join(f"{len(face)} " + " ".join(map(str, face)) for face in faces)
        head = f"OFF\n{len(vertices)} {len(faces)} 0\n"
        if suffix == ".ply":
            head = f"ply\nformat ascii 1.0\ncomment x\nelement vertex {len(vertices)}\n"
            head += "property float x\nproperty float y\nproperty float z\n"
            head += f"element face {len(faces)}\nproperty list uchar int vertex_index\nend_header\n"
        path.write_text(head + points + "\n" + rings + "\n")
    mesh, said = read(path)
    whole = solid(mesh)
    scale = 2 / np.ptp(outline, axis=0).max()
    assert whole.is_watertight
    assert whole.volume == pytest.approx(area(outline) * scale**3, rel=1e-5)
    assert "2 polygons with reentrant corners" in said


@pytest.mark.parametrize("first", range(4))
def test_a_quad_with_a_reentrant_corner_is_cut_at_it(first):
    dart = np.roll([[0, 0], [2, 1], [0, 2], [0.7, 1]], first, axis=0)
    polygons = Polygons(np.c_[dart, np.ones(4)], np.arange(4), np.array([4]))
    triangles, reentrant = triangulated(polygons, "x")
    a, b, c = (polygons.vertices[triangles[:, k]] for k in range(3))
    areas = np.cross(b - a, c - a)[:, 2] / 2
    assert reentrant == 1
    assert (areas > 0).all()
    assert areas.sum() == pytest.approx(area(dart))


@pytest.mark.parametrize("seed", range(20))
def test_any_polygon_without_crossings_keeps_its_area_in_space(seed):
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.random(30)) * 2 * np.pi
    outline = rng.uniform(0.1, 1, 30)[:, None] * np.c_[np.cos(angle), np.sin(angle)]  # star-shaped about the origin
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    polygons = Polygons(np.c_[outline, np.zeros(30)] @ turn.T, np.arange(30), np.array([30]))
    triangles, _ = triangulated(polygons, "x")
    a, b, c = (polygons.vertices[triangles[:, k]] for k in range(3))
    areas = np.cross(b - a, c - a) / 2
    assert np.linalg.norm(areas, axis=1).sum() == pytest.approx(abs(area(outline)), rel=1e-9)


def test_a_polygon_with_too_many_corners_is_refused(monkeypatch):
    monkeypatch.setattr("huesphere.scenes.meshes.polygons.MOST_CORNERS", 5)
    with pytest.raises(InputError, match="6 corners"):
        triangulated(Polygons(np.random.default_rng(0).random((6, 3)), np.arange(6), np.array([6])), "x")


# ---- the formats ---------------------------------------------------------------------------------------------------


def test_obj_counts_backwards_from_the_line(tmp_path):
    lines = []
    for shift in (0, 3):  # two boxes, each with faces that count from their own line
        lines += [f"v {x + shift} {y} {z}" for x, y, z in BOX] + ["o box"]
        lines += ["f " + " ".join(f"{i - 8}//{i - 8}" for i in quad) for quad in BOX_QUADS[:3]]
        lines += ["v 9 9 9", "vt 0 0", "# a comment"]  # a vertex that nothing uses
        lines += ["f " + " \\\n ".join(str(i - 9) for i in quad) for quad in BOX_QUADS[3:]]
    (tmp_path / "two.obj").write_text("\n".join(lines))
    mesh, said = read(tmp_path / "two.obj")
    whole = solid(mesh)
    assert said == ""
    assert whole.is_watertight
    assert len(whole.faces) == 24
    assert whole.volume == pytest.approx(2 * (2 / 4) ** 3)


@pytest.mark.parametrize("line", ["f 1 2 99", "f 0 1 2", "f -1 -2 -99", "f 1 2 x", "v 1 2"])
def test_obj_lines_that_cannot_be_meant_are_refused(tmp_path, line):
    write_obj(tmp_path / "bad.obj", BOX, BOX_QUADS)
    with (tmp_path / "bad.obj").open("a") as file:
        file.write(line + "\n")
    with pytest.raises(InputError, match=r"bad\.obj"):
        read(tmp_path / "bad.obj")


@pytest.mark.parametrize("order", ["<", ">"])
def test_binary_ply_with_triangles_and_quads_is_read(tmp_path, order):
    faces = [*BOX_QUADS[:5], BOX_QUADS[5][:3], [BOX_QUADS[5][k] for k in (0, 2, 3)]]
    name = {"<": "little", ">": "big"}[order]
    head = f"ply\nformat binary_{name}_endian 1.0\nelement vertex 8\n"
    head += "property double x\nproperty double y\nproperty double z\n"
    head += f"property uchar red\nelement face {len(faces)}\nproperty float quality\n"
    head += "property list uchar uint vertex_indices\nend_header\n"
    body = b"".join(struct.pack(f"{order}dddB", *point, 7) for point in BOX)
    body += b"".join(struct.pack(f"{order}fB{len(face)}I", 0.5, len(face), *face) for face in faces)
    (tmp_path / "box.ply").write_bytes(head.encode() + body)
    whole = solid(read(tmp_path / "box.ply")[0])
    assert whole.is_watertight
    assert whole.volume == pytest.approx(8)
    (tmp_path / "cut.ply").write_bytes(head.encode() + body[:-3])
    with pytest.raises(InputError, match=r"cut\.ply"):
        read(tmp_path / "cut.ply")


def test_triangle_strips_turn_every_other_triangle_and_end_at_minus_one():
    strip = np.array([0, 1, 2, 3, -1, 4, 5, 6, 7, 8, 9, 10])
    found = strip_triangles(strip, np.array([9, 3]))
    assert found.tolist() == [[0, 1, 2], [2, 1, 3], [4, 5, 6], [6, 5, 7], [8, 9, 10]]


def test_strips_of_a_ply_make_the_surface(tmp_path):
    rows, cols = 5, 6
    points = [(x, y, 0.1 * x * y) for y in range(rows) for x in range(cols)]
    strips: list[int] = []
    for r in range(rows - 1):
        strips += [v for c in range(cols) for v in (r * cols + c, (r + 1) * cols + c)] + [-1]
    head = (
        f"ply\nformat ascii 1.0\nelement vertex {len(points)}\nproperty float x\nproperty float y\nproperty float z\n"
    )
    head += "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    text = "\n".join(" ".join(map(str, p)) for p in points) + f"\n{len(strips)} {' '.join(map(str, strips))}\n"
    (tmp_path / "s.ply").write_text(head + text)
    assert read_ply(tmp_path / "s.ply").counts.tolist() == [3] * 2 * (rows - 1) * (cols - 1)
    mesh, said = read(tmp_path / "s.ply")
    assert "turned" not in said
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    assert len(set(np.sign(np.cross(b - a, c - a)[:, 2]))) == 1


@pytest.mark.parametrize("suffix", MESH_SUFFIXES)
def test_every_ending_that_is_offered_is_read(tmp_path, suffix):
    path = tmp_path / f"ball{suffix}"
    if suffix == ".gltf":
        for name, data in trimesh.exchange.gltf.export_gltf(trimesh.Scene(BALL)).items():
            (tmp_path / name).write_bytes(data)
        path = tmp_path / "model.gltf"
    else:
        BALL.export(path)
    mesh, said = read(path)
    assert said == ""
    assert solid(mesh).volume == pytest.approx(BALL.volume, rel=1e-3)


@pytest.mark.parametrize("suffix", [".3mf", ".dae"])
def test_a_missing_package_is_named_with_the_command_that_brings_it(tmp_path, suffix, monkeypatch):
    monkeypatch.setattr(reading, "find_spec", lambda name: None)
    (tmp_path / f"m{suffix}").write_bytes(b"PK")
    with pytest.raises(InputError, match=r"pip install 'huesphere\[meshes\]'"):
        read(tmp_path / f"m{suffix}")


@pytest.mark.parametrize("change", [{"mode": 6}, {"extension": "KHR_draco_mesh_compression"}])
def test_gltf_of_which_a_part_would_be_left_out_is_refused(tmp_path, change):
    files = trimesh.exchange.gltf.export_gltf(trimesh.Scene(BALL))
    document = json.loads(files.pop("model.gltf"))
    if "mode" in change:
        document["meshes"][0]["primitives"][0]["mode"] = change["mode"]
    else:
        document["extensionsRequired"] = [change["extension"]]
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
    (tmp_path / "m.gltf").write_text(json.dumps(document))
    with pytest.raises(InputError, match="not read"):
        read(tmp_path / "m.gltf")


# ---- winding and doubled faces -------------------------------------------------------------------------------------


def changed_ball(kind):
    faces = np.array(BALL.faces)
    rng = np.random.default_rng(3)
    if kind == "two sides":
        return np.concatenate([faces, faces[:, ::-1]])
    if kind == "twice the same":
        return np.concatenate([faces, np.roll(faces, 1, axis=1)])
    share = {"a few": 0.05, "half": 0.5, "most": 0.9, "all": 1.0}[kind]
    turned = rng.random(len(faces)) < share
    return np.where(turned[:, None], faces[:, ::-1], faces)


@pytest.mark.parametrize("kind", ["two sides", "twice the same", "a few", "half", "most", "all"])
def test_a_ball_is_a_ball_however_its_faces_are_wound(tmp_path, kind):
    whole, _ = read(write_obj(tmp_path / "good.obj", BALL.vertices, BALL.faces), smooth=40)
    mesh, said = read(write_obj(tmp_path / "bad.obj", BALL.vertices, changed_ball(kind)), smooth=40)
    assert np.array_equal(mesh.faces.shape, whole.faces.shape)
    assert solid(mesh).volume == pytest.approx(solid(whole).volume)
    out = np.einsum("vc,vc->v", mesh.normals, mesh.vertices)
    assert out.min() > 0.95
    assert ("left out" if kind in ("two sides", "twice the same") else "were turned") in said


def test_each_part_is_turned_by_itself():
    far = np.array(BALL.vertices) + np.array([3, 0, 0])
    vertices = np.concatenate([BALL.vertices, far])
    faces = np.concatenate([BALL.faces, np.array(BALL.faces)[:, ::-1] + len(far)])
    turned, count = oriented(vertices, faces)
    assert count == len(BALL.faces)
    assert np.array_equal(turned[: len(BALL.faces)], BALL.faces)


def test_the_wall_of_a_cavity_stays_inward():
    inner = np.array(BALL.vertices) / 2
    vertices = np.concatenate([BALL.vertices, inner])
    faces = np.concatenate([BALL.faces, np.array(BALL.faces)[:, ::-1] + len(inner)])
    assert oriented(vertices, faces)[1] == 0


def test_an_open_part_keeps_the_side_of_most_of_its_faces():
    upper = np.array(BALL.faces)[(BALL.triangles_center[:, 1] > 0)]
    turned = upper.copy()
    turned[:7] = turned[:7, ::-1]
    found, count = oriented(np.array(BALL.vertices), turned)
    assert count == 7
    assert np.array_equal(np.sort(found, axis=1), np.sort(upper, axis=1))
    inward, none = oriented(np.array(BALL.vertices), upper[:, ::-1])  # a bowl seen from within may be wound so
    assert none == 0
    assert np.array_equal(inward, upper[:, ::-1])


def test_a_moebius_strip_is_left_as_it_is():
    n = 12
    faces = np.array([f for i in range(n) for f in ([2 * i, 2 * i + 1, 2 * i + 2], [2 * i + 1, 2 * i + 3, 2 * i + 2])])
    faces = np.where(faces == 2 * n, 1, np.where(faces == 2 * n + 1, 0, faces))
    parts = parts_of(faces)
    assert parts.count == 1
    assert not parts.orientable[0]
    assert oriented(np.random.default_rng(0).random((2 * n, 3)), faces)[1] == 0


def test_the_second_side_lies_closely_behind_the_first_without_gaps():
    open_box = np.array([[a, b, c] for q in BOX_QUADS[1:] for a, b, c in ((q[0], q[1], q[2]), (q[0], q[2], q[3]))])
    mesh = split_creases(BOX, open_box, 10)
    parts, place = parts_in_space(mesh)
    assert parts.count == 1
    assert not parts.closed[0]
    both = with_second_side(mesh, np.ones(len(mesh.faces), bool), place, 0.01)
    back = both.vertices[len(mesh.vertices) :]
    assert len(both.faces) == 2 * len(mesh.faces)
    assert np.allclose(np.linalg.norm(back - mesh.vertices, axis=1), 0.01)
    assert len(np.unique(back.round(9), axis=0)) == len(np.unique(mesh.vertices, axis=0))  # still joined at creases
    a, b, c = (both.vertices[both.faces[:, k]] for k in range(3))
    outward = np.einsum("fc,fc->f", np.cross(b - a, c - a), both.normals[both.faces[:, 0]])
    assert (outward > 0).all()


def test_packages_of_the_extra_are_those_that_are_looked_for():
    assert all(importlib.util.find_spec(module) for needed in reading.NEEDS.values() for module in needed)


@pytest.mark.parametrize("inside", ["", "<scene/>", '<scene><instance_visual_scene url="#S"/></scene>'])
def test_a_collada_file_without_a_scene_is_refused_in_words(tmp_path, inside):
    collada = pytest.importorskip("collada", reason="no pycollada: pip install 'huesphere[meshes]'")
    path = tmp_path / "empty.dae"
    collada.Collada().write(str(path))
    path.write_text(path.read_text().replace("</COLLADA>", f"{inside}</COLLADA>"))
    with pytest.raises(InputError, match=r"without a mesh that can be found in it|a mesh without triangles") as raised:
        read(path)
    assert "Error" not in str(raised.value)
