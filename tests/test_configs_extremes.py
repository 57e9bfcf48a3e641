"""Numbers and sizes that no scene is made of are refused by name, before anything is computed with them."""

import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest

from huesphere.configs.errors import InputError
from huesphere.configs.load import load_configs
from huesphere.configs.picture_size import require_size
from huesphere.recover.io.picture import read_picture
from huesphere.scenes.depth_maps.read import read_depth_map
from huesphere.scenes.meshes.read import read_mesh


@pytest.mark.parametrize(
    ("setting", "named"),
    [
        ("camera.full_well=1e300", "camera.full_well"),
        ("camera.exposure=1e-300", "camera.exposure"),
        ("camera.view_height=1e308", "camera.view_height"),
        ("camera.read_noise=1e-300", "camera.read_noise"),
        ("lights.0.intensity=1e308", r"lights\[0\].intensity"),
        ("lights.0.intensity=1e-300", r"lights\[0\].intensity"),
        ("lights.0.direction=[1e308,0,1]", r"lights\[0\].direction\[0\]"),
        ("lights.0.direction=[1e-300,0,0]", "direction may not be"),
        ("lights.0={kind: sphere, position: [0, 0, 3], radius: 1e-300}", r"lights\[0\].radius"),
        ("lights.0={kind: point, position: [0, 0, -1e200]}", r"lights\[0\].position\[2\]"),
        ("surface.reflectance=1e308", "surface.reflectance"),
        ("shape={kind: ellipsoid, semi_axes: [1e-300, 1, 1]}", "semi_axes"),
        ("room={width: 1e300}", "room.width"),
        ("render.seed=" + "9" * 40, "render.seed"),
        ("camera.resolution=[16384, 16384]", "268,435,456 pixels"),
        ("lights=[" + "{direction: [0, 0, 1]}," * 300 + "]", "lights"),
        ("shape.detail=0x" + "f" * 5000, "shape.detail"),
    ],
)
def test_an_extreme_is_refused_by_name(setting, named):
    with pytest.raises(InputError, match=named) as caught:
        load_configs("sphere_quick", overrides=[setting])
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400 + len(setting)


@pytest.mark.parametrize(
    "setting",
    [
        "lights.0.direction=[6.1e-17, 0, 1]",
        "lights.0.intensity=0",
        "lights.0.intensity=1e-9",
        "camera.full_well=1e6",
        "camera.resolution=[3840, 2160]",
        "shape={kind: ellipsoid, semi_axes: [1, 0.01, 3]}",
    ],
)
def test_usual_numbers_are_as_before(setting):
    assert load_configs("sphere_quick", overrides=[setting])


def bomb_png(path: Path, side: int) -> None:
    """A PNG of ``side``² black pixels, which takes a thousandth of that on disk."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    packer = zlib.compressobj(1)
    rows = b"".join(packer.compress(bytes(1 + 3 * side)) for _ in range(100)) + packer.flush()
    head = struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", rows) + chunk(b"IEND", b""))


def array_header(file, shape: tuple[int, ...]) -> None:
    np.lib.format.write_array_header_1_0(file, {"descr": "<f4", "fortran_order": False, "shape": shape})


def test_a_picture_that_unpacks_to_gigabytes_is_refused_by_its_header(tmp_path):
    bomb_png(tmp_path / "a.png", 20_000)
    with pytest.raises(InputError, match=r"a\.png: too large a picture"):
        read_picture(tmp_path / "a.png")


def test_an_array_that_declares_more_than_is_read_is_refused(tmp_path):
    with (tmp_path / "a.npy").open("wb") as file:
        array_header(file, (10**5, 10**5, 3))
    for read in (read_picture, read_depth_map):
        with pytest.raises(InputError, match="too large a picture"):
            read(tmp_path / "a.npy")


def test_an_archive_that_unpacks_to_too_much_is_refused(tmp_path, monkeypatch):
    np.savez_compressed(tmp_path / "a.npz", rgb=np.zeros((300, 300, 3)), depth=np.ones((300, 300)))
    assert (tmp_path / "a.npz").stat().st_size < 10_000
    monkeypatch.setattr("huesphere.configs.picture_size.MOST_UNPACKED", 2_000_000)
    for read in (read_picture, read_depth_map):
        with pytest.raises(InputError, match="an archive that unpacks to too much, got 2,880,"):
            read(tmp_path / "a.npz")


def test_a_tiff_and_an_exr_are_measured_before_they_are_decoded(tmp_path):
    import OpenEXR
    import tifffile

    tifffile.memmap(tmp_path / "a.tif", shape=(8000, 8000, 3), dtype=np.uint8)
    OpenEXR.File({}, {c: np.zeros((40, 40), np.float16) for c in "RGB"}).write(str(tmp_path / "a.exr"))
    whole = (tmp_path / "a.exr").read_bytes()
    at = whole.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    (tmp_path / "a.exr").write_bytes(whole[:at] + struct.pack("<iiii", 0, 0, 30_000, 30_000) + whole[at + 16 :])
    for name in ("a.tif", "a.exr"):
        with pytest.raises(InputError, match="too large a picture"):
            read_picture(tmp_path / name)


def test_a_damaged_header_is_left_to_whoever_decodes_the_file(tmp_path):
    for name in ("a.png", "a.npy", "a.npz", "a.tif", "a.exr"):
        (tmp_path / name).write_bytes(b"nothing")
        require_size(tmp_path / name)
        with pytest.raises(InputError, match="not a readable"):
            read_picture(tmp_path / name)


def test_an_empty_picture_is_one_line(tmp_path):
    np.save(tmp_path / "zero.npy", np.zeros((0, 4, 3), np.float32))
    with pytest.raises(InputError, match=r"not a picture, got an array of shape \(0, 4, 3\)"):
        read_picture(tmp_path / "zero.npy")


def read_any_mesh(path: Path) -> object:
    return read_mesh(path, rotation_deg=(0.0, 0.0, 0.0), smooth_deg=40.0)


def test_a_mesh_reads_nothing_outside_its_folder(tmp_path):
    import json

    import trimesh

    inner = tmp_path / "inner"
    inner.mkdir()
    files = trimesh.creation.icosphere(1).export(file_type="gltf")
    for name, data in files.items():
        (inner / name).write_bytes(data)
    assert len(read_any_mesh(inner / "model.gltf").faces) == 80
    model = json.loads(files["model.gltf"])
    buffer = model["buffers"][0]["uri"]
    (inner / buffer).rename(tmp_path / "outside.bin")
    for uri in ("../outside.bin", "/dev/zero", "%2e%2e/outside.bin"):
        model["buffers"][0]["uri"] = uri
        (inner / "model.gltf").write_text(json.dumps(model))
        with pytest.raises(InputError, match=r"model\.gltf"):
            read_any_mesh(inner / "model.gltf")


def test_a_mesh_in_an_archive_is_not_unpacked(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(InputError, match="in an archive"):
        read_any_mesh(tmp_path / "a.zip")
