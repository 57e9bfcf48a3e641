"""Maps of reflectance: what is read from files, how patterns are distributed, and what is refused."""

import numpy as np
import pytest
import trimesh

from huesphere.configs.errors import InputError
from huesphere.configs.load import load_config
from huesphere.render.albedo import weights_on_faces
from huesphere.scenes.albedo.albedo import srgb_primaries
from huesphere.scenes.build import build_scene
from huesphere.scenes.cameras import sensitivity
from huesphere.scenes.spectra import emission

SQUARE = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
UV = SQUARE[:, :2] / 2 + 0.5
COLOURS = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 255]])


def build(*overrides):
    return build_scene(load_config("sphere_quick", overrides=["camera.resolution=[24,24]", *overrides]))


def write_picture(path, samples):
    import imageio.v3 as imageio

    imageio.imwrite(path, samples)
    return path


@pytest.fixture
def quarters(tmp_path):
    """A picture of 2 × 2 texels: red, green over blue, white."""
    return write_picture(tmp_path / "q.png", COLOURS[[0, 1, 2, 3]].reshape(2, 2, 3).astype(np.uint8))


def obj(folder):
    lines = [f"v {x} {y} {z}" for x, y, z in SQUARE] + [f"vt {u} {v}" for u, v in UV]
    (folder / "m.obj").write_text("\n".join([*lines, "f 1/1 2/2 3/3 4/4"]))
    return folder / "m.obj"


def ply(folder):
    head = ["ply", "format ascii 1.0", "element vertex 4", *(f"property float {n}" for n in "xyzst")]
    head += [f"property uchar {n}" for n in ("red", "green", "blue")]
    head += ["element face 1", "property list uchar int vertex_indices", "end_header"]
    rows = [" ".join(map(str, [*p, *t, *c])) for p, t, c in zip(SQUARE, UV, COLOURS, strict=True)]
    (folder / "m.ply").write_text("\n".join([*head, *rows, "4 0 1 2 3"]))
    return folder / "m.ply"


def glb(folder):
    visual = trimesh.visual.TextureVisuals(uv=UV)
    trimesh.Trimesh(SQUARE, [[0, 1, 2], [0, 2, 3]], visual=visual, process=False).export(folder / "m.glb")
    return folder / "m.glb"


@pytest.mark.parametrize("write", [obj, ply, glb])
def test_texture_coordinates_of_a_file_lay_the_picture_upright(mi, tmp_path, quarters, write):
    scene = build(
        f"shape={{kind: mesh, path: {write(tmp_path)}}}", f"surface={{srgb: {{kind: image, path: {quarters}}}}}"
    )
    assert scene.mesh.uv == pytest.approx(scene.mesh.vertices[:, :2] / 2 + 0.5, abs=1e-6)
    centre = scene.mesh.vertices[scene.mesh.faces].mean(axis=1)
    # The point of each face that is nearest to the middle of a quarter of the square: close to (±0.5, ±0.5).
    for x, y, colour in ((-0.5, 0.5, COLOURS[0]), (0.5, 0.5, COLOURS[1]), (-0.5, -0.5, COLOURS[2])):
        a, b, c = (scene.mesh.vertices[scene.mesh.faces[:, k]][:, :2] for k in range(3))
        shares = np.stack([np.linalg.solve(np.stack([q - p, r - p], 1), [x, y] - p) for p, q, r in zip(a, b, c)])
        face = np.flatnonzero((shares > -1e-9).all(axis=1) & (shares.sum(axis=1) < 1 + 1e-9))[:1]
        found = weights_on_faces(mi, scene, face.astype(np.int32), shares[face].astype(np.float32))
        assert found[0] == pytest.approx(colour / 255, abs=1e-5), (x, y, centre)


def test_colours_of_vertices_are_decoded_and_linear_between_them(mi, tmp_path):
    scene = build(f"shape={{kind: mesh, path: {ply(tmp_path)}}}", "surface={srgb: {kind: vertex_colours}}")
    middle = weights_on_faces(mi, scene, np.array([0], np.int32), np.array([[1 / 3, 1 / 3]], np.float32))[0]
    corners = scene.mesh.vertices[scene.mesh.faces[0]]
    of_corner = [COLOURS[np.abs(SQUARE - p).sum(axis=1).argmin()] / 255 for p in corners]
    assert middle == pytest.approx(np.mean(of_corner, axis=0), abs=1e-6)


def test_a_picture_along_the_axis_covers_the_picture_pixel_by_pixel(mi, tmp_path):
    from huesphere.render.transport import trace

    samples = np.random.default_rng(0).random((24, 24)).astype(np.float32)
    np.save(tmp_path / "a.npy", samples)
    texture = f"surface.texture={{kind: image, path: {tmp_path}/a.npy, mapping: front}}"
    scene = build(texture, "shape={kind: sphere, detail: 24}")
    traced = trace(scene, mi, reach="linear", target_rms=0.1, max_bounces=None, seed=0, progress=lambda *_: None)
    pixels = traced.pixels
    assert pixels.weights[:, 0] == pytest.approx(samples[pixels.row, pixels.col], abs=1e-4)


@pytest.mark.parametrize(
    ("pattern", "mean"),
    [
        ("{kind: noise, size: 0.15}", 0.5),
        ("{kind: stripes, period: 0.2}", 0.5),
        ("{kind: dirt, size: 0.15, cover: 0.3, softness: 0.05}", 0.7),
        ("{kind: cracks, size: 0.3, width: 0.02}", None),
    ],
)
def test_patterns_have_the_share_that_is_asked_for(mi, pattern, mean):
    scene = build(f"surface.texture={pattern}", "shape={kind: sphere, detail: 48}")
    faces = np.arange(len(scene.mesh.faces), dtype=np.int32)
    values = weights_on_faces(mi, scene, faces, np.full((len(faces), 2), 1 / 3, np.float32))[:, 0]
    assert values.min() >= 0
    assert values.max() <= 1 + 1e-6
    if mean is None:
        assert 0.75 < values.mean() < 0.97  # plates with thin cracks
        assert values.min() < 0.05
    else:
        assert values.mean() == pytest.approx(mean, abs=0.06)


def test_srgb_primaries_are_white_together_and_give_the_colour_back():
    # Mallett & Yuksel's property: the three add up to 1, and under D65 linear R, G, B come back (CIE 1931).
    primaries = srgb_primaries()
    assert primaries.sum(axis=0) == pytest.approx(np.ones(primaries.shape[1]), abs=2e-3)
    weighted = sensitivity("CIE 1931") * emission("D65")[:, None]
    xyz = primaries @ weighted / weighted[:, 1].sum()
    to_rgb = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])
    assert xyz @ to_rgb.T == pytest.approx(np.eye(3), abs=0.02)


@pytest.mark.parametrize(
    ("surface", "message"),
    [
        ("{texture: {kind: image, path: missing.png, mapping: front}}", "no such picture"),
        ("{texture: {kind: image, path: PICTURE}}", "a shape without texture coordinates"),
        ("{srgb: {kind: vertex_colours}}", "a shape without colours of vertices"),
        ("{reflectance: 0.8, texture: {kind: noise, range: [0, 2]}}", "surface.texture.range"),
        ("{texture: {kind: noise}, checker: {reflectance: 0.2}}", "exclude each other"),
        ("{reflectance: 0.8, srgb: {kind: image, path: PICTURE, mapping: front}}", "would not be used"),
        ("{mixture: [{reflectance: 0.8}, {reflectance: 0.2}]}", "one reflectance only may be the rest"),
        ("{mixture: [{reflectance: 0.8, weight: 1.5}, {reflectance: 0.2}]}", "0 to 1"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(quarters, surface, message):
    with pytest.raises(InputError, match=message) as caught:
        build(f"surface={surface.replace('PICTURE', str(quarters))}")
    assert "\n" not in str(caught.value)


def test_weights_that_do_not_add_up_end_the_command_with_one_line_and_2(tmp_path, capsys, monkeypatch):
    from huesphere.render.cli import main

    mixture = "[{reflectance: 0.8, weight: 0.5}, {reflectance: 0.2, weight: {kind: noise}}]"
    arguments = ["render", "--config", "sphere_quick", "--out", str(tmp_path / "run"), "--transport", "linear"]
    arguments += ["--set", "camera.resolution=[16,16]", "--set", f"surface={{mixture: {mixture}}}"]
    monkeypatch.setattr("sys.argv", arguments)
    with pytest.raises(SystemExit) as end:
        raise SystemExit(main())
    assert end.value.code == 2
    said = [line for line in capsys.readouterr().err.splitlines() if "add up" in line]
    assert len(said) == 1
