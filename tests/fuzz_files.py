"""More kinds of odd files for fuzz.py: pictures of every format, masks, spectra, normal maps of others, devices."""

import os
import struct
import zipfile
from pathlib import Path
from random import Random

import numpy as np
from fuzz import bumpy, check, flipped, odd_array, refusing_well

from huesphere.eval.normal_map import SUFFIXES as NORMAL_MAP_SUFFIXES
from huesphere.eval.normal_map import read_normal_map
from huesphere.recover.io.files import READABLE
from huesphere.recover.io.picture import read_mask, read_picture
from huesphere.scenes.depth_maps.read import read_depth_map
from huesphere.scenes.meshes.read import read_mesh
from huesphere.scenes.spectra import WAVELENGTHS, read_csv

NO_FILES = ("pipe", "device", "endless", "folder", "loop", "nothing", "sparse")


def put_no_file(path: Path, kind: str) -> None:
    """At ``path`` something that has the name of a file and is none that can be read, or a sparse file of 8 GiB."""
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/null")
    elif kind == "endless":
        path.symlink_to("/dev/zero")
    elif kind == "folder":
        path.mkdir()
    elif kind == "loop":
        path.symlink_to(path.name)
    elif kind == "sparse":
        with path.open("wb") as file:
            file.truncate(2**33)


def colours(rng: Random) -> np.ndarray:
    """A picture (H, W), (H, W, 3) or (H, W, 4) of some kind of sample."""
    shape = rng.choice([(9, 9, 3), (16, 16, 4), (16, 16), (1, 1, 3), (24, 24, 3), (5, 40, 3)])
    values = odd_array(rng, shape)
    if rng.random() < 0.5:
        kind = rng.choice([np.uint8, np.uint16, np.float32])
        top = 1.0 if kind is np.float32 else np.iinfo(kind).max
        values = (top * np.random.default_rng(rng.randrange(99)).random(shape)).astype(kind)
    return values


def written_picture(rng: Random, folder: Path, values: np.ndarray, suffixes: tuple[str, ...]) -> Path:
    """A picture file of one of the formats, whole, damaged, declaring more than it has, or no file at all."""
    import imageio.v3 as imageio

    path = folder / f"case{rng.choice(suffixes)}"
    chance = rng.random()
    if chance < 0.1:
        put_no_file(path, rng.choice(NO_FILES))
        return path
    if chance < 0.2:
        _declare_too_much(path)
        return path
    try:
        if path.suffix == ".npy":
            np.save(path, values)
        elif path.suffix == ".npz":
            np.savez(path, **{rng.choice(["rgb", "normals", "mask", "x"]): values})
        elif path.suffix == ".exr":
            _write_exr(path, values)
        else:
            whole = values if values.dtype in (np.uint8, np.uint16) else np.nan_to_num(np.abs(values)).astype(np.uint8)
            imageio.imwrite(path, whole)
    except Exception:  # the format has no place for such an array
        path.write_bytes(rng.randbytes(rng.randint(0, 300)))
    if rng.random() < 0.5:
        path.write_bytes(flipped(rng, path.read_bytes()))
    return path


def _write_exr(path: Path, values: np.ndarray) -> None:
    import OpenEXR

    planes = np.moveaxis(np.atleast_3d(values).astype(np.float32), -1, 0)
    names = ("R", "G", "B", "A") if len(planes) > 1 else ("Y",)
    channels = {name: np.ascontiguousarray(plane) for name, plane in zip(names, planes)}
    OpenEXR.File({}, channels).write(str(path))


def _declare_too_much(path: Path) -> None:
    """A small file whose header declares a picture of terabytes."""
    if path.suffix == ".png":
        size = struct.pack(">IIBBBBB", 2**24, 2**24, 8, 2, 0, 0, 0)
        path.write_bytes(b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + b"IHDR" + size + bytes(4))
    elif path.suffix == ".npz":
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("rgb.npy", "w") as entry:
            np.lib.format.write_array_header_1_0(entry, _header((2**20, 2**20, 3)))
            entry.write(bytes(2**20))
    elif path.suffix == ".npy":
        with path.open("wb") as file:
            np.lib.format.write_array_header_1_0(file, _header((2**20, 2**20, 3)))
    else:
        path.write_bytes(b"\x76\x2f\x31\x01" + b"\x02\0\0\0" + b"\xff" * 64)


def _header(shape: tuple[int, ...]) -> dict[str, object]:
    return {"descr": "<f4", "fortran_order": False, "shape": shape}


def any_picture_case(rng: Random, folder: Path) -> None:
    """A picture of any format that is read: decoded to finite or marked samples of its size, or refused."""
    path = written_picture(rng, folder, colours(rng), READABLE)
    with refusing_well(), np.errstate(all="ignore"):
        observation, how = read_picture(path, encoding=rng.choice(["auto", "linear", "srgb"]))
        check(observation.rgb.shape == (*observation.mask.shape, 3), "a picture and a mask of different sizes")
        check(observation.rgb.size > 0 and "\n" not in how, "an empty picture")


def mask_case(rng: Random, folder: Path) -> None:
    """A mask of any format: of the picture's size, or refused."""
    path = written_picture(rng, folder, colours(rng), READABLE)
    with refusing_well(), np.errstate(all="ignore"):
        shape = rng.choice([(9, 9), (16, 16), (24, 24)])
        mask, _ = read_mask(path, shape)
        check(mask.shape == shape and mask.dtype == bool, "no mask")


def normal_map_case(rng: Random, folder: Path) -> None:
    """A normal map of another program: unit vectors where it has any, or refused."""
    values = colours(rng)
    if rng.random() < 0.4:
        depth = bumpy(rng, 16)
        values = np.stack([-np.gradient(depth, axis=1), np.gradient(depth, axis=0), np.ones((16, 16))], axis=-1)
    path = written_picture(rng, folder, values, NORMAL_MAP_SUFFIXES)
    with refusing_well(), np.errstate(all="ignore"):
        estimate = read_normal_map(path, "other", rng.choice([(16, 16), (9, 9), (24, 24)]))
        length = np.linalg.norm(estimate.normals[estimate.valid], axis=-1)
        check(not length.size or bool(np.abs(length - 1).max() < 1e-3), "normals that are not unit vectors")


def spectrum_case(rng: Random, folder: Path) -> None:
    """A spectral table: finite numbers at all wavelengths, or refused."""
    path = folder / "case.csv"
    if rng.random() < 0.2:
        put_no_file(path, rng.choice(NO_FILES))
    else:
        step = rng.choice([1, 5, 50, 400, -5, 0])
        rows = [f"{380 + step * k}{rng.choice([',', ';', ' ', chr(9)])}{rng.uniform(-1, 2)}" for k in range(80)]
        rows.insert(rng.randrange(len(rows)), rng.choice(["nm,value", "x", "nan nan", "1e999,1", "\0", "5,5,5,5", ""]))
        text = rng.choice(["\n", "\r\n"]).join(rows).encode(rng.choice(["utf-8", "utf-8-sig", "utf-16", "latin-1"]))
        path.write_bytes(flipped(rng, text) if rng.random() < 0.4 else text)
    with refusing_well():
        table = read_csv(path, columns=rng.choice([1, 3]), where="lights[0].spectrum")
        check(len(table) == len(WAVELENGTHS) and bool(np.isfinite(table).all()), "a spectrum that is not finite")


def no_file_case(rng: Random, folder: Path) -> None:
    """A pipe, device, folder or link in the place of a depth map or mesh: refused, at once."""
    path = folder / f"case{rng.choice(['.npy', '.npz', '.txt', '.exr', '.png', '.tif', '.obj', '.ply', '.glb'])}"
    put_no_file(path, rng.choice(NO_FILES))
    with refusing_well():
        if path.suffix in (".obj", ".ply", ".glb"):
            read_mesh(path, rotation_deg=(0.0, 0.0, 0.0), smooth_deg=40.0)
        else:
            read_depth_map(path)
        check(False, "something was read where there is nothing to read")
