"""Reflectance that varies: laws of one reflectance that still hold, relighting, and the stock path tracer."""

from dataclasses import replace

import imageio.v3 as imageio
import numpy as np
import pytest
import trimesh
from scipy import ndimage
from stock import require_equal_to_stock

from huesphere.configs.errors import InputError
from huesphere.configs.load import load_config
from huesphere.render import open_item, relight
from huesphere.render.dataset import read_observation, read_truth
from huesphere.render.layers import read_layers
from huesphere.render.picture import assemble
from huesphere.render.run import render_config
from huesphere.render.transport import trace
from huesphere.scenes.build import build_scene

BOWL = "shape={kind: bowl, opening: 75, detail: 16}"
TWO_LIGHTS = "lights=[{direction: [0.3,0.2,1], spectrum: FL2}, {direction: [-0.3,0.2,1], spectrum: A}]"
SMOOTH = "{kind: noise, size: 0.8, octaves: 1}"


def build(*overrides):
    return build_scene(load_config("sphere_quick", overrides=["camera.resolution=[24,24]", TWO_LIGHTS, *overrides]))


def picture(mi, scene, target=1e-2, transport="full"):
    traced = trace(scene, mi, reach=transport, target_rms=target, max_bounces=None, seed=0, progress=lambda *_: None)
    return assemble(scene, traced, transport, mi).colour[traced.pixels.row, traced.pixels.col]


def relative_rms(one, other):
    return np.sqrt(np.mean((one - other) ** 2)) / other.mean()


ROOM = "room={left: 0.5, right: 0.6, width: 5, height: 5, detail: 2}"


@pytest.mark.parametrize(
    ("varying", "plain", "more"),
    [
        ("{reflectance: 0.8, texture: {kind: noise, range: [0.5, 0.5]}}", "{reflectance: 0.4}", [BOWL]),
        ("{mixture: [{reflectance: 0.8, weight: 0.25}, {reflectance: 0.4}]}", "{reflectance: 0.5}", [BOWL]),
        pytest.param(
            "{reflectance: 0.8, texture: {kind: noise, range: [0.5, 0.5]}}",
            "{reflectance: 0.4}",
            [ROOM, "shape={kind: sphere, detail: 8}", "lights=[{kind: point, position: [0, 1.5, 1.5]}]"],
            marks=pytest.mark.slow,
        ),
    ],
    ids=["brightness", "constant weights", "in a room"],
)
def test_a_map_of_equal_values_is_the_uniform_surface(mi, varying, plain, more):
    pictures = [picture(mi, build(f"surface={surface}", *more)) for surface in (varying, plain)]
    assert relative_rms(*pictures) < 1.5e-2
    assert pictures[0].mean(axis=0) == pytest.approx(pictures[1].mean(axis=0), rel=2e-3)


@pytest.mark.slow
def test_a_chess_board_of_weights_is_the_chess_board_of_materials(mi, tmp_path):
    # Fields of a chess board in x alone, by the material of whole faces and by a picture with sharp edges.
    board = np.kron(np.array([[1, 0, 1, 0]]), np.ones((1, 64))).astype(np.float32)
    np.save(tmp_path / "b.npy", board)
    weight = f"{{kind: image, path: {tmp_path}/b.npy, mapping: front}}"
    shape = ["shape={kind: v_groove, angle: 90, detail: 32}", "camera.view_height=2"]
    mixed = build(
        f"surface={{mixture: [{{reflectance: orange, weight: {weight}}}, {{reflectance: blue sky}}]}}", *shape
    )
    checked = build("surface={reflectance: orange, checker: {reflectance: blue sky, size: 0.5}}", *shape)
    material = (np.floor(checked.mesh.vertices[checked.mesh.faces].mean(axis=1)[:, 0] / 0.5).astype(int) % 2).astype(
        np.int32
    )
    checked = replace(checked, mesh=replace(checked.mesh, material=material))
    ours, theirs = picture(mi, mixed), picture(mi, checked)
    assert relative_rms(ours, theirs) < 0.02  # the picture's edges are a texel wide
    assert ours.mean(axis=0) == pytest.approx(theirs.mean(axis=0), rel=3e-3)


@pytest.mark.slow
def test_a_relief_by_profiles_is_that_by_rays(mi, tmp_path):
    rows, cols = np.indices((24, 24)) / 24 - 0.5
    np.save(tmp_path / "z.npy", 4 * np.cos(9 * rows) * np.cos(9 * cols))
    texture = "{kind: noise, size: 0.5, octaves: 1}"
    shape = f"shape={{kind: depth_map, path: {tmp_path}/z.npy}}"
    relief = build(shape, f"surface={{reflectance: 0.8, texture: {texture}}}")
    rays = build(shape, f"surface={{mixture: [{{reflectance: 0.8, weight: {texture}}}, {{reflectance: 0.0}}]}}")
    ours, theirs = picture(mi, relief), picture(mi, rays)
    assert relative_rms(ours, theirs) < 2e-2  # two traces to 1e-2 each
    assert ours.mean(axis=0) == pytest.approx(theirs.mean(axis=0), rel=4e-3)


@pytest.mark.slow
def test_what_light_the_surface_sends_to_the_camera_is_what_it_would_send_back(mi, tmp_path):
    # Helmholtz: the flux toward v under light from l is that toward l under light from v, all bounces included.
    bowl = build(BOWL).mesh
    shade = (128 + 100 * np.sin(4 * bowl.vertices[:, 0])).astype(np.uint8)
    colours = np.stack([shade, shade, shade, np.full_like(shade, 255)], axis=1)
    trimesh.Trimesh(bowl.vertices, bowl.faces, vertex_colors=colours, process=False).export(tmp_path / "bowl.ply")
    turn, flux = 35.0, []
    toward = [np.sin(np.radians(turn)), 0.0, np.cos(np.radians(turn))]
    for rotation, direction in ((0.0, toward), (-turn, [-toward[0], 0.0, toward[2]])):
        scene = build(
            f"shape={{kind: mesh, path: {tmp_path}/bowl.ply, rotation: [0, {rotation}, 0]}}",
            "surface={reflectance: 0.9, texture: {kind: vertex_colours}}",
            f"lights=[{{direction: {direction}, spectrum: E}}]",
            "camera.resolution=[96,96]",
            "camera.pixel=area",
        )
        a, b, c = (scene.mesh.vertices[scene.mesh.faces[:, k]] for k in range(3))
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
        flux.append(picture(mi, scene, 1e-2).sum(axis=0) * scene.view.pixel_size**2 / area)
    assert flux[0] == pytest.approx(flux[1], rel=1e-2)


def test_darker_spots_leave_less_light_everywhere(mi):
    white = picture(mi, build(BOWL, "surface.reflectance=1.0"))
    spotted = picture(mi, build(BOWL, f"surface={{reflectance: 1.0, texture: {SMOOTH}}}"))
    assert (spotted < white * 1.02).all()
    assert spotted.mean() < 0.8 * white.mean()


# ---- files ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def items(tmp_path_factory):
    """A folder with items of a surface of varying brightness and of a mixture, at three levels of transport."""
    run = tmp_path_factory.mktemp("run")
    mixture = f"{{mixture: [{{reflectance: orange, weight: {SMOOTH}}}, {{reflectance: blue sky}}]}}"
    for name, surface in (("bright", f"{{reflectance: 0.7, texture: {SMOOTH}}}"), ("mixed", mixture)):
        render(run, f"name={name}", f"surface={surface}")
    return run


def render(run, *overrides):
    common = ["camera.resolution=[24,24]", TWO_LIGHTS, BOWL, "render.target_rms=0.01", "camera.exposure=1"]
    config = load_config("sphere_quick", overrides=[*common, "render.transport=[direct,one-bounce,full]", *overrides])
    render_config(config, run, engine="auto", overwrite=False, progress=lambda *_: None, log=lambda _: None)
    return run


@pytest.mark.parametrize("name", ["bright", "mixed"])
def test_layers_add_to_the_picture_and_relighting_without_changes_gives_it(items, name):
    for transport in ("direct", "one-bounce", "full"):
        folder = items / name / transport
        seen = read_observation(folder / "observation.exr").rgb
        assert np.abs(read_layers(folder / "layers.exr").picture() - seen).max() < 1e-6 * seen.max()
        assert np.abs(relight(folder).rgb - seen).max() < 1e-5 * seen.max()


@pytest.mark.parametrize(
    ("item", "change"),
    [
        ("bright/full", "lights.0.spectrum=D65"),
        ("bright/full", "surface.reflectance=orange"),
        ("mixed/full", "lights.1.intensity=0.2"),
        ("mixed/one-bounce", "surface.mixture.1.reflectance=red"),
    ],
)
def test_relighting_is_what_a_new_trace_gives(items, tmp_path, item, change):
    mixture = f"{{mixture: [{{reflectance: orange, weight: {SMOOTH}}}, {{reflectance: blue sky}}]}}"
    surface = f"{{reflectance: 0.7, texture: {SMOOTH}}}" if item.startswith("bright") else mixture
    name, transport = item.split("/")
    folder = render(tmp_path, f"name={name}", f"surface={surface}", change) / name / transport
    traced = read_observation(folder / "observation.exr").rgb
    assert (
        relative_rms(relight(open_item(items / item), [change]).rgb, traced) < 2e-2
    )  # two traces to 1e-2 each, of other rays


def test_what_would_bounce_otherwise_is_refused(items):
    with pytest.raises(InputError, match="cannot change without tracing again"):
        relight(items / "mixed/full", ["surface.mixture.0.reflectance=red"])
    with pytest.raises(InputError, match="cannot change without tracing again"):
        relight(items / "bright/full", ["surface.texture.seed=3"])


def test_truth_has_weights_and_the_albedo_that_the_camera_sees(items):
    truth = read_truth(items / "mixed/full/truth.exr")
    weights = [truth.extra[f"weight.{m}"][truth.mask] for m in (0, 1)]
    assert sum(weights) == pytest.approx(np.ones(truth.mask.sum()), abs=1e-6)
    scene = build(f"surface={{mixture: [{{reflectance: orange, weight: {SMOOTH}}}, {{reflectance: blue sky}}]}}")
    white = scene.sensitivity.sum(axis=0)
    expected = sum(
        w[:, None] * (s @ scene.sensitivity / white) for w, s in zip(weights, scene.reflectances, strict=True)
    )
    albedo = np.stack([truth.extra[f"albedo.{c}"][truth.mask] for c in "RGB"], axis=1)
    assert albedo == pytest.approx(expected, abs=1e-5)
    assert np.isnan(truth.extra["albedo.R"][~truth.mask]).all()


# ---- stock ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A soft picture of colours, and a mesh with texture coordinates and colours of vertices."""
    folder = tmp_path_factory.mktemp("files")
    random = ndimage.gaussian_filter(np.random.default_rng(0).random((32, 32, 3)), (2.5, 2.5, 0), mode="wrap")
    imageio.imwrite(folder / "soft.png", (255 * (random - random.min()) / np.ptp(random)).astype(np.uint8))
    mesh = build(BOWL).mesh
    x, y = mesh.vertices[:, :2].T
    colours = 0.5 + 0.45 * np.stack([np.sin(3 * x), np.cos(2 * y), np.sin(2 * x + y)], axis=1)
    head = ["ply", "format ascii 1.0", f"element vertex {len(x)}", *(f"property float {n}" for n in "xyzst")]
    head += [f"property float {n}" for n in ("red", "green", "blue")]
    head += [f"element face {len(mesh.faces)}", "property list uchar int vertex_indices", "end_header"]
    table = np.concatenate([mesh.vertices, 0.3 + 0.5 * np.stack([y, x], axis=1), colours], axis=1)
    rows = [" ".join(f"{v:.7g}" for v in row) for row in table] + [f"3 {a} {b} {c}" for a, b, c in mesh.faces]
    (folder / "bowl.ply").write_text("\n".join([*head, *rows]))
    return folder


STOCK = {
    "noise": [BOWL, f"surface={{reflectance: 0.9, texture: {SMOOTH}}}"],
    "cracks": [BOWL, "surface={reflectance: 0.9, texture: {kind: cracks, size: 0.9, width: 0.5, range: [0.2, 1]}}"],
    "mixture": [
        BOWL,
        f"surface={{mixture: [{{reflectance: orange}}, {{reflectance: blue sky, weight: {SMOOTH}}}]}}",
    ],
    "picture by coordinates": [
        "shape={kind: mesh, path: FILES/bowl.ply}",
        "surface={srgb: {kind: image, path: FILES/soft.png}}",
    ],
    "colours of vertices, sky": [
        "shape={kind: mesh, path: FILES/bowl.ply}",
        "surface={srgb: {kind: vertex_colours}}",
        "lights=[{kind: sky, up: [0.3,1,0.2], zenith: {daylight: 15000}, horizon: FL2, ground: A}]",
    ],
    "room": [
        "shape={kind: sphere, detail: 48}",
        f"surface={{reflectance: 0.9, texture: {SMOOTH}}}",
        "room={left: red, right: green, ceiling: white 9.5 (.05 D), floor: blue, width: 5, height: 5, detail: 16}",
        "lights=[{kind: point, position: [0,1.5,1.5], spectrum: D65}]",
    ],
}


@pytest.mark.slow
@pytest.mark.parametrize("name", STOCK)
def test_equal_to_the_stock_path_tracer_within_its_noise(mi, files, name):
    scene = build("camera.pixel=area", *(line.replace("FILES", str(files)) for line in STOCK[name]))
    require_equal_to_stock(mi, scene, "full", samples=96, margin=2)
