"""What a config leaves to chance: lights, files, poses and seeds, drawn per item and written into the item's config."""

import shutil

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from huesphere.configs.errors import InputError
from huesphere.configs.load import dump_config, load_config, load_configs
from huesphere.render.dataset import open_run
from huesphere.render.run import render_configs
from huesphere.scenes.primitives import ball
from huesphere.scenes.spectra import emission

BASE = """
shape: {kind: sphere, detail: 8}
lights: {random: {count: [3, 9], spread: [20, 50], intensity: [0.5, 2]}}
camera: {resolution: [16, 16]}
render: {transport: [direct]}
"""


@pytest.fixture
def written(tmp_path):
    def write(text, name="chance.yaml"):
        path = tmp_path / name
        path.write_text(text)
        return str(path)

    return write


def drawn(path, count=40):
    return load_configs(path, overrides=[f"sweep.count={count}"])


def test_lights_keep_to_their_bounds_and_reach_them(written):
    configs = drawn(written(BASE))
    counts = {len(config.lights) for config in configs}
    assert counts == set(range(3, 10))
    lights = [light for config in configs for light in config.lights]
    directions = np.array([light.direction for light in lights])
    angle = np.degrees(np.arccos(directions[:, 2] / np.linalg.norm(directions, axis=1)))
    assert 20 - 1e-3 < angle.min() < 23
    assert 47 < angle.max() < 50 + 1e-3
    assert min(light.intensity for light in lights) >= 0.5
    assert max(light.intensity for light in lights) <= 2
    # Uniform over the sphere: the cosine is uniform, so its mean is that of the bounds.
    assert np.cos(np.radians(angle)).mean() == pytest.approx(np.mean(np.cos(np.radians([20, 50]))), abs=0.02)


def test_each_family_of_spectra_can_be_emitted(written):
    for family in ("cie", "led", "blackbody", "daylight", "gaussian"):
        text = BASE.replace("intensity:", f"spectra: [{family}], intensity:")
        spectra = {str(light.spectrum): light.spectrum for one in drawn(written(text), 20) for light in one.lights}
        assert len(spectra) >= 5
        for spectrum in spectra.values():
            assert emission(spectrum).min() >= 0
    text = BASE.replace("intensity:", "spectra: [A, {blackbody: 3000}], intensity:")
    assert {str(light.spectrum) for light in load_config(written(text)).lights} <= {
        "A",
        "blackbody=3000.0",
    }


def test_a_draw_depends_on_its_seed_and_number_alone(written):
    path = written(BASE)
    first, more = drawn(path, 3), drawn(path, 5)
    assert [one.lights for one in first] == [one.lights for one in more[:3]]
    assert first[0].lights != first[1].lights
    other = load_configs(path, overrides=["lights.random.seed=1", "sweep.count=3"])
    assert other[0].lights != first[0].lights
    # In every combination of lists a draw is the same, so that they share a trace.
    both = load_configs(path, overrides=["sweep.count=2", "sweep.camera.read_noise=[0, 0.01]"])
    assert both[0].lights == both[2].lights
    assert both[0].name != both[2].name


def test_names_tell_what_was_drawn(written):
    text = BASE.replace("kind: sphere, detail: 8", "kind: sculpture, seed: random")
    one = drawn(written(text), 2)[1]
    assert one.name == f"chance-00001-sculpture_{one.shape.seed}-{len(one.lights)}_lights"


def test_random_lights_may_stand_in_the_sweep_itself(written):
    text = BASE.replace("lights:", "lights: []\nother:").split("other:")[0]
    text += "camera: {resolution: [16, 16]}\nsweep: {count: 4, lights: {random: {count: 3}}}\n"
    configs = load_configs(written(text))
    assert [len(one.lights) for one in configs] == [3] * 4
    assert configs[0].lights != configs[1].lights


def test_a_file_is_drawn_from_a_folder_and_another_one_changes_no_other_draw(written, tmp_path):
    folder = tmp_path / "models"
    folder.mkdir()
    for number in range(4):
        save(folder / f"m{number}.ply", 2 + number)
    text = BASE.replace("kind: sphere, detail: 8", "kind: mesh, path: models/*.ply, rotation: random")
    path = written(text)
    first = drawn(path)
    names = [one.shape.path for one in first]
    assert {name[-6:] for name in names} == {f"m{number}.ply" for number in range(4)}
    assert first[0].name.startswith(f"chance-00000-{names[0][-6:-4]}-")
    save(folder / "m9.ply", 7)
    for old, new in zip(first, drawn(path), strict=True):
        assert new.shape.path == old.shape.path or new.shape.path.endswith("m9.ply")
        assert new.shape.rotation == old.shape.rotation
    # The draws are the same wherever the folder lies.
    moved = tmp_path / "elsewhere"
    shutil.copytree(folder, moved / "models")
    (moved / "chance.yaml").write_text(text)
    assert [one.shape.path[-6:] for one in drawn(str(moved / "chance.yaml"))] == [
        one.shape.path[-6:] for one in drawn(path)
    ]


def save(path, detail):
    import trimesh

    mesh = ball(detail)
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(path)


def test_poses_are_uniform_over_all_rotations(written, tmp_path):
    save(tmp_path / "m.ply", 2)
    path = written(BASE.replace("kind: sphere, detail: 8", "kind: mesh, path: m.ply, rotation: random"))
    turns = Rotation.from_euler("xyz", [one.shape.rotation for one in drawn(path, 400)], degrees=True)
    # The angle of a uniform rotation has the density (1 − cos θ) / π: mean π/2 + 2/π (Miles 1965).
    assert turns.magnitude().mean() == pytest.approx(np.pi / 2 + 2 / np.pi, abs=0.1)
    assert np.abs(turns.as_matrix().mean(axis=0)).max() < 0.1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("shape={kind: mesh, path: none/*.glb}", r"shape.path: no file matches, got none/\*.glb"),
        ("lights={random: {count: 0}}", r"lights.random.count.*1 to 256"),
        ("lights={random: {cuont: 3}}", r"unknown key lights.random.cuont"),
        ("lights={random: {spread: [50, 20]}}", r"lights.random.spread.*smaller one first"),
        ("lights={random: {spectra: []}}", r"lights.random.spectra"),
        ("lights={random: 3}", r"lights.random"),
        ("shape={kind: sculpture, seed: some}", r"shape.seed"),
    ],
)
def test_what_cannot_be_drawn_is_one_line(written, change, message):
    with pytest.raises(InputError, match=message) as caught:
        load_configs(written(BASE), overrides=[change])
    assert "\n" not in str(caught.value)


def test_the_config_of_an_item_renders_it_again_alone_to_equal_bytes(written, tmp_path):
    text = BASE.replace("kind: sphere, detail: 8", "kind: sculpture, seed: random, detail: 24, rotation: random")
    configs = drawn(written(text), 2)
    quiet = {"engine": "auto", "overwrite": False, "progress": lambda *_: None, "log": lambda _: None}
    render_configs(configs, tmp_path / "run", **quiet)
    item = open_run(tmp_path / "run")[1]
    alone = load_config(str(item.folder / "config.yaml"))
    assert "random" not in dump_config(alone).replace(alone.name, "")
    render_configs([alone], tmp_path / "again", **quiet)
    for name in ("observation.exr", "truth.exr", "layers.exr"):
        assert (tmp_path / "again" / item.id / name).read_bytes() == (item.folder / name).read_bytes()
