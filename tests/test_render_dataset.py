"""Reading a run folder: lazily, by whoever wants to learn from it, and only what is whole."""

import json
import os
import runpy
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from huesphere.configs.errors import InputError
from huesphere.configs.load import load_configs
from huesphere.eval.cli import main as evaluate
from huesphere.recover.io.estimate import read_estimate, write_estimate
from huesphere.recover.io.picture import read_picture
from huesphere.recover.run import recover_one, recover_run
from huesphere.render.dataset import Observation, open_run, read_observation, read_truth, write_observation
from huesphere.render.exr import read_exr, write_exr
from huesphere.render.layers import read_layers
from huesphere.render.run import render_configs
from huesphere.render.verify import verified

ROOT = Path(__file__).resolve().parent.parent
SPHERES = """
shape: {kind: sphere, detail: 24}
lights:
  - {direction: [0.6, 0.3, 1.0], spectrum: {gaussian: {centre: 610, sigma: 25}}}
  - {direction: [-0.5, 0.4, 1.0], spectrum: {gaussian: {centre: 540, sigma: 25}}}
  - {direction: [0.1, -0.6, 1.0], spectrum: {gaussian: {centre: 460, sigma: 20}}}
camera: {resolution: [32, 32]}
render: {transport: [linear, direct]}
recover: {methods: [least-squares]}
sweep: {count: 10, surface.reflectance: {uniform: [0.3, 0.9]}, camera.read_noise: {log_uniform: [1e-4, 1e-2]}}
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory, mi):
    folder = tmp_path_factory.mktemp("spheres")
    (folder / "spheres.yaml").write_text(SPHERES)
    configs = load_configs(str(folder / "spheres.yaml"))
    render_configs(configs, folder / "run", progress=lambda *_: None, log=lambda _: None)
    return folder / "run"


@pytest.fixture
def copy(run, tmp_path):
    return Path(shutil.copytree(run, tmp_path / "run"))


def of_one_item(run: Path) -> Path:
    """The run, as if its first item were all that was rendered: others that are on disk would count."""
    manifest = json.loads((run / "manifest.json").read_text())
    (run / "manifest.json").write_text(json.dumps(manifest | {"items": manifest["items"][:1]}))
    for other in manifest["items"][1:]:
        shutil.rmtree(run / other["id"])
    return run


def test_items_are_handles_and_read_nothing_before_they_are_asked(copy):
    for path in copy.rglob("*.exr"):
        path.unlink()
    items = open_run(copy)
    assert len(items) == 20
    assert [item.transport for item in items[:2]] == ["direct", "linear"]
    assert len(open_run(copy, transport="linear")) == 10
    assert open_run(copy, status="failed") == ()
    assert items[0].config().name == "spheres-00000"
    with pytest.raises(InputError, match=r"observation\.exr: no such picture"):
        items[0].observation()


def test_an_item_gives_picture_truth_and_layers(run):
    item = open_run(run, transport="direct")[0]
    assert item.observation().rgb.shape == (32, 32, 3)
    assert item.truth().normals.shape == (32, 32, 3)
    # The layers have no noise; the picture has some.
    difference = (item.layers().picture() - item.observation().rgb)[item.observation().mask]
    assert 0 < np.abs(difference).std() < 2 * item.config().camera.read_noise


def test_the_training_loop_of_the_docs_learns(run):
    train = runpy.run_path(str(ROOT / "docs/train.py"))["train"]
    before, after = train(str(run), epochs=60)
    assert before > 30
    assert after < 8


# ---- files that are not what they were -----------------------------------------------------------------------------


def test_verify_finds_every_changed_file(copy, capsys):
    with pytest.raises(SystemExit) as end:
        evaluate([str(copy), "--verify"])
    assert end.value.code == 0
    assert "100 files are those that were written" in capsys.readouterr().out
    names = ["truth.exr", "config.yaml", "preview.png"]
    for number, name in enumerate(names):
        path = copy / f"spheres-0000{number}/linear/{name}"
        data = bytearray(path.read_bytes())
        data[len(data) // 2] ^= 1
        path.write_bytes(bytes(data))
    (copy / "spheres-00005/direct/layers.exr").unlink()
    faults = {path: fault for path, fault in verified(copy) if fault}
    assert sorted(Path(path).name for path in faults) == sorted([*names, "layers.exr"])
    with pytest.raises(SystemExit) as end:
        evaluate([str(copy), "--verify"])
    assert end.value.code == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 4
    assert all(path in err for path in faults)


@pytest.mark.parametrize("path", ["../x", "/etc/passwd", "a/../../x"])
def test_no_path_leads_out_of_the_run(copy, path):
    manifest = json.loads((copy / "manifest.json").read_text())
    manifest["items"][0]["files"][0]["path"] = path
    (copy / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(InputError, match=r"leads out"):
        list(verified(copy))


def test_no_link_leads_out_of_the_run(copy, tmp_path):
    (tmp_path / "secret").mkdir()
    os.symlink(tmp_path / "secret", copy / "link")
    manifest = json.loads((copy / "manifest.json").read_text())
    manifest["items"][0]["id"] = "link/full"
    (copy / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(InputError, match="leads out"):
        open_run(copy)


READERS = {"observation.exr": read_observation, "truth.exr": read_truth, "layers.exr": read_layers}


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("damage", ["empty", "cut", "noise", "foreign", "text"])
def test_damaged_pictures_are_one_line_with_the_name(copy, name, damage):
    path = copy / "spheres-00000/direct" / name
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    data = {
        "empty": b"",
        "cut": whole[: 2 * len(whole) // 3],
        "noise": whole[:8] + rng.bytes(len(whole)),
        "foreign": (copy / "spheres-00000/direct/preview.png").read_bytes(),
        "text": b"hello",
    }[damage]
    path.write_bytes(data)
    with pytest.raises(InputError, match=name.replace(".", r"\.")) as told:
        READERS[name](path)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("text", [b"name: [", b"\xff\xfe", b"a: !!python/name:os.system x", b"- 1", b""])
def test_a_damaged_config_is_one_line_with_its_name(copy, text):
    (copy / "spheres-00000/direct/config.yaml").write_bytes(text)
    with pytest.raises(InputError, match=r"config\.yaml"):
        recover_run(of_one_item(copy))
    with pytest.raises(InputError, match=r"config\.yaml"):
        open_run(copy)[0].config()


def test_pictures_full_of_nan_are_refused(copy):
    folder = copy / "spheres-00000/direct"
    for name, reader in (("observation.exr", read_observation), ("truth.exr", read_truth)):
        channels, header = read_exr(folder / name)
        kept = {"mask": channels["mask"]}
        write_exr(folder / name, {k: np.full_like(v, np.nan) for k, v in channels.items()} | kept, header)
        with pytest.raises(InputError, match=name.replace(".", r"\.")):
            reader(folder / name)
    with pytest.raises(InputError, match="finite"):
        recover_run(of_one_item(copy), ["least-squares"])
    with pytest.raises(InputError, match="finite"):
        read_picture(folder / "observation.exr")


@pytest.mark.parametrize(
    "camera",
    [
        [],
        "x",
        {"bits": "8"},
        {"bits": -1},
        {"projection": "fish-eye"},
        {"known": 1},
        {"read_noise": None},
        {"bits": 1e999},
    ],
)
def test_headers_that_mean_nothing_are_refused(tmp_path, camera):
    path = tmp_path / "observation.exr"
    write_observation(path, Observation(np.ones((8, 8, 3), np.float32), np.ones((8, 8), bool)))
    channels, header = read_exr(path)
    write_exr(path, channels, header | {"camera": camera})
    with pytest.raises(InputError, match=r"observation\.exr: header: camera"):
        read_observation(path)


@pytest.mark.parametrize(
    ("key", "value"), [("seconds", "1"), ("status", None), ("diagnostics", []), ("method", "other"), ("message", 3)]
)
def test_estimates_of_another_kind_are_refused(run, tmp_path, key, value):
    folder = tmp_path / "estimates"
    picture = run / "spheres-00000/direct/observation.exr"
    write_estimate(folder, recover_one(read_observation(picture), "least-squares"), picture)
    record = json.loads((folder / "least-squares.json").read_text())
    (folder / "least-squares.json").write_text(json.dumps(record | {key: value}))
    with pytest.raises(InputError, match=r"least-squares\.json: not a readable estimate"):
        read_estimate(folder, "least-squares")


@pytest.mark.parametrize("name", ["a.npy", "a.npz"])
def test_pickles_are_never_opened(tmp_path, name):
    """An array of objects is code to be run: it is refused as a picture and as a depth map, and nothing runs."""
    from huesphere.scenes.depth_maps.read import read_depth_map

    class Trap:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "sprung"),)

    trap = np.array([[Trap()] * 4] * 4, dtype=object)
    save = {"a.npy": lambda: np.save(tmp_path / name, trap, allow_pickle=True)}.get(
        name, lambda: np.savez(tmp_path / name, depth=trap, rgb=trap)
    )
    save()
    for reader in (read_picture, read_depth_map):
        with pytest.raises(InputError, match=name):
            reader(tmp_path / name)
    assert not (tmp_path / "sprung").exists()


def test_no_shipped_code_can_open_a_pickle_or_a_yaml_tag():
    for package in ("configs", "scenes", "render", "recover", "eval"):
        for path in (ROOT / package).rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            assert "allow_pickle=True" not in text, path
            assert "yaml.unsafe" not in text, path
            assert "FullLoader" not in text, path
            assert "pickle.load(" not in text, path


def test_verify_is_a_command(copy):
    done = subprocess.run(
        [Path(sys.executable).parent / "evaluate", copy, "--verify"], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr


def test_a_run_is_an_ro_crate(copy):
    """RO-Crate 1.1: descriptor, root with its four musts, and every part that is named is described and on disk."""
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "huesphere.render.crate",
            copy,
            "--license",
            "https://spdx.org/licenses/CC0-1.0",
            "--name",
            "Balls",
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    crate = json.loads((copy / "ro-crate-metadata.json").read_text())
    entities = {entity["@id"]: entity for entity in crate["@graph"]}
    assert len(entities) == len(crate["@graph"]) == 3 + 20 * (1 + 5)
    assert entities["ro-crate-metadata.json"]["about"] == {"@id": "./"}
    assert all(entities["./"][key] for key in ("name", "description", "datePublished", "license"))
    for entity in crate["@graph"]:
        assert all(part["@id"] in entities for part in entity.get("hasPart", ()))
        if entity["@type"] == "File":
            assert (copy / entity["@id"]).is_file()
        if "contentSize" in entity:
            assert int(entity["contentSize"]) == (copy / entity["@id"]).stat().st_size
