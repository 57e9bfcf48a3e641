"""Every kind of file that is read, damaged in every way: one line that names it, never a traceback, never a success.

Of pictures of our own runs: tests/test_render_dataset.py; of thousands of files drawn by chance: tests/fuzz.py.
"""

from collections.abc import Callable
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest

from huesphere.configs.errors import InputError
from huesphere.configs.load import load_configs
from huesphere.recover.io.picture import read_picture
from huesphere.render.exr import write_exr
from huesphere.scenes.depth_maps.read import read_depth_map
from huesphere.scenes.meshes.read import read_mesh

SIDE = 24


def dome(fill: float | None = None) -> np.ndarray:
    """A depth map (SIDE, SIDE), or one full of ``fill``."""
    y, x = np.mgrid[:SIDE, :SIDE] - SIDE / 2
    return (np.full((SIDE, SIDE), fill) if fill is not None else 9 - 0.02 * (x * x + y * y)).astype(np.float32)


def colours(fill: float | None = None) -> np.ndarray:
    """A picture (SIDE, SIDE, 3) from 0 to 1, or one full of ``fill``."""
    rgb = np.random.default_rng(0).uniform(0.1, 0.9, (SIDE, SIDE, 3)).astype(np.float32)
    return rgb if fill is None else np.full_like(rgb, fill)


def write_rgb_exr(path: Path, rgb: np.ndarray) -> None:
    write_exr(path, dict(zip("RGB", np.moveaxis(rgb, -1, 0), strict=True)))


def write_mesh(path: Path, fill: float | None = None) -> None:
    import trimesh

    ball = trimesh.creation.icosphere(2)
    ball.vertices = ball.vertices if fill is None else np.full_like(ball.vertices, fill)
    path.write_bytes(trimesh.exchange.ply.export_ply(ball))


def write_config(path: Path, fill: float | None = None) -> None:
    strength = 1.0 if fill is None else ".nan"
    path.write_text(
        f"shape: {{kind: sphere}}\nlights:\n  - {{direction: [0, 0, 1], intensity: {strength}}}\n"
        "camera: {resolution: [24, 24]}\nrender: {transport: [linear], target_rms: 0.01}\n"
    )


def mesh_of(path: Path) -> object:
    return read_mesh(path, rotation_deg=(0, 0, 0), smooth_deg=40)


Writer = Callable[[Path, float | None], object]
KINDS: dict[str, tuple[str, Writer, Callable[[Path], object]]] = {
    "depth EXR": ("z.exr", lambda path, fill=None: write_exr(path, {"Z": dome(fill)}), read_depth_map),
    "depth npz": ("z.npz", lambda path, fill=None: np.savez(path, depth=dome(fill)), read_depth_map),
    "depth PNG": ("z.png", lambda path, fill=None: imageio.imwrite(path, dome().astype(np.uint16)), read_depth_map),
    "picture EXR": ("p.exr", lambda path, fill=None: write_rgb_exr(path, colours(fill)), read_picture),
    "picture npz": ("p.npz", lambda path, fill=None: np.savez(path, rgb=colours(fill)), read_picture),
    "picture PNG": (
        "p.png",
        lambda path, fill=None: imageio.imwrite(path, (255 * colours()).astype(np.uint8)),
        read_picture,
    ),
    "mesh PLY": ("m.ply", write_mesh, mesh_of),
    "config YAML": ("c.yaml", write_config, lambda path: load_configs(str(path))),
}


def damaged(path: Path, damage: str) -> None:
    """Spoil the sound file at ``path``."""
    whole, rng = path.read_bytes(), np.random.default_rng(1)
    foreign = path.with_name(f"foreign{'.npz' if path.suffix == '.png' else '.png'}")
    if foreign.suffix == ".png":
        imageio.imwrite(foreign, np.zeros((4, 4), np.uint8))
    else:
        np.savez(foreign, other=np.ones(3))
    path.write_bytes(
        {
            "empty": b"",
            "cut": whole[: len(whole) // 2],
            "corrupt": whole[:12] + rng.bytes(len(whole) - 12),
            "foreign": foreign.read_bytes(),
        }[damage]
    )


@pytest.mark.parametrize("damage", ["empty", "cut", "corrupt", "foreign"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_file_is_one_line_that_names_it(tmp_path, kind, damage):
    name, write, read = KINDS[kind]
    write(tmp_path / name, None)
    read(tmp_path / name)
    damaged(tmp_path / name, damage)
    told(read, tmp_path / name)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if "PNG" not in kind])  # which cannot hold NaN
def test_a_file_full_of_nan_is_one_line_that_names_it(tmp_path, kind):
    name, write, read = KINDS[kind]
    write(tmp_path / name, np.nan)
    told(read, tmp_path / name)


def told(read: Callable[[Path], object], path: Path) -> None:
    with pytest.raises(InputError) as caught:
        read(path)
    assert path.name in str(caught.value)
    assert "\n" not in str(caught.value)
