"""What the camera sees is surface and is lit, or a line says why: backs of sheets, lights that miss, empty views."""

import numpy as np
import pytest
import trimesh

from huesphere.configs.errors import InputError
from huesphere.configs.load import load_configs
from huesphere.render.dataset import read_observation, read_truth
from huesphere.render.run import render_configs

FRONT = "lights=[{direction: [0.2, 0.1, 1]}]"


def render(folder, *changes, shape=None):
    """(picture, truth, log) of a small scene rendered into ``folder``."""
    lines: list[str] = []
    settings = ["camera.resolution=[32,32]", "render.transport=[linear]", "name=x", *changes]
    configs = load_configs("sphere_quick", overrides=settings, shape=None if shape is None else str(shape))
    (item, *_) = render_configs(configs, folder, progress=lambda share, what: None, log=lines.append)
    return (
        read_observation(folder / item / "observation.exr"),
        read_truth(folder / item / "truth.exr"),
        "\n".join(lines),
    )


# ---- both sides of surfaces ----------------------------------------------------------------------------------------


def vase(tmp_path):
    """A tube open at both ends, tilted toward the camera: its inside is seen through the mouth."""
    tube = trimesh.creation.cylinder(radius=0.6, height=2, sections=64)
    cut = trimesh.Trimesh(tube.vertices, np.array(tube.faces)[np.abs(tube.face_normals[:, 2]) < 0.5], process=True)
    cut.apply_transform(trimesh.transformations.rotation_matrix(np.radians(-50), [1, 0, 0]))
    cut.export(tmp_path / "vase.ply")
    return tmp_path / "vase.ply"


@pytest.mark.parametrize("transport", ["linear", "full"])
def test_the_inside_of_an_open_surface_is_seen_and_lit(tmp_path, mi, transport):
    changes = [FRONT, f"render.transport=[{transport}]", "render.target_rms=0.05"]
    seen, truth, said = render(tmp_path / "run", *changes, shape=vase(tmp_path))
    assert "back of an open surface" in said
    rows = np.flatnonzero(seen.mask.any(axis=1))
    # Each row of the picture of a tilted tube is one run of pixels, but for some where its two walls meet edge on.
    widths = [np.ptp(np.flatnonzero(seen.mask[row])) + 1 for row in rows]
    assert seen.mask.sum() > 0.97 * sum(widths)
    inside = seen.mask & (truth.normals[..., 1] < -0.3)  # the wall behind the mouth leans down
    assert inside.sum() > 20
    assert (truth.normals[seen.mask][:, 2] > 0).all()
    assert (seen.rgb[inside].max(axis=1) > 0).mean() > 0.9


def test_a_sheet_seen_from_behind_is_a_sheet(tmp_path, mi):
    sheet = trimesh.Trimesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0.5], [-1, 1, 0.5]], [[0, 2, 1], [0, 3, 2]])
    sheet.export(tmp_path / "sheet.obj")
    seen, truth, said = render(tmp_path / "run", FRONT, shape=tmp_path / "sheet.obj")
    assert "100% of the object's pixels show the back" in said
    expected = np.array([0, -0.25, 1]) / np.hypot(0.25, 1)
    assert np.abs(truth.normals[seen.mask] - expected).max() < 1e-5


def test_a_closed_mesh_has_no_second_side(tmp_path, mi):
    trimesh.creation.icosphere(subdivisions=3).export(tmp_path / "ball.stl")
    assert "mesh:" not in render(tmp_path / "run", FRONT, shape=tmp_path / "ball.stl")[2].replace("shape: mesh", "")


# ---- parts far away, empty views -----------------------------------------------------------------------------------


def ball_and_speck(tmp_path, distance):
    ball = trimesh.creation.icosphere(subdivisions=3)
    speck = trimesh.Trimesh([[distance, 0, 0], [distance + 0.01, 0, 0], [distance, 0.01, 0]], [[0, 1, 2]])
    trimesh.util.concatenate([ball, speck]).export(tmp_path / "speck.ply")
    return tmp_path / "speck.ply"


def test_a_speck_far_away_is_named_as_the_cause(tmp_path, mi):
    with pytest.raises(InputError, match=r"99% of the surface is 0\.0\d+ pixels large in a scene of \d+.*far away"):
        render(tmp_path / "run", FRONT, shape=ball_and_speck(tmp_path, 5000))
    perspective = "camera.projection=perspective"
    with pytest.raises(InputError, match="far away"):
        render(tmp_path / "run", FRONT, perspective, shape=ball_and_speck(tmp_path, 5000))
    _, _, said = render(tmp_path / "near", FRONT, shape=ball_and_speck(tmp_path, 20))
    assert "parts far away?" in said


def test_a_view_of_nothing_says_where_the_object_is(tmp_path, mi):
    trimesh.creation.torus(1.0, 0.2).export(tmp_path / "ring.ply")
    with pytest.raises(InputError, match=r"from column -\d+ to \d+ .* of a picture of 32 x 32"):
        render(tmp_path / "run", FRONT, "camera.view_height=0.5", shape=tmp_path / "ring.ply")


def test_a_depth_map_that_no_pixel_meets_is_refused(tmp_path, mi):
    y, x = np.mgrid[:200, :4]
    np.savez(tmp_path / "z.npz", depth=1.0 + y + x, mask=np.abs(y - 100) > 90)
    with pytest.raises(InputError, match="no pixel meets the depth map"):
        render(tmp_path / "run", FRONT, "camera.view_height=100", shape=tmp_path / "z.npz")


# ---- lights --------------------------------------------------------------------------------------------------------


def hill(tmp_path):
    y, x = np.mgrid[-16:16, -16:16]
    np.save(tmp_path / "hill.npy", 30 - 0.02 * (x**2 + y**2))
    return tmp_path / "hill.npy"


@pytest.mark.parametrize(
    ("light", "why"),
    [
        ("{direction: [0.1, 0.2, -1]}", r"direction \(0\.09\d+, 0\.195\d*, -0\.97\d+\).*shines from behind"),
        ("{kind: point, position: [1, 0, 3]}", r"point, at \(1, 0, 3\).*26\.\d+ scene units below its surface"),
        ("{kind: point, position: [90, 0, -40]}", "behind the object"),
        ("{kind: sphere, position: [0, 0, -50], radius: 2}", "inside or behind the object"),
        ("{kind: rectangle, position: [0, 0, 90], edge_u: [1, 0, 0], edge_v: [0, 1, 0]}", "shines to the other side"),
        ("{direction: [0, 0, 1], intensity: 0}", "intensity 0"),
    ],
)
@pytest.mark.parametrize("transport", ["linear", "direct"])
def test_a_picture_that_nothing_lights_is_refused_with_the_light_and_the_reason(tmp_path, mi, light, why, transport):
    with pytest.raises(InputError, match=why) as caught:
        render(tmp_path / "run", f"lights=[{light}]", f"render.transport=[{transport}]", shape=hill(tmp_path))
    assert "\n" not in str(caught.value)
    assert not list((tmp_path / "run").glob("x/*/observation.exr"))


def test_a_light_that_misses_the_object_is_named_beside_others_that_do_not(tmp_path, mi):
    lights = "lights=[{direction: [0, 0, 1]}, {kind: point, position: [0, 0, 5], spectrum: A}]"
    seen, _, said = render(tmp_path / "run", lights, shape=hill(tmp_path))
    assert seen.rgb[seen.mask].min() > 0
    assert "light 1 (A: point, at (0, 0, 5)) reaches nothing" in said
    assert "light 0" not in said


def test_directions_of_travel_are_suspected_where_no_light_is_in_front(tmp_path, mi):
    lights = "lights=[{direction: [1, 0.3, -0.5]}, {direction: [-1, 0.3, -0.4]}]"
    _, _, said = render(tmp_path / "run", lights)
    assert said.count("a direction points toward its light") == 2
    _, _, said = render(tmp_path / "rim", "lights=[{direction: [1, 0.3, -0.5]}, {direction: [0, 0.3, 1]}]")
    assert "reaches" not in said  # a light on the rim, on purpose


def test_an_object_in_the_shadow_of_another_part_is_said_to_be_so(tmp_path, mi):
    plate = trimesh.creation.box((2, 2, 0.1))
    roof = trimesh.creation.box((8, 0.1, 8))
    roof.apply_translation([0, 1.5, 0])
    trimesh.util.concatenate([plate, roof]).export(tmp_path / "roof.ply")
    lights = "lights=[{direction: [0, 1, 0.05]}, {direction: [0, 0, 1], spectrum: A}]"
    changes = [lights, "render.transport=[direct]", "camera.view_height=0.4"]
    _, _, said = render(tmp_path / "run", *changes, shape=tmp_path / "roof.ply")
    assert "the scene itself is in its way" in said
    assert "light 1" not in said


def test_spectra_without_a_common_wavelength_are_named(tmp_path, mi):
    (tmp_path / "low.csv").write_text("400 1\n450 1\n451 0\n")
    (tmp_path / "high.csv").write_text("600 0\n601 1\n700 1\n")
    changes = [
        f"lights.0.spectrum={{csv: {tmp_path / 'low.csv'}}}",
        f"surface.reflectance={{csv: {tmp_path / 'high.csv'}}}",
    ]
    with pytest.raises(InputError, match="wavelengths in common"):
        render(tmp_path / "run", "lights=[{direction: [0, 0, 1]}]", *changes)


def test_the_log_has_the_range_of_a_depth_map_in_both_units(tmp_path, mi):
    _, _, said = render(tmp_path / "run", FRONT, "camera.resolution=[64,64]", shape=hill(tmp_path))
    assert "depth: 19.76 to 30 grid steps (scene units), 39.52 to 60 px" in said
    assert "much deeper than wide" not in said
    steep = ["shape.depth_scale=40", FRONT]
    assert "much deeper than wide" in render(tmp_path / "deep", *steep, shape=hill(tmp_path))[2]
